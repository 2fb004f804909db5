"""Whole processes on the same bags: time and peak memory, cold and warm, their growth, and what a start takes."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from measuring import HERE, Cost, best_of, process
from recordings import real_shaped, recording
from reporting import Row, Section, faster, seconds, size, smaller

SCRIPT = Path(sys.executable).with_name("drive-id")
DEFAULT, JOINT = (), ("--method", "joint")
_CACHE = "NUMBA_CACHE_DIR"


def drive_id_fit(bag: Path, *options: str) -> Cost:
    """Run ``drive-id fit`` as a user does, its result files included; pictures are not made unless asked for."""
    with tempfile.TemporaryDirectory() as folder:
        return process([SCRIPT, "fit", bag, "--output", Path(folder) / "fit", "--quiet", *options])


def plain(bag: Path) -> Cost:
    """Run the plain rosbags and numpy script."""
    return process([sys.executable, HERE / "plain_script.py", bag])


def against_plain(folder: Path, repeats: int) -> Section:
    """Compare the default and ``joint`` with the plain script at 10 s and at 60 s."""
    rows: list[Row] = []
    for duration, goals in ((10.0, (1.0, 1.8)), (60.0, (4, 9))):
        bag = recording(folder, duration)
        drive_id_fit(bag)  # compiles what is not in the cache yet
        costs = best_of(
            {
                "plain": partial(plain, bag),
                "full": partial(drive_id_fit, bag, *DEFAULT),
                "joint": partial(drive_id_fit, bag, *JOINT),
            },
            repeats if duration < 60 else min(repeats, 2),
        )
        for method, goal in zip(("full", "joint"), goals, strict=True):
            rows.append(faster(f"{duration:.0f} s, `{method}`: time", costs["plain"], costs[method], goal))
            rows.append(smaller(f"{duration:.0f} s, `{method}`: peak memory", costs["plain"], costs[method]))
    text = "`drive-id fit` with its result files, against `benchmarks/plain_script.py`: R, u_e and splines alone."
    return Section("Whole process", text, tuple(rows))


@contextmanager
def empty_cache() -> Iterator[None]:
    """Let processes find no machine code that was compiled before."""
    before = os.environ.get(_CACHE)
    with tempfile.TemporaryDirectory(prefix="drive_id_cold_") as folder:
        os.environ[_CACHE] = folder
        try:
            yield
        finally:
            del os.environ[_CACHE]
            if before is not None:
                os.environ[_CACHE] = before


def cold(folder: Path, repeats: int) -> Section:
    """Compare first fits with the next one: after ``make setup``, which compiles, and after ``pip install``."""
    bag = recording(folder, 10.0)
    rows: list[Row] = []
    for method, options in (("full", DEFAULT), ("joint", JOINT)):
        with empty_cache():
            first = drive_id_fit(bag, *options)
            warm = best_of({"": partial(drive_id_fit, bag, *options)}, repeats)[""]
        with empty_cache():
            compiling = process([sys.executable, "-m", "drive_id.fitting.kernels"])
            after_setup = drive_id_fit(bag, *options)
        for name, cost, goal in (
            ("after `pip install`", first, "≤ 15 s" if method == "full" else ""),
            ("after `make setup`", after_setup, "≤ 1.3 × warm"),
        ):
            ratio = f"{cost.elapsed / warm.elapsed:.1f} × warm"
            cpu = f"{cost.cpu / warm.cpu:.1f} × warm"
            title = f"`{method}`, first fit {name}"
            rows.append(Row(title, seconds(warm.elapsed), seconds(cost.elapsed), ratio, cpu, goal))
    text = (
        "A recording of 10 s; baseline: the next fit. `make setup` compiles on all cores, in "
        f"{seconds(compiling.elapsed)}; a pip installation compiles at its first fit and says so."
    )
    return Section("Cold start", text, tuple(rows))


def growth(folder: Path, durations: list[float], repeats: int) -> Section:
    """Fit ever longer bags; the baseline of each row is the second one, if there are several."""
    rows: list[Row] = []
    for method, options in (("full", DEFAULT), ("joint", JOINT)):
        costs: dict[float, Cost] = {}
        for duration in durations:
            bag = recording(folder, duration)
            costs[duration] = best_of({"": partial(drive_id_fit, bag, *options)}, repeats if duration < 600 else 1)[""]
        base = costs[durations[:2][-1]]
        for duration, cost in costs.items():
            goal = {600.0: "≥ 40 × real time", 3600.0: "≤ 1.3 × memory"}.get(duration, "") if method == "full" else ""
            real = f"{duration / cost.elapsed:.0f} × real time, {cost.memory / base.memory:.2f} × memory"
            cpu = f"{duration / cost.cpu:.0f} × real time"
            both = [f"{seconds(each.elapsed)}, {size(each.memory)}" for each in (base, cost)]
            rows.append(Row(f"`{method}`, {duration:.0f} s at 10 kHz", both[0], both[1], real, cpu, goal))
    text = "Time and peak memory of `drive-id fit` over the length of the recording; "
    text += f"baseline: {durations[:2][-1]:g} s."
    return Section("Growth", text, tuple(rows))


def real_machines(folder: Path, repeats: int) -> Section:
    """Compare machines that bend as real ones do with the smooth one of the other rows, at 10 s."""
    bags = {"": recording(folder, 10.0)} | real_shaped(folder)
    costs = best_of({name: partial(drive_id_fit, bag) for name, bag in bags.items()}, repeats)
    base, rows = costs.pop(""), list[Row]()
    for name, cost in costs.items():
        both = [f"{seconds(each.cpu)}, {size(each.memory)}" for each in (base, cost)]
        ratio = f"{cost.elapsed / base.elapsed:.1f} ×, {cost.memory / base.memory:.1f} × memory"
        rows.append(Row(name, both[0], both[1], ratio, f"{cost.cpu / base.cpu:.1f} ×", "≤ 10 s, ≤ 1 GB"))
    text = "CPU time and peak memory of `drive-id fit`, 10 s; baseline: the smooth machine of the other rows."
    return Section("Real-shaped machines", text, tuple(rows))


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
