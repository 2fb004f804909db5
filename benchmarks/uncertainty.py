"""Empirical coverage of the standard errors of method ``full``: repeat an experiment with different noise and count.

    python benchmarks/uncertainty.py [--seeds 200] [--write]
    python benchmarks/uncertainty.py --seeds 20 --slow-angle

Prints the share of intervals of ±1.96 σ that contain the truth: of the fluxes at all map points with data within 97 %
of the disc, of the resistance, and of the inverter curve. ``--write`` puts the table into docs/engineering/coverage.md.
``--slow-angle`` prints the rms of error over standard error for drives whose speed ripples, with the angle recorded at
every sample, every 10th and every 20th (docs/engineering/logs_measured.md).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from judging import BAND, against, normalized_curve

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identify import gather
from drive_id.core.signals.rotor_interpolation import interpolated_rotor
from drive_id.core.signals.signal import Signal
from drive_id.core.validation.metrics import true_flux
from drive_id.fitting.simulated import run_experiment
from drive_id.types import Samples

WITHIN = 0.97
DRIVES = {
    "ipm, 500 rpm, dead time": ("ipm", SimulationSettings(current_noise=2e-3)),
    "spm, 1000 rpm, tanh": ("spm", SimulationSettings(current_noise=2e-3, speeds=(1000.0,), inverter="tanh")),
    "pmsyrm, -300 rpm, dead time and devices": (
        "pmsyrm", SimulationSettings(current_noise=2e-3, speeds=(-300.0,), inverter="two_stage")
    ),
}  # fmt: skip
RIPPLES = {
    "ipm, 500 rpm, 5 % at 50 Hz": (
        "ipm", SimulationSettings(current_noise=2e-3, speed_ripple=0.05, ripple_order=6)
    ),
    "spm, 1500 rpm, 10 % at 150 Hz": (
        "spm", SimulationSettings(current_noise=2e-3, speeds=(1500.0,), speed_ripple=0.1, ripple_order=6)
    ),
    "pmsyrm, -700 rpm, 5 % at 105 Hz, angle noise 2 mrad": (
        "pmsyrm",
        SimulationSettings(
            current_noise=2e-3, speeds=(-700.0,), speed_ripple=0.05, ripple_order=9, resolver_noise=2e-3
        ),
    ),
    "ipm, 800 rpm, 10 % at 240 Hz": (
        "ipm", SimulationSettings(current_noise=2e-3, speeds=(800.0,), speed_ripple=0.1, ripple_order=18)
    ),
}  # fmt: skip
"""Drives whose speed ripples; the last at nearly half the rate of an angle at every 20th sample."""
SECONDS = 4.0
DOCUMENT = Path(__file__).parent.parent / "docs" / "engineering" / "coverage.md"


def with_slow_angle(samples: Samples, every: int) -> Samples:
    """Return samples whose angle was recorded at every n-th of them only, without the speed, and interpolated."""
    wrapped = np.angle(np.exp(1j * samples.angle[::every]))
    found = interpolated_rotor(Signal("encoder", samples.stamp[::every], wrapped[:, None]), samples.stamp)
    angle, speed = found.signal.values.T
    return replace(samples.part(0, len(angle)), angle=angle, speed=speed, angle_error=found.error)


def scores(machine: str, settings: SimulationSettings, seed: int, every: int = 1) -> tuple[np.ndarray, ...]:
    """Return errors over standard errors of psi_d and psi_q (N,), R (1,) and the inverter's curve (C,)."""
    simulation = run_experiment(machine_map(machine), replace(settings, seed=seed), None, SECONDS)
    samples = with_slow_angle(simulation.samples, every) if every > 1 else simulation.samples
    evidence = gather([samples], FitSettings(method="full", harmonic_orders=(6, 12), maps="reciprocal", grid_points=33))
    found, truth = conclude(evidence, ()), simulation.truth
    current = found.inverter_current
    slope, drop = normalized_curve(truth, current)
    errors = against(found, partial(true_flux, truth), WITHIN * truth.i_max, truth.resistance + slope)
    large = np.abs(current) > 0.1 * truth.i_max
    assert found.sigma_inverter_voltage is not None  # method full gives one
    curve = (found.inverter_voltage - drop)[large] / found.sigma_inverter_voltage[large]
    return *errors.z.T, np.array([errors.resistance_z]), curve


def _share(found: list[tuple[np.ndarray, ...]], quantity: int) -> float:
    """Return the share of errors within the band."""
    return float(np.concatenate([np.abs(one[quantity]) < BAND for one in found]).mean())


def print_slow_angles(seeds: int) -> None:
    """Print the rms of error over standard error of psi_d, psi_q and R for angles of several rates."""
    print("| drive, speed ripple | every sample | every 10th | every 20th |\n|---|---|---|---|")
    for name, (machine, settings) in RIPPLES.items():
        cells = []
        for every in (1, 10, 20):
            found = [scores(machine, settings, seed, every)[:3] for seed in range(seeds)]
            cells.append(
                ", ".join(f"{np.sqrt(np.mean(np.concatenate(part) ** 2)):.2f}" for part in zip(*found, strict=True))
            )
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    """Print and, if asked to, write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--slow-angle", action="store_true")
    arguments = parser.parse_args()
    if arguments.slow_angle:
        print_slow_angles(arguments.seeds)
        return
    header = "| drive | psi_d | psi_q | R | inverter curve |\n|---|---|---|---|---|"
    lines = [header]
    print(header)
    for name, (machine, settings) in DRIVES.items():
        found = []
        for seed in range(arguments.seeds):
            found.append(scores(machine, settings, seed))
            if (seed + 1) % 10 == 0:
                print(f"{name}: {seed + 1} seeds", *(f"{_share(found, k):.4f}" for k in range(4)), flush=True)
        lines.append(f"| {name} | " + " | ".join(f"{100 * _share(found, k):.1f} %" for k in range(4)) + " |")
        print(lines[-1], flush=True)
    if arguments.write:
        text = (
            "# Coverage of the standard errors\n\n"
            f"Empirical coverage of nominal 95 % intervals (±{BAND} σ) over {arguments.seeds} repetitions of "
            f"{SECONDS:g} s with different noise (0.2 % of i_max). Counted are all map points within "
            f"{100 * WITHIN:.0f} % of the disc, and the inverter curve above a tenth of i_max. Produced by "
            f"`python benchmarks/uncertainty.py --seeds {arguments.seeds} --write`.\n\n"
        )
        DOCUMENT.write_text(text + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
