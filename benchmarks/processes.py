"""Whole processes on the same bags: time and peak memory, how they grow with the recording, and what a start takes."""

from __future__ import annotations

import sys
import tempfile
from functools import partial
from pathlib import Path

from measuring import HERE, Cost, best_of, process
from recordings import recording
from reporting import Row, Section, faster, seconds, size, smaller

SCRIPT = Path(sys.executable).with_name("drive-id")


def drive_id_fit(bag: Path, *options: str) -> Cost:
    """Run ``drive-id fit`` as a user does, result files and picture included."""
    with tempfile.TemporaryDirectory() as folder:
        return process([SCRIPT, "fit", bag, "--output", Path(folder) / "fit", "--method", "joint", "--quiet", *options])


def plain(bag: Path) -> Cost:
    """Run the plain rosbags and numpy script."""
    return process([sys.executable, HERE / "plain_script.py", bag])


def against_plain(folder: Path, repeats: int) -> Section:
    """Compare with the plain script at 10 s and at 60 s."""
    rows: list[Row] = []
    for duration, goal, less in ((10.0, 2, None), (60.0, 6, 8)):
        bag = recording(folder, duration)
        drive_id_fit(bag)  # compiles what is not in the cache yet
        count = repeats if duration < 60 else min(repeats, 2)
        costs = best_of({"plain": partial(plain, bag), "ours": partial(drive_id_fit, bag)}, count)
        rows += [
            faster(f"{duration:.0f} s: time", costs["plain"], costs["ours"], goal),
            smaller(f"{duration:.0f} s: peak memory", costs["plain"], costs["ours"], less),
        ]
    text = "`drive-id fit --method joint`, files and picture written, against `benchmarks/plain_script.py`."
    return Section("Whole process", text, tuple(rows))


def growth(folder: Path, durations: list[float], repeats: int) -> Section:
    """Fit ever longer bags; the baseline of each row is the one of 60 s."""
    costs: dict[float, Cost] = {}
    for duration in durations:
        bag = recording(folder, duration)
        drive_id_fit(bag)
        costs[duration] = best_of({"": partial(drive_id_fit, bag)}, repeats if duration < 600 else 1)[""]
    base = costs[60.0]
    rows = []
    for duration, cost in costs.items():
        goal = "≥ 150 × real time, memory ≤ 1.2 ×" if duration >= 3600 else ""
        real = f"{duration / cost.elapsed:.0f} × real time, {cost.memory / base.memory:.2f} × memory"
        cpu = f"{duration / cost.cpu:.0f} × real time"
        both = [f"{seconds(each.elapsed)}, {size(each.memory)}" for each in (base, cost)]
        rows.append(Row(f"{duration:.0f} s at 10 kHz", both[0], both[1], real, cpu, goal))
    text = "Time and peak memory of `drive-id fit --method joint` over the length of the recording; baseline: 60 s."
    return Section("Growth", text, tuple(rows))


def start_up(folder: Path, repeats: int) -> Section:
    """Measure what commands take that hardly work."""
    bag = recording(folder, 10.0)
    commands: dict[str, list[str | Path]] = {
        "bare": [sys.executable, "-c", "pass"],
        "numerics": [sys.executable, "-c", "import numpy, numba, scipy.interpolate, matplotlib.figure"],
        "help": [SCRIPT, "--help"],
        "info": [SCRIPT, "info", bag],
        "load": [sys.executable, "-c", "import drive_id.fitting.fit"],
    }
    costs = best_of({name: partial(process, words) for name, words in commands.items()}, max(repeats, 5))
    rows = (
        faster("`drive-id --help`", costs["numerics"], costs["help"]),
        faster("`drive-id info BAG`", costs["numerics"], costs["info"]),
        faster("loading what `drive-id fit` needs", costs["numerics"], costs["load"]),
    )
    text = (
        "Against importing numpy, numba, scipy.interpolate and matplotlib.figure; Python alone takes "
        f"{seconds(costs['bare'].elapsed)}."
    )
    return Section("Start", text, rows)
