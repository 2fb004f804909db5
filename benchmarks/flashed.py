"""Margins of exported C headers.

Usage: python benchmarks/flashed.py [--write]

The margins are those of six machines at 20 000 currents each, by the compiled header; ``--write`` puts them into
docs/engineering/control_measured.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from reporting import printed, write_between

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "engineering" / "control_measured.md"
sys.path.insert(0, str(ROOT / "test" / "support"))  # machines and compiler, which tests use as well


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


def main() -> None:
    """Measure, print and, with ``--write``, update the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write them into docs/engineering/control_measured.md")
    options = parser.parse_args()
    margin = printed(margins())
    if options.write:
        write_between(PAGE, "benchmarks/flashed.py, margins", margin)


if __name__ == "__main__":
    main()
