"""How much faster two workers of a fleet are than one, on eight bags.

Usage: python benchmarks/fleet.py [--seconds 300] [--repeats 3] [--bags FOLDER]
"""

from __future__ import annotations

import argparse
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
from drive_id.fitting.cluster import accumulate_on_cluster, connected
from drive_id.fitting.sources import Sources

SCRIPT = Path(sys.executable).with_name("drive-id")
BAGS = 8
SECONDS = 300.0
I_MAX = 300.0
GOAL = 1.6


def work(bags: list[Path], workers: int) -> Cost:
    """Accumulate and merge on workers that have been started and have compiled; the CPU time is the busiest one's."""
    settings = FitSettings(method="joint", i_max=I_MAX)
    with connected(f"local:{workers}", workers) as client:
        address = client.scheduler.address
        accumulate_on_cluster(Sources(bags[:workers], cluster=address), settings)
        before = client.run(time.process_time)
        start = time.perf_counter()
        accumulate_on_cluster(Sources(bags, cluster=address), settings)
        elapsed = time.perf_counter() - start
        after = client.run(time.process_time)
    return Cost(elapsed, max(after[worker] - before[worker] for worker in before))


def command(bags: list[Path], workers: int) -> Cost:
    """Run the whole command, start of the workers, solution and picture included."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["--method", "joint", "--i-max", I_MAX, "--dask", f"local:{workers}", "--quiet"]
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
    whole = replace(faster("`drive-id fit --dask` as a whole", command_1, command_2), cpu_ratio="")
    rows = (faster("accumulating and merging", work_1, work_2, GOAL), whole)
    text = (
        f"Two local Dask workers against one, {BAGS} bags of {duration:.0f} s at 10 kHz, method `joint`. CPU time: "
        "that of the busiest worker."
    )
    return Section("Fleet", text, rows)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Compare one Dask worker with two.")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="length of each of the eight bags")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which the best counts")
    parser.add_argument("--bags", type=Path, help="keep the recordings in this folder, and take those that are there")
    options = parser.parse_args()
    if options.bags:
        options.bags.mkdir(parents=True, exist_ok=True)
    with nullcontext(options.bags) if options.bags else tempfile.TemporaryDirectory() as folder:
        show(section(Path(folder), options.repeats, options.seconds), Console(width=150))


if __name__ == "__main__":
    main()
