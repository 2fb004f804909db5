"""Rows of ratios: on the terminal, and in docs/engineering/performance.md with the data of the machine."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from measuring import Cost
from rich.console import Console
from rich.table import Table

COLUMNS = ("Measured", "Baseline", "drive_id", "Ratio", "of CPU time", "Goal")
_PACKAGES = ("numpy", "scipy", "numba", "rosbags", "distributed")


@dataclass(frozen=True)
class Row:
    """One comparison, as texts."""

    what: str
    baseline: str
    ours: str
    ratio: str
    cpu_ratio: str = ""
    goal: str = ""


@dataclass(frozen=True)
class Section:
    """Comparisons that belong together, and what is to be said about them."""

    title: str
    text: str
    rows: tuple[Row, ...]


def faster(what: str, baseline: Cost, ours: Cost, goal: float | None = None) -> Row:
    """Compare times."""
    ratio, cpu = baseline.elapsed / ours.elapsed, baseline.cpu / max(ours.cpu, 1e-6)
    wanted = "" if goal is None else f"≥ {goal:g} ×"
    return Row(what, seconds(baseline.elapsed), seconds(ours.elapsed), _times(ratio), _times(cpu), wanted)


def smaller(what: str, baseline: Cost, ours: Cost) -> Row:
    """Compare peak memory."""
    return Row(what, size(baseline.memory), size(ours.memory), f"1/{baseline.memory / ours.memory:.1f}")


def seconds(value: float) -> str:
    """Write a duration."""
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")):
        if value * factor >= 0.9995:
            return f"{value * factor:.3g} {unit}"
    return f"{value * 1e9:.3g} ns"


def size(value: float) -> str:
    """Write a memory size."""
    return f"{value / 1e6:.0f} MB" if value < 1e9 else f"{value / 1e9:.2f} GB"


def _times(ratio: float) -> str:
    return f"{ratio:.2g} ×" if ratio < 10 else f"{ratio:.0f} ×"


def show(section: Section, console: Console) -> None:
    """Print a section."""
    table = Table(title=section.title, title_justify="left", caption=section.text, caption_justify="left")
    for number, name in enumerate(COLUMNS):
        table.add_column(name, justify="right" if number else "left")
    for row in section.rows:
        table.add_row(row.what, row.baseline, row.ours, row.ratio, row.cpu_ratio, row.goal)
    console.print(table)


def write(path: Path, data: Sequence[str], sections: Sequence[Section], command: str) -> None:
    """Write all sections as a page of the documentation."""
    lines = [
        "# Performance",
        "",
        f"Written by `{command}`; all ratios are from one run on one machine. Both sides of a ratio run alternately,",
        "and the best of several runs counts. On a shared machine, the ratio of CPU times is more reliable.",
        "",
        *data,
    ]
    for section in sections:
        lines += ["", f"## {section.title}", "", section.text, "", f"| {' | '.join(COLUMNS)} |"]
        lines.append("|---" + "|---:" * (len(COLUMNS) - 1) + "|")
        lines += [
            f"| {row.what} | {row.baseline} | {row.ours} | {row.ratio} | {row.cpu_ratio} | {row.goal} |"
            for row in section.rows
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def machine() -> list[str]:
    """Return lines about processor, system, versions and how busy the machine is."""
    info = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    models = [line.partition(":")[2].strip() for line in info.splitlines() if line.startswith("model name")]
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    packages = ", ".join(f"{name} {found}" for name in _PACKAGES if (found := _version(name)))
    return [
        f"- Processor: {models[0] if models else platform.machine()}, {os.cpu_count()} cores; {memory / 1e9:.0f} GB",
        f"- Python {platform.python_version()}, {packages}",
        f"- Threads of BLAS in each process: {os.environ.get('OPENBLAS_NUM_THREADS', 'as many as processors')}",
        f"- Load when the run began: {os.getloadavg()[0]:.1f} processes",
    ]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def printed(lines: Iterable[str]) -> str:
    """Print lines as they come, and return them together."""
    found = []
    for line in lines:
        print(line, flush=True)
        found.append(line)
    return "\n".join(found)


def write_between(page: Path, name: str, text: str) -> None:
    """Replace what stands in a page between the comment with this name and the next ``<!-- end -->``."""
    begin, end = f"<!-- {name} -->", "<!-- end -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    if not found:
        raise SystemExit(f"{page} has no line {begin}: add it, and {end} below.")
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{rest.partition(end)[2]}", encoding="utf-8")
