"""Empirical coverage of the standard errors of method ``full``: repeat an experiment with different noise and count.

    python benchmarks/uncertainty.py [--seeds 200] [--write]

Prints the share of intervals of ±1.96 σ that contain the truth: of the fluxes at all map points with data within 97 %
of the disc, of the resistance, and of the inverter curve. ``--write`` puts the table into docs/engineering/coverage.md.
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
from drive_id.core.validation.metrics import true_flux
from drive_id.fitting.simulated import run_experiment

WITHIN = 0.97
DRIVES = {
    "ipm, 500 rpm, dead time": ("ipm", SimulationSettings(current_noise=2e-3)),
    "spm, 1000 rpm, tanh": ("spm", SimulationSettings(current_noise=2e-3, speeds=(1000.0,), inverter="tanh")),
    "pmsyrm, -300 rpm, dead time and devices": (
        "pmsyrm", SimulationSettings(current_noise=2e-3, speeds=(-300.0,), inverter="two_stage")
    ),
}  # fmt: skip
SECONDS = 4.0
DOCUMENT = Path(__file__).parent.parent / "docs" / "engineering" / "coverage.md"


def scores(machine: str, settings: SimulationSettings, seed: int) -> tuple[np.ndarray, ...]:
    """Return errors over standard errors of psi_d and psi_q (N,), R (1,) and the inverter's curve (C,)."""
    simulation = run_experiment(machine_map(machine), replace(settings, seed=seed), None, SECONDS)
    evidence = gather(
        [simulation.samples], FitSettings(method="full", harmonic_orders=(6, 12), maps="reciprocal", grid_points=33)
    )
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


def main() -> None:
    """Print and, if asked to, write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
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
