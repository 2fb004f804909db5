"""How ``verify`` judges independent recordings of the same machine, and of one whose magnet is 5 K warmer.

Usage: python benchmarks/verification.py [--seeds 4] [--write]

A map from 10 s at 500 rpm is judged by 8 s at 700 rpm, with other noise (0.1 % of i_max). ``--write`` puts the figures
into docs/engineering/verification_measured.md. They do not depend on the computer.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from reporting import printed, write_between

from drive_id.analysis.verification import verify
from drive_id.bench.settings import SimulationSettings
from drive_id.fitting.fit import fit
from drive_id.fitting.simulated import load_machine, run_experiment

MACHINES = ("ipm", "spm", "pmsyrm")
MAP, OTHER = SimulationSettings(current_noise=1e-3), SimulationSettings(current_noise=1e-3, speeds=(700.0,))
CASES = {"the same": OTHER, "magnet 5 K warmer, 0.5 % weaker": replace(OTHER, magnet_temperature=25.0)}
PAGE = Path(__file__).parent.parent / "docs" / "engineering" / "verification_measured.md"


def rows(seeds: int) -> Iterator[str]:
    """Yield the lines of the table: ranges over the seeds."""
    yield "| Machine | Recording | rms of all differences, standard errors | worst cell, standard errors |"
    yield "|---|---|---:|---:|"
    for name in MACHINES:
        machine = load_machine(name)
        found = {label: np.empty((seeds, 2)) for label in CASES}
        for seed in range(seeds):
            result = fit(run_experiment(machine, replace(MAP, seed=seed), None, 10.0).samples)
            for label, settings in CASES.items():
                other = run_experiment(machine, replace(settings, seed=100 + seed), None, 8.0).samples
                size = np.abs(verify(result, other).in_sigma)
                found[label][seed] = np.sqrt(np.mean(size**2)), size.max()
        for label, figures in found.items():
            ranges = (f"{low:.3g} to {high:.3g}" for low, high in zip(figures.min(0), figures.max(0), strict=True))
            yield f"| `{name}` | {label} | {' | '.join(ranges)} |"


def main() -> None:
    """Measure, print and, with ``--write``, update the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4, help="pairs of recordings of each machine")
    parser.add_argument("--write", action="store_true", help="write docs/engineering/verification_measured.md")
    options = parser.parse_args()
    table = printed(rows(options.seeds))
    if options.write:
        write_between(PAGE, "benchmarks/verification.py", table)


if __name__ == "__main__":
    main()
