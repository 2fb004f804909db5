"""Contribution of each ingredient of method ``full``: each is switched off in turn, on simulated drives.

Usage: python benchmarks/ablation.py [--only PART,...] [--output docs/ablation.md]

The parts are model, windows, splines, calibration, instruments and dilution. The figures do not depend on the computer.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import instruments
import numpy as np
from accuracy import NOISY, at, faulty
from judging import judge, percent
from rich.console import Console
from single_fit import Accumulation, Errors
from uncertainty import DRIVES, SECONDS, WITHIN

from drive_id.bench.drive import Simulation
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full.model import PENALTIES, ModelSpec
from drive_id.core.full.solver import CurrentNoise, Solver, correct_attenuation
from drive_id.core.result.conclusion import conclude
from drive_id.fitting.simulated import load_machine, run_experiment
from drive_id.types import FloatArray

COLUMNS = ("psi_d", "psi_q", "R", "Inverter curve")
INGREDIENTS = ModelSpec(reciprocal=True, orders=(6, 12), penalty=PENALTIES[-2])
"""What ``full`` chooses for these drives, except the weight of the penalty, which it chooses by cross-validation."""
ANGLES = (30.0, 60.0, 120.0, 240.0, 360.0)
REPETITIONS = 12
STRIDES = (0.4e-3, 0.8e-3, 1.6e-3, 3.2e-3)


def drive(machine: str, settings: SimulationSettings) -> Simulation:
    """Record the paper's trajectory for 10 s."""
    return run_experiment(load_machine(machine), settings)


def line(name: str, errors: Errors) -> str:
    """Lay out a row."""
    return f"| {name} | {' | '.join(percent(value) for value in errors)} |"


def head(title: str, sentence: str, *names: str, columns: tuple[str, ...] = COLUMNS) -> Iterator[str]:
    """Begin a section with a table whose first column, and those beyond the usual ones, have the given names."""
    columns = (names[0], *columns, *names[1:])
    yield from (f"## {title}", "", sentence, "", f"| {' | '.join(columns)} |")
    yield "|---|" + "---:|" * (len(columns) - 1)


def model() -> Iterator[str]:
    """Leave parts of the model out."""
    yield from head(
        "The model",
        "The `ipm` at 500 rpm with a dead-time inverter, harmonics 6 and 12 and 0.2 % noise; each row is a single "
        "change from the first row, at the same penalty.",
        "Change",
    )
    data = Accumulation(drive("ipm", NOISY))
    every = data.model.orders
    middle = len(data.model.shapes.scales) // 2
    choices = {
        "none: reciprocal maps, harmonics 6 and 12, curve of 8 shapes": INGREDIENTS,
        "no rotor harmonics": replace(INGREDIENTS, orders=()),
        "harmonic 6 alone": replace(INGREDIENTS, orders=(6,)),
        f"all candidates, {every[0]} to {every[-1]}, present or not": replace(INGREDIENTS, orders=every),
        "no inverter": replace(INGREDIENTS, inverter=False),
        "no inverter, no rotor harmonics, free maps: the windows alone": ModelSpec(
            False, (), inverter=False, penalty=1e-3
        ),
        "an inverter curve for each phase": replace(INGREDIENTS, per_phase=True),
        "free maps": replace(INGREDIENTS, reciprocal=False),
    }
    for name, choice in choices.items():
        yield line(name, data.solved(choice))
    for number, name in ((0, "the narrowest"), (middle, "a middle one"), (-1, "the widest")):
        scale = data.model.shapes.scales[number]
        yield line(f"one inverter shape, {name} ({scale:.3g} A)", data.solved(INGREDIENTS, shape=number))
    for penalty in PENALTIES:
        yield line(f"penalty {penalty:g}", data.solved(replace(INGREDIENTS, penalty=penalty)))
    yield ""


def windows() -> Iterator[str]:
    """Vary angle and stride of the windows."""
    for speed in (100.0, 500.0):
        simulation = drive("ipm", at(speed))
        yield from head(
            f"The windows, {speed:g} rpm",
            "The drive above; the angle is varied at a mean stride of 0.8 ms, the stride at an angle of 60 degrees. No "
            "window is longer than 0.1 s, which at 100 rpm is 240 degrees.",
            "Windows",
        )
        for angle in ANGLES:
            with patch("drive_id.core.full.windows.WINDOW_ANGLE", np.deg2rad(angle)):  # no setting, for none is better
                yield line(f"of {angle:g} degrees", Accumulation(simulation).solved(INGREDIENTS))
        for stride in STRIDES:
            with patch("drive_id.core.full.windows.STRIDE", stride):
                yield line(f"every {1e3 * stride:g} ms", Accumulation(simulation).solved(INGREDIENTS))
        yield ""


def splines() -> Iterator[str]:
    """Vary the cells of the map."""
    for machine in ("ipm", "pmsyrm"):
        simulation = drive(machine, NOISY)
        yield from head(
            f"The splines, {machine}",
            "At 500 rpm with dead time, harmonics and 0.2 % noise; bent cells are narrower at zero current. The "
            "penalty is the best of those tried.",
            "Cells",
        )
        for cells in (8, 12, 16, 20):
            for bend, name in ((2.0, "bent"), (1e-3, "uniform")):
                with (
                    patch("drive_id.core.full.resolution.FLUX_CELLS", cells),
                    patch("drive_id.core.maps.coenergy.bent_edges.__defaults__", (bend,)),
                ):
                    data = Accumulation(simulation)
                    tried = [data.solved(replace(INGREDIENTS, penalty=penalty)) for penalty in PENALTIES]
                yield line(f"{cells} x {cells}, {name}", min(tried, key=lambda errors: errors[0] + errors[1]))
        yield ""


