"""How much faster two processes are than one, on eight bags.

Usage: python benchmarks/fleet.py [--seconds 300] [--repeats 3] [--bags FOLDER] [--dask ADDRESS]

With --dask, the workers of a running Dask cluster do the work of the two processes.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from measuring import Cost, best_of, process
from recordings import copies
from reporting import Section, faster, show
from rich.console import Console

from drive_id.core.fit_settings import FitSettings
from drive_id.fitting.dask_cluster import on_dask
from drive_id.fitting.sources import Sources, accumulate_sources

SCRIPT = Path(sys.executable).with_name("drive-id")
BAGS = 8
SECONDS = 300.0
I_MAX = 300.0


def work(bags: list[Path], workers: int, dask: str = "") -> Cost:
    """Accumulate and merge, the start of the processes included, or the connection with a cluster."""
    start, before = time.perf_counter(), os.times()
    sources = Sources(bags, workers=workers)
    with on_dask(sources, dask) if dask else nullcontext(sources) as placed:
        accumulate_sources(placed, FitSettings(method="joint", i_max=I_MAX))
    after = os.times()
    used = sum(getattr(after, name) - getattr(before, name) for name in ("user", "children_user"))
    return Cost(time.perf_counter() - start, used)


def command(bags: list[Path], workers: int) -> Cost:
    """Run the whole command, start of the workers, solution and picture included."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["--method", "joint", "--i-max", I_MAX, "--workers", workers, "--quiet"]
        return process([SCRIPT, "fit", *bags, "--output", Path(folder) / "fit", *map(str, options)])


def section(folder: Path, repeats: int, duration: float = SECONDS) -> Section:
    """Compare one worker with two."""
    bags = copies(folder, duration, BAGS)
    costs = best_of(
        {
            "work 1": lambda: work(bags, 1),
            "work 2": lambda: work(bags, 2),
            "command 1": lambda: command(bags, 1),
            "command 2": lambda: command(bags, 2),
        },
        repeats,
    )
    work_1, work_2, command_1, command_2 = costs.values()
    whole = replace(faster("`drive-id fit --workers 2` as a whole", command_1, command_2), cpu_ratio="")
    rows = (faster("accumulating and merging", work_1, work_2), whole)
    text = (
        f"Two processes against one, {BAGS} bags of {duration:.0f} s at 10 kHz, method `joint`, start of the processes "
        "included. CPU time: that of all processes."
    )
    return Section("Fleet", text, rows)


def on_cluster(folder: Path, repeats: int, duration: float, dask: str) -> Section:
    """Compare one process with a cluster."""
    bags = copies(folder, duration, BAGS)
    one, cluster = best_of({"1": lambda: work(bags, 1), "cluster": lambda: work(bags, 1, dask)}, repeats).values()
    rows = (replace(faster("accumulating and merging", one, cluster), cpu_ratio=""),)
    return Section("Fleet", f"A Dask cluster against one process, {BAGS} bags of {duration:.0f} s, `joint`.", rows)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Compare one process with two.")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="length of each of the eight bags")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which the best counts")
    parser.add_argument("--bags", type=Path, help="keep the recordings in this folder, and take those that are there")
    parser.add_argument("--dask", default="", help="address of a Dask scheduler: measure its cluster instead")
    options = parser.parse_args()
    if options.bags:
        options.bags.mkdir(parents=True, exist_ok=True)
    with nullcontext(options.bags) if options.bags else tempfile.TemporaryDirectory() as folder:
        measured = (Path(folder), options.repeats, options.seconds)
        show(on_cluster(*measured, options.dask) if options.dask else section(*measured), Console(width=150))


if __name__ == "__main__":
    main()
