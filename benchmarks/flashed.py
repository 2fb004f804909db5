"""Margins of exported C headers, and standard errors of derived figures against the scatter of drives that err.

Usage: python benchmarks/flashed.py [--draws N] [--write]

The margins are those of six machines at 20 000 currents each, by the compiled header; ``--write`` puts them into
docs/engineering/control_measured.md. With ``--draws``, the standard errors of ``analyze`` for a fit of 10 s are printed
over the scatter of as many analyses of drives that differ by random amounts of all causes of error; each takes a
second or more.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
from reporting import printed, write_between

from drive_id.analysis.analyze import analyze
from drive_id.analysis.settings import AnalysisSettings
from drive_id.bench.settings import SimulationSettings
from drive_id.fitting.fit import fit
from drive_id.fitting.simulated import load_machine, run_experiment

MACHINES = ("ipm", "spm", "pmsyrm")
SMALL = AnalysisSettings(current_points=3, torque_points=1, speed_points=7)
ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "engineering" / "control_measured.md"
sys.path.insert(0, str(ROOT / "test" / "support"))  # machines, compiler and drives that err, which tests use as well


def margins() -> Iterator[str]:
    """Yield the lines of the table of margins."""
    machines, header = import_module("flashed_machines"), import_module("compiled_header")
    yield "| Machine | stated margin | worst of 20 000 currents | bandwidth, 1000 Hz asked | points, 21 × 21 asked |"
    yield "|---|---:|---:|---:|---:|"
    for name in machines.NAMES:
        with tempfile.TemporaryDirectory() as folder:
            found = header.header_margins(machines.drive(name), Path(folder))
        points = " × ".join(map(str, found.points))
        yield f"| {name} | {found.stated:.1f}° | {found.worst:.2f}° | {found.bandwidth:.0f} Hz | {points} |"


def scatter(draws: int) -> Iterator[str]:
    """Yield the lines of the table of standard errors over scatter."""
    erring, ratios = import_module("erring").erring, dict[str, list[str]]()
    for name in MACHINES:
        machine = load_machine(name)
        result = fit(run_experiment(machine, SimulationSettings(current_noise=1e-3), seconds=10.0).samples)
        wanted = replace(SMALL, pole_pairs=machine.pole_pairs, u_dc=(machine.u_dc,))
        modes, figures = result.drive.error_modes, analyze(result, wanted).figures
        rng = np.random.default_rng(1)
        others = [analyze(erring(result, rng.normal(size=len(modes or ()))), wanted).figures for _ in range(draws)]
        for key, figure in figures.items():
            values = [other[key].value for other in others if key in other]
            known = np.isfinite(figure.sigma) and len(values) == draws
            told = f"{figure.sigma / np.std(values):.2f}" if known and np.std(values) > 0 else "none"
            ratios.setdefault(key, ["–"] * len(MACHINES))[MACHINES.index(name)] = told
    yield "| Figure | " + " | ".join(f"`{name}`" for name in MACHINES) + " |"
    yield "|---|" + "---:|" * len(MACHINES)
    for key, cells in ratios.items():
        yield f"| `{key}` | {' | '.join(cells)} |"


def main() -> None:
    """Measure, print and, with ``--write``, update the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=0, help="drives that err, of each machine; 0: none")
    parser.add_argument("--write", action="store_true", help="write them into docs/engineering/control_measured.md")
    options = parser.parse_args()
    margin = printed(margins())
    if options.write:
        write_between(PAGE, "benchmarks/flashed.py, margins", margin)
    if options.draws:
        printed(scatter(options.draws))


if __name__ == "__main__":
    main()
