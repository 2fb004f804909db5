"""How much faster two processes are than one, on eight bags."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from measuring import Cost, best_of, process
from recordings import copies
from reporting import Section, faster

from drive_id.core.fit_settings import FitSettings
from drive_id.fitting.sources import Sources, accumulate_sources

SCRIPT = Path(sys.executable).with_name("drive-id")
BAGS = 8
SECONDS = 300.0  # of each bag
I_MAX = 300.0


def work(bags: list[Path], workers: int) -> Cost:
    """Accumulate and merge, the start of the processes included."""
    start, before = time.perf_counter(), os.times()
    accumulate_sources(Sources(bags, workers=workers), FitSettings(method="joint", i_max=I_MAX))
    after = os.times()
    used = sum(getattr(after, name) - getattr(before, name) for name in ("user", "children_user"))
    return Cost(time.perf_counter() - start, used)


def command(bags: list[Path], workers: int) -> Cost:
    """Run the whole command, start of the workers, solution and picture included."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["--method", "joint", "--i-max", I_MAX, "--workers", workers, "--quiet"]
        return process([SCRIPT, "fit", *bags, "--output", Path(folder) / "fit", *map(str, options)])


def section(folder: Path, repeats: int, duration: float) -> Section:
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
