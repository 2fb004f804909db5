"""Do the stated deviations of method ``full`` hold? Repeat one experiment with other noise and count.

    python benchmarks/coverage.py [--seeds 200] [--write]

Prints how often bands of 1.96 deviations hold the truth: of the fluxes at all points of the map with data within 97 % of
the disc, of the resistance, and of the inverter's curve. ``--write`` puts the table into docs/coverage.md.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from drive_id.core.conclusion import conclude
from drive_id.core.fit_settings import FitSettings
from drive_id.core.identify import gather
from drive_id.core.metrics import true_flux
from drive_id.sim.machines import machine_map
from drive_id.sim.settings import SimulationSettings
from drive_id.workflows import run_experiment

BAND = 1.96
WITHIN = 0.97
DRIVES = {
    "ipm, 500 rpm": ("ipm", SimulationSettings(current_noise=2e-3)),
    "spm, -700 rpm, tanh": ("spm", SimulationSettings(current_noise=2e-3, speeds=(-700.0,), inverter="tanh")),
}
SECONDS = 6.0
DOCUMENT = Path(__file__).parent.parent / "docs" / "coverage.md"


def scores(machine: str, settings: SimulationSettings, seed: int) -> tuple[np.ndarray, ...]:
    """Return errors over deviations of psi_d and psi_q (N,), R (1,) and the inverter's curve (C,)."""
    simulation = run_experiment(machine_map(machine), replace(settings, seed=seed), None, SECONDS)
    evidence = gather([simulation.samples], FitSettings(method="full", i_max=simulation.truth.i_max))
    found, truth = conclude(evidence, ()), simulation.truth
    flux_map = found.flux_map
    grid = flux_map.grid()
    chosen = flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= WITHIN * truth.i_max)
    true = true_flux(truth, grid[chosen])
    d = (flux_map.psi_d[chosen] - true[:, 0]) / flux_map.sigma_d[chosen]
    q = (flux_map.psi_q[chosen] - true[:, 1]) / flux_map.sigma_q[chosen]
    resistance = np.array([(found.resistance - truth.resistance) / found.sigma_resistance])
    current = found.inverter_current
    large = np.abs(current) > 0.1 * truth.i_max
    drop = np.interp(current, truth.inverter_current, truth.inverter_voltage)
    curve = (found.inverter_voltage - drop)[large] / found.inverter_deviation[large]
    return d, q, resistance, curve


def main() -> None:
    """Print and, if asked to, write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    header = "| drive | psi_d | psi_q | R | inverter curve |\n|---|---|---|---|---|"
    lines = [header]
    print(header)  # noqa: T201
    for name, (machine, settings) in DRIVES.items():
        found = [scores(machine, settings, seed) for seed in range(arguments.seeds)]
        inside = [np.concatenate([np.abs(one[k]) < BAND for one in found]).mean() for k in range(4)]
        lines.append(f"| {name} | " + " | ".join(f"{100 * share:.1f} %" for share in inside) + " |")
        print(lines[-1], flush=True)  # noqa: T201
    if arguments.write:
        text = (
            "# Do the stated deviations hold?\n\n"
            f"Share of bands of {BAND} deviations that hold the truth, over {arguments.seeds} repetitions of {SECONDS:g} s "
            f"with other noise (0.2 % of i_max): all points of the map within {100 * WITHIN:.0f} % of the disc, the "
            "resistance, and the inverter's curve above a tenth of i_max. 95 % are wanted. Produced by "
            f"`python benchmarks/coverage.py --seeds {arguments.seeds} --write`.\n\n"
        )
        DOCUMENT.write_text(text + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
