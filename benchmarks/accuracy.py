"""Errors of methods ``joint`` and ``full`` on simulated drives, compared with the goals.

Usage: python benchmarks/accuracy.py [--only BLOCK,...] [--machines FOLDER] [--output docs/engineering/accuracy.md]

The blocks are speeds, machines, inverters, motion, faults, ideal, prediction and files; the last one needs the files
``baldor_meas_map.npz`` and ``thor_fem_harmonic_map.npz`` in FOLDER. The figures do not depend on the computer.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from judging import Figures, amperes, fitted, percent, predicted
from reporting import printed

from drive_id.bench.drive import Simulation
from drive_id.bench.machine import default_amplitude
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.fitting.simulated import load_machine, run_experiment

METHODS = ("joint", "full")
SECONDS, SEEDS = 10.0, 3
COLUMNS = ("Drive", "Method", "psi_d", "psi_q", "R", "Inverter curve", "Mean error i_d", "Mean error i_q")
NOISY = SimulationSettings(current_noise=2e-3)
"""10 kHz, 500 rpm, harmonics 6 and 12, dead time, noise of 0.2 % of i_max."""
FAULTS = replace(NOISY, resolver_offset=math.radians(1.0), voltage_delay=1.0, current_gain=(1.004, 1.0, 0.998))
OFFSETS = (3e-3, -1.5e-3, 0.7e-3)
"""Of the current sensors, as shares of i_max."""
IDEAL = SimulationSettings(inverter="none", harmonics=0.0)
PREDICTED_FROM, PREDICTED_AT = (400.0, -900.0), (1500.0, -1500.0)


@dataclass(frozen=True)
class Goal:
    """What ``full`` is to reach; the MAD is to be at most a third of that of ``joint``."""

    nrmse: float = 1e-3
    resistance: float = 1e-2
    curve: float = 2e-2
    mad_share: float = 1 / 3


@dataclass(frozen=True)
class Case:
    """One drive: a recording for each of the settings, fitted together."""

    name: str
    machine: str
    settings: tuple[SimulationSettings, ...]
    goal: Goal = field(default_factory=Goal)


@dataclass(frozen=True)
class Block:
    """Cases of one table, with its title and text."""

    title: str
    sentence: str
    cases: tuple[Case, ...]


def at(*speeds: float, **changes: Any) -> SimulationSettings:
    """Return the noisy drive at other speeds, rpm, and with other changes."""
    return replace(NOISY, speeds=speeds, **changes)


def faulty(machine: str, **changes: Any) -> SimulationSettings:
    """Return the drive with all faults of its sensors."""
    i_max = default_amplitude(load_machine(machine))
    a, b, c = (share * i_max for share in OFFSETS)
    return replace(FAULTS, current_offset=(a, b, c), **changes)


def blocks() -> dict[str, Block]:
    """Return the blocks that need no files."""
    compensated = replace(NOISY, inverter_compensation=True)
    quiet = replace(compensated, current_noise=0.0, harmonics=0.0)
    several, all_faults, ideal = Goal(resistance=5e-3), Goal(2e-3, 2e-2, 5e-2), Goal(1e-4, 1e-3, 1e-3, math.inf)
    return {
        "speeds": Block(
            "Speeds and directions",
            "The `ipm` with its harmonics of order 6 and 12, a dead-time inverter and 0.2 % noise; at 3000 rpm the "
            "resistive drop is at most 3 % of the voltage, and the goal for R is 5 %.",
            tuple(
                Case(f"ipm, {speed:g} rpm", "ipm", (at(speed),), Goal(resistance=0.05 if speed > 700 else 0.01))
                for speed in (100.0, 500.0, 1500.0, 3000.0, -700.0)
            ),
        ),
        "machines": Block(
            "Other machines",
            "The same experiment at 500 rpm on the other shipped machines.",
            tuple(Case(name, name, (NOISY,)) for name in ("spm", "pmsyrm")),
        ),
        "inverters": Block(
            "Other inverters",
            "The `ipm` at 500 rpm; without an inverter or with a compensated one, the curve error is relative to 1 % "
            "of the DC link. The last drive has neither noise nor harmonics, so its mean errors need not be less than "
            "those of `joint`: the remaining error comes from compensation with outdated currents, which is fitted, "
            "but not simulated.",
            (
                Case("ipm, tanh", "ipm", (replace(NOISY, inverter="tanh"),)),
                Case("ipm, dead time and devices", "ipm", (replace(NOISY, inverter="two_stage"),)),
                Case("ipm, no inverter", "ipm", (replace(NOISY, inverter="none"),)),
                Case("ipm, compensated", "ipm", (compensated,)),
                Case("ipm, compensated, no noise", "ipm", (quiet,), Goal(mad_share=1.0)),
            ),
        ),
        "motion": Block(
            "Changing speed, several recordings",
            "A speed ripple of 5 %, two speeds within a recording of 10 s, and two recordings of 5 s fitted together.",
            (
                Case("ipm, 500 rpm with ripple", "ipm", (at(500.0, speed_ripple=0.05),)),
                Case("ipm, 500 and -900 rpm in one", "ipm", (at(500.0, -900.0),), several),
                Case("ipm, 500 and -900 rpm in two", "ipm", (at(500.0), at(-900.0, seed=1)), several),
            ),
        ),
        "faults": Block(
            "All faults together",
            "The resolver is 1 degree off, voltages act one sample later than recorded, current gains differ by 0.4 % "
            "and offsets are 0.3 % of i_max; the goal is 0.2 % for the fluxes.",
            tuple(Case(f"{name}, faulty", name, (faulty(name),), all_faults) for name in ("ipm", "spm", "pmsyrm")),
        ),
        "ideal": Block(
            "Everything ideal",
            "No noise, no inverter, no harmonics: what is left is the resolution of the splines; the goal is 0.01 %.",
            tuple(Case(f"{name}, ideal", name, (IDEAL,), ideal) for name in ("ipm", "spm", "pmsyrm")),
        ),
    }


def files(folder: Path) -> Block:
    """Return the block of the two machine files."""
    baldor, thor = (str(folder / name) for name in ("baldor_meas_map.npz", "thor_fem_harmonic_map.npz"))
    sixth = {"sixth_harmonic": 0.01}
    return Block(
        "Machine files (need `--machines`)",
        "A measured map (Baldor, with a sixth harmonic of 1 % added) and one from finite elements with its own "
        "harmonics (THOR, goal 0.15 %), which are not part of this repository.",
        (
            Case("Baldor, 0.1 % noise", baldor, (at(500.0, **{**sixth, "current_noise": 1e-3}),)),
            Case("Baldor, 0.2 % noise", baldor, (at(500.0, **sixth),)),
            Case("Baldor, faulty", baldor, (faulty(baldor, **sixth),), Goal(2e-3, 2e-2, 5e-2)),
            Case("THOR, 0.1 % noise", thor, (at(500.0, current_noise=1e-3),), Goal(1.5e-3)),
            Case("THOR, 0.2 % noise", thor, (NOISY,), Goal(1.5e-3)),
            Case("THOR, faulty", thor, (faulty(thor),), Goal(2e-3, 2e-2, 5e-2)),
        ),
    )


def simulated(case: Case, seed: int) -> tuple[list[Simulation], float]:
    """Run the experiments of a case, 10 s in all, and return 1 % of its DC link, V."""
    machine = load_machine(case.machine)
    seconds = SECONDS / len(case.settings)
    runs = [replace(settings, seed=settings.seed + 10 * seed) for settings in case.settings]
    return [run_experiment(machine, settings, None, seconds) for settings in runs], 0.01 * machine.u_dc


def root_mean_square(figures: list[Figures]) -> Figures:
    """Return the root mean square of each figure over several seeds."""
    square = ([getattr(each, part.name) ** 2 for each in figures] for part in fields(Figures))
    return Figures(*(math.sqrt(sum(values) / len(values)) for values in square))


def rows(case: Case) -> Iterator[str]:
    """Fit one case by both methods and return the results as rows of a Markdown table."""
    several: dict[str, list[Figures]] = {method: [] for method in METHODS}
    noisy = any(settings.current_noise > 0 for settings in case.settings)
    for seed in range(SEEDS if noisy else 1):
        simulations, unit = simulated(case, seed)
        for method in METHODS:
            several[method].append(fitted(simulations, FitSettings(method=method), unit)[1])
    figures = {method: root_mean_square(of_seeds) for method, of_seeds in several.items()}
    joint = figures["joint"]
    for method in METHODS:
        limits = _limits(case.goal, joint) if method == "full" else Figures(*[math.inf] * 6)
        name = case.name if method == METHODS[0] else ""
        yield f"| {name} | {method} | {' | '.join(_cells(figures[method], limits))} |"


def _limits(goal: Goal, joint: Figures) -> Figures:
    """Return the limits for the figures of ``full``: the goals, and at most the figures of ``joint``."""
    mad = [goal.mad_share * value if math.isfinite(value) else math.inf for value in (joint.mad_d, joint.mad_q)]
    worst = min(goal.nrmse, joint.nrmse_d), min(goal.nrmse, joint.nrmse_q)
    return Figures(*worst, goal.resistance, goal.curve, *mad)


def _cells(figures: Figures, limits: Figures) -> Iterator[str]:
    for part, show in zip(fields(Figures), [percent] * 4 + [amperes] * 2, strict=True):
        value, limit = getattr(figures, part.name), getattr(limits, part.name)
        missed = math.isfinite(limit) and not value <= limit
        yield f"**{show(value)}**" if missed else show(value)


def prediction() -> Iterator[str]:
    """Predict the currents at speeds that the fits have never seen; lines of Markdown."""
    machine = load_machine("ipm")
    seen = [run_experiment(machine, at(speed, seed=k), None, SECONDS / 2) for k, speed in enumerate(PREDICTED_FROM)]
    yield "## Prediction"
    yield ""
    yield (
        f"Fitted to 5 s at {PREDICTED_FROM[0]:g} and 5 s at {PREDICTED_FROM[1]:g} rpm (the drive of the first table). "
        "The currents of recordings at other speeds are simulated in open loop over 5 s, from their voltages and "
        "angles alone. "
        f"The noise of the measured currents accounts for {_noise(machine.i_max):.2f} A."
    )
    yield ""
    yield "| Predicted | Method | Mean error i_d | Mean error i_q |"
    yield "|---|---|---:|---:|"
    for number, speed in enumerate(PREDICTED_AT):
        unseen = run_experiment(machine, at(speed, seed=10 + number), None, SECONDS / 2)
        for method in METHODS:
            mad = predicted(seen, unseen, FitSettings(method=method))
            name = f"ipm, {speed:g} rpm" if method == METHODS[0] else ""
            yield f"| {name} | {method} | {amperes(mad[0])} | {amperes(mad[1])} |"


def _noise(i_max: float) -> float:
    """Return the mean absolute noise of i_d, A: the Clarke transform passes 2/3 of the variance of phase noise."""
    return math.sqrt(2 / math.pi) * math.sqrt(2 / 3) * NOISY.current_noise * i_max


def page(wanted: list[str], folder: Path | None) -> Iterator[str]:
    """Yield the lines of the page."""
    command = "python benchmarks/accuracy.py" + (" --machines FOLDER" if folder else "")
    yield from (
        "# Accuracy",
        "",
        f"Written by `{command}`. Each drive is simulated for 10 s at 10 kHz along the",
        "paper's trajectory and fitted by both methods with default settings. All figures are root mean squares",
        f"over {SEEDS} seeds of the noise. Flux errors are NRMSE over the map points with data within the disc. A",
        "linear part of the inverter curve counts as resistance: the slope r of the true curve at large currents is",
        "subtracted from the curve and added to the true R. The curve error is the root mean square over all",
        "currents, relative to the largest true value. Mean errors are mean absolute deviations of the currents that",
        "the fit simulates in open loop from the measured ones (the paper's MAD), over the whole recording.",
        "",
        "Goals for `full`: fluxes 0.1 %, R 1 % (0.5 % from several speeds), curve 2 %, mean errors a third of those of",
        "`joint`, unless stated otherwise; values that miss the goal, or are worse than `joint`, are **bold**.",
        "",
    )
    available = blocks() | ({"files": files(folder)} if folder else {})
    for name in wanted or [*blocks(), "prediction", *(["files"] if folder else [])]:
        if name == "prediction":
            yield from (*prediction(), "")
            continue
        block = available[name]
        yield from (f"## {block.title}", "", block.sentence, "", f"| {' | '.join(COLUMNS)} |")
        yield "|---|---|" + "---:|" * (len(COLUMNS) - 2)
        for case in block.cases:
            yield from rows(case)
        yield ""


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description="Compare methods joint and full with the truth.")
    parser.add_argument("--only", default="", help="names of blocks, with commas")
    parser.add_argument("--machines", type=Path, help="folder with the two machine files")
    parser.add_argument("--output", type=Path, help="page to write (Markdown)")
    options = parser.parse_args()
    text = printed(page(options.only.split(",") if options.only else [], options.machines))
    if options.output:
        options.output.write_text(text.rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