def calibration() -> Iterator[str]:
    """Switch the calibrations off, on a drive with faults; complete fits by settings."""
    yield from head(
        "Calibration",
        "The `ipm` at 500 rpm with all faults together: resolver 1 degree off, voltages one sample late, gains "
        "differing by 0.4 %, offsets of 0.3 %, 0.2 % noise.",
        "Change",
    )
    simulation, unit = drive("ipm", faulty("ipm")), 0.01 * load_machine("ipm").u_dc
    complete = FitSettings(method="full")
    changes = {
        "none": complete,
        "delay not estimated": replace(complete, calibrate_delay=False),
        "delay given": replace(complete, calibrate_delay=False, voltage_delay=1.0),
        "angle not estimated": replace(complete, calibrate_angle=False),
        "offsets and gains not estimated": replace(complete, calibrate_currents=False),
        "free maps, hence no delay": replace(complete, maps="free"),
        "nothing estimated": replace(complete, calibrate_delay=False, calibrate_angle=False, calibrate_currents=False),
    }
    evidence = Accumulation(simulation).evidence
    for name, settings in changes.items():
        figures = judge(conclude(evidence.copy(settings), ()), simulation.truth, unit)
        yield line(name, (figures.nrmse_d, figures.nrmse_q, figures.resistance, figures.curve))
    yield ""


def instruments_section() -> Iterator[str]:
    """Solve with instruments."""
    for speed, noise in ((100.0, 2e-3), (500.0, 2e-3), (100.0, 1e-2)):
        simulation = drive("ipm", at(speed, current_noise=noise))
        yield from head(
            f"Instruments, {speed:g} rpm, {100 * noise:g} % noise",
            "Z'Z x = Z'y with the measured currents, compared with Z'X x = Z'y with instruments Z free of that noise; "
            "same unknowns, same penalty. In the last row the regressor itself is built from the true currents. The "
            "voltage delay (true value 0) is estimated in a separate fit.",
            "Estimator",
            "Delay",
        )
        for name, errors, delay in instruments.compared(simulation, INGREDIENTS):
            yield f"{line(name, errors)} {delay:+.3f} |"
        yield ""


def dilution() -> Iterator[str]:
    """Switch off the correction of the attenuation by current noise."""
    yield from head(
        "What noise takes",
        f"Mean and scatter of the maps' errors over {REPETITIONS} experiments of {SECONDS:g} s that differ in their "
        f"noise, root mean square within {100 * WITHIN:g} % of the disc: the attenuation by current noise is the same "
        "in each experiment. The drives are those of [coverage.md](coverage.md), the penalty is that of the model "
        "above.",
        "Drive",
        columns=("psi_d, mean", "psi_d, scatter", "psi_q, mean", "psi_q, scatter"),
    )
    for name, (machine, settings) in DRIVES.items():
        experiments = [_experiment(machine, replace(settings, seed=seed)) for seed in range(REPETITIONS)]
        i_dq, true_psi = experiments[0].places
        inner = np.hypot(*i_dq.T) <= WITHIN * experiments[0].simulation.truth.i_max
        largest = np.abs(true_psi).max(axis=0)
        fluxes = np.array(
            [_with_and_without(data, i_dq[inner]) for data in experiments]
        )  # [experiment, kind, place, flux]
        errors = (fluxes - true_psi[inner]) / largest
        mean = np.sqrt(np.mean(errors.mean(axis=0) ** 2, axis=1))
        scatter = np.sqrt(np.mean(errors.var(axis=0, ddof=1), axis=1))
        for kind, word in enumerate(("not corrected", "corrected")):
            values = [percent(x) for flux in range(2) for x in (mean[kind, flux], scatter[kind, flux])]
            yield f"| {name}: {word} | {' | '.join(values)} |"
    yield ""


def _experiment(machine: str, settings: SimulationSettings) -> Accumulation:
    return Accumulation(run_experiment(load_machine(machine), settings, None, SECONDS))


def _with_and_without(data: Accumulation, i_dq: FloatArray) -> FloatArray:
    """Return the fluxes (2, N, 2) at currents (N, 2), Wb, without and with the correction for current noise."""
    solver = Solver.over(data.information)
    solution = solver.solve(INGREDIENTS)
    noise = CurrentNoise.met(data.evidence.noise_variance, data.information.kept())
    given_back, _ = correct_attenuation(solver, solution, noise)
    rows, columns = data.model.flux.rows(i_dq), data.model.map
    return np.stack([rows.dot(each.estimate[columns]) for each in (solution, given_back)])


PARTS = {
    "model": model,
    "windows": windows,
    "splines": splines,
    "calibration": calibration,
    "instruments": instruments_section,
    "dilution": dilution,
}


def page(wanted: list[str]) -> Iterator[str]:
    """Yield the lines of the page."""
    yield from (
        "# Ablation: each ingredient switched off in turn",
        "",
        "Written by `python benchmarks/ablation.py`. Method `full` on simulated drives, 10 s at 10 kHz on the paper's",
        "trajectory; errors of the fluxes, the resistance and the inverter's curve as in [accuracy.md](accuracy.md).",
        "",
    )
    for name in wanted or PARTS:
        yield from PARTS[name]()


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description="Switch the ingredients of method full off in turn.")
    parser.add_argument("--only", default="", help=f"parts, with commas: {', '.join(PARTS)}")
    parser.add_argument("--output", type=Path, help="page to write (Markdown)")
    options = parser.parse_args()
    console = Console(width=150, highlight=False, markup=False)
    lines = []
    for text in page(options.only.split(",") if options.only else []):
        console.print(text, soft_wrap=True)
        lines.append(text)
    if options.output:
        options.output.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
