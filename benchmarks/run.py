"""Print what the package costs as ratios against stated baselines, in one run on this machine, and write them down.

Usage: python benchmarks/run.py [--only PART,...] [--hour] [--quick] [--output FILE]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as drive-id sets it: before numpy is loaded

import fleet
import processes
import safety
import streams
from reporting import Section, machine, show, write
from rich.console import Console

PAGE = Path(__file__).parent.parent / "docs" / "engineering" / "performance.md"
LENGTHS, QUICK = [10.0, 60.0, 600.0], [1.0]
"""Of the recordings whose growth of time and memory is measured, s; the second or only one is the baseline."""
HOUR = 3600.0


def parts(folder: Path, options: argparse.Namespace) -> dict[str, Callable[[], Section]]:
    """Return what can be measured, by name."""
    repeats = 1 if options.quick else options.repeats
    lengths = (QUICK if options.quick else LENGTHS) + ([options.hour] if options.hour else [])
    return {
        "process": lambda: processes.against_plain(folder, repeats),
        "cold": lambda: processes.cold(folder, repeats),
        "growth": lambda: processes.growth(folder, lengths, repeats),
        "machines": lambda: processes.real_machines(folder, repeats),
        "start": lambda: processes.start_up(folder, repeats),
        "live": lambda: streams.section(folder, repeats, 1.0 if options.quick else 10.0),
        "safety": lambda: safety.section(repeats),
        "fleet": lambda: fleet.section(folder, repeats, 60.0 if options.quick else fleet.SECONDS),
    }


def _command(options: argparse.Namespace) -> str:
    """Return the command that measures the same again."""
    flags = [f"--{name}" for name in ("hour", "quick") if getattr(options, name)]
    flags += [f"--only {options.only}"] if options.only else []
    return "make bench" + (f' ARGS="{" ".join(flags)}"' if flags else "")


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description="Measure drive_id against stated baselines.")
    parser.add_argument(
        "--only", default="", help="names of parts, with commas: process,cold,growth,machines,start,live,safety,fleet"
    )
    parser.add_argument(
        "--hour", nargs="?", type=float, const=HOUR, metavar="SECONDS",
        help="also fit an hour at 10 kHz (1.2 GB of disk, minutes), or so many seconds",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="one run of each, short recordings: to see that all works")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which the best counts")
    parser.add_argument("--bags", type=Path, help="keep the recordings in this folder, and take those that are there")
    parser.add_argument(
        "--output", type=Path, help="page to write; by default docs/engineering/performance.md, if all was measured"
    )
    options = parser.parse_args()
    console = Console(width=150)
    data = machine()
    console.print(*data, sep="\n", highlight=False)
    keep = options.bags
    if keep:
        keep.mkdir(parents=True, exist_ok=True)
    with nullcontext(keep) if keep else tempfile.TemporaryDirectory(prefix="drive_id_benchmark_") as folder:
        available = parts(Path(folder), options)
        wanted = options.only.split(",") if options.only else list(available)
        sections = []
        for name in wanted:
            sections.append(available[name]())
            show(sections[-1], console)
    complete = not options.only and not options.quick
    page = options.output or (PAGE if complete else None)
    if page:
        write(page, data, sections, _command(options))
        console.print(f"Written to {page}")


if __name__ == "__main__":
    main()
