"""The time of the rows of a table: the column that holds it, its unit, and stamps that go on."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from drive_id.core.checks.recognition import is_count
from drive_id.core.signals.equal_spacing import equal_spacing
from drive_id.core.signals.restarts import Restarts
from drive_id.files.logs.column_log import part_of_second, seconds_columns
from drive_id.files.messages.signal_sources import STAMP_UNITS
from drive_id.inspection.contents import Contents, Table
from drive_id.inspection.names import quoted, stated_unit, suggests
from drive_id.inspection.scales import is_whole
from drive_id.types import FloatArray, IntArray

FEWEST = 200
"""Rows by which a column is recognized at least."""
JITTER = 0.02
"""Jitter of the stamps, by the period, from which they are replaced by equally spaced ones."""
PERIODS = (5e-7, 0.05)
"""Shortest and longest plausible sample period, s."""
INDEX = "index"
"""Stamp source for row numbers."""
GUESSED_PERIOD = 1e-4
"""Period that the draft assumes for a log without a time column, s."""
_USUAL_LEAST = 0.02
"""Quantile of the steps between sorted times that is one period: rounding makes a few smaller."""
_LONGEST = 2.0**62  # ns, which stamps hold
_REGULAR = 1e-3
"""Relative spread of the steps of a column that may be a time without a name."""
_ONWARD = 0.9  # share of the steps of a time that do not run back
_MOST_PER_STAMP = 0.02
"""Share of all rows that may share one printed time: fewer digits tell no period."""
_DATES = (1e18, 3e18)
"""Nanoseconds since 1970 from 2001 to 2065, as dates are read: no other quantity of a log is as large."""
_DAYS = (30_000.0, 80_000.0)
"""Days since 1900 of serial dates from 1982 to 2119, as spreadsheets write them."""
_USUAL_UNITS = ("s", "ms", "us", "ns")
"""Units that a time may have though nothing states one."""
_DAY = "d"
_TICKS = STAMP_UNITS | {_DAY: 8.64e13}
"""ns in the units of a time."""
_IN_BRACKETS = re.compile(r"[\[(] *(min|h) *[\])]$")
"""Long units of a time, which no other quantity has in brackets."""
_BITS = (16, 24, 32)
"""Widths of timers whose count starts again."""
_TOGETHER = 0.01
"""Difference of the begins of times of one clock, by the span of the longest."""
_OF_PERIOD = ("dt", "deltat", "sampleperiod", "samplingperiod", "sampleinterval", "samplinginterval")
"""Names of the time between rows, s, without signs."""
_OF_ANY = ("ts", "tsample", "sampletime", "period")
"""Names of a sample time, s, of rows or of a control."""
_OF_RATE = ("fs", "fsample", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency")
"""Names of a sample rate, Hz, likewise."""
_MEANINGS = ("angle", "speed", "current", "voltage", "reference")


def timed(table: Table, contents: Contents) -> Table:
    """Return a table of columns with stamps from the column that looks like its time."""
    if len(table.stamp) or contents.is_bag:
        return table
    found = time_column(table)
    if found is None:
        return table
    return stamped(table, found.name, found.tick)


def stamped(table: Table, name: str, tick: float) -> Table:
    """Return a table with the stamps of a column in units of ``tick`` ns, and of the nanoseconds beside it."""
    both = seconds_columns(name, table.columns)
    seconds = table.columns[both[0] if both else name]
    stamp = np.rint((seconds - seconds[:1]) * tick).astype(np.int64)
    if both:
        part = table.columns[both[1]] * part_of_second(both[1])
        stamp += np.rint(part - part[:1]).astype(np.int64)
    return replace(table, stamp=Restarts().continued(stamp), stamp_source=name)


def together(tables: list[Table]) -> list[Table]:
    """Return tables whose own time columns give their stamps with stamps from the first of them all.

    Their clocks are one where they begin within the span of the longest; others each begin at zero.
    """
    began = [_began(table) for table in tables]
    base = min((first for first in began if first is not None), default=0)
    span = max((int(table.stamp[-1] - table.stamp[0]) for table in tables if len(table.stamp)), default=0)
    if any(first is not None and first - base > span for first in began):
        return tables
    return [
        table if first is None else replace(table, stamp=table.stamp + (first - base))
        for table, first in zip(tables, began, strict=True)
    ]


def _began(table: Table) -> int | None:
    """Return the time, ns, of the first row by the column that gives the stamps; None without one."""
    found = time_column(table) if table.stamp_source in table.columns else None
    if found is None or found.name != table.stamp_source:
        return None
    both = seconds_columns(found.name, table.columns)
    first = float(table.columns[both[0] if both else found.name][0]) * found.tick
    return round(first) + (round(float(table.columns[both[1]][0]) * part_of_second(both[1])) if both else 0)


def numbered(table: Table, contents: Contents) -> Table:
    """Return a table without a time column with stamps from row numbers, at a rate that is stated or guessed."""
    rows, stated = len(next(iter(table.columns.values()), ())), stated_period(contents)
    period = stated.seconds if stated else GUESSED_PERIOD
    return replace(table, stamp=np.rint(np.arange(rows) * (1e9 * period)).astype(np.int64), stamp_source=INDEX)


class StatedPeriod(NamedTuple):
    """Sample period that a log states beside its columns."""

    seconds: float
    name: str  # of what states it
    sure: bool  # that it is of the rows: the sample time of a control is known by the same name


def stated_period(contents: Contents) -> StatedPeriod | None:
    """Return the sample period that single numbers of a log, such as ``fs``, state; None unless they agree."""
    found = list[StatedPeriod]()
    for name, value in contents.facts.items():
        own = re.sub(r"[^a-z]", "", re.split(r"[./]", name)[-1].lower())
        of_time = own in (*_OF_PERIOD, *_OF_ANY)
        period = value if of_time else 1.0 / value if own in _OF_RATE and value > 0 else 0.0
        if PERIODS[0] <= period <= PERIODS[1]:
            found.append(StatedPeriod(period, name.strip("/"), own not in _OF_ANY))
    found = [each for each in found if each.sure] or found
    return found[0] if len({f"{each.seconds:.6g}" for each in found}) == 1 else None


def by_own_time(table: Table) -> Iterator[Table]:
    """Yield a table divided at its time columns, where each signal or each few of them follow their own.

    They are of one clock and begin together: a further time of the same rows follows another at once, or ends the
    table. Columns of equal times stay together.
    """
    if len(table.stamp):
        yield table
        return
    names = list(table.columns)
    spans = {k: span for k, name in enumerate(names) if (span := _span(table, name))}
    edges = [*spans, len(names)]
    begins, lasts = np.array([*spans.values()]).reshape(-1, 2).T
    apart = len(spans) > 1 and edges[0] == 0 and min(np.diff(edges)) > 1
    if apart and np.ptp(begins) < _TOGETHER * float(np.max(lasts - begins)):
        parts: dict[bytes, list[str]] = {}
        for first, following in pairwise(edges):
            parts.setdefault(table.columns[names[first]].tobytes(), []).extend(names[first:following])
        for part in parts.values():
            yield replace(table, columns={name: table.columns[name] for name in part})
    else:
        yield table


def _span(table: Table, name: str) -> tuple[float, float] | None:
    """Return the first and last time, ns, of a column that looks like a time on its own; None if it does not."""
    x = table.columns[name][np.isfinite(table.columns[name])]
    found = time_column(replace(table, columns={name: x}))
    return (float(x[0]) * found.tick, float(x[-1]) * found.tick) if found else None


def regular_stamps(table: Table) -> IntArray:
    """Return the stamps of a table, without jitter if they have much."""
    period, jitter = table.period, table.jitter
    if period is None or jitter is None or jitter < JITTER * period * table.block:
        return table.stamp
    return equal_spacing(table.stamp, np.ones(len(table.stamp), np.int64), name=table.name).stamp


def stamp_unit(table: Table, name: str) -> str:
    """Return the unit of a time that the log or its name states; empty if neither does."""
    long = _IN_BRACKETS.search(name)
    unit = long[1] if long else "".join(stated_unit(name, table.unit(name)))
    return unit if unit in STAMP_UNITS else ""


class TimeColumn(NamedTuple):
    """The column of the time."""

    name: str
    unit: str = "s"
    stated: bool = True  # the log or the values show the unit: whole numbers may be ticks of any timer

    @property
    def tick(self) -> float:
        """Factor to ns."""
        return _TICKS[self.unit]

    def settings(self, x: FloatArray) -> list[str]:
        """Return what a signals file says of it, by its values (N,)."""
        steps = np.diff(x)
        back, usual = float(steps.min()), float(np.median(steps))
        bits = [f"stamp_bits: {k}" for k in _BITS if back < 0 and abs(back + 2**k - usual) < usual / 2]
        unit = f"stamp_scale: {self.tick * 1e-9:g}" if self.unit == _DAY else f"stamp_unit: {self.unit}"
        return [f"stamp: {quoted(self.name)}", *bits, unit]


def time_column(table: Table) -> TimeColumn | None:
    """Return the column that looks like the time; None if none does.

    A number of the row is no time.
    """
    named = [(name, x) for name, x in table.columns.items() if suggests(name, "time")]
    for name, x in named:
        if len(x) < FEWEST or not np.isfinite(x).all():
            continue
        if seconds_columns(name, table.columns):
            return TimeColumn(name)
        period, said, whole = _mean_step(x), stamp_unit(table, name), is_whole(x)
        days = bool(not said and _DAYS[0] < x.min() and x.max() < _DAYS[1])
        units = [said] if said else [*["s"] * (not whole), *sorted(_USUAL_UNITS, key=partial(_unlikely, period))]
        for unit in [*units, *[_DAY] * days]:
            tick = _TICKS[unit]
            sure = bool(said) or not whole or _DATES[0] < x.min() * tick < _DATES[1]
            fits = float(np.ptp(x)) * tick < _LONGEST and PERIODS[0] <= period * tick * 1e-9 <= PERIODS[1]
            if fits and (sure or not is_count(x)):
                return TimeColumn(name, unit, sure)
    for name, x in table.columns.items():
        dates = len(x) >= FEWEST and _DATES[0] < np.min(x) and np.max(x) < _DATES[1]
        if dates and PERIODS[0] <= _mean_step(x) * 1e-9 <= PERIODS[1]:
            return TimeColumn(name, "ns")  # whatever the name
    name, x = next(iter(table.columns.items()), ("", np.zeros(0)))
    steps = np.diff(x)
    regular = len(x) >= FEWEST and np.isfinite(x).all() and steps.min() > 0 and np.ptp(steps) < _REGULAR * steps.mean()
    if regular and PERIODS[0] <= steps.mean() <= PERIODS[1] and not any(suggests(name, what) for what in _MEANINGS):
        return TimeColumn(name)  # the first column, without a known name
    return None


def unsorted_time(table: Table) -> str:
    """Return the column whose times are whole numbers of periods apart once they are sorted, which they are not."""
    for name, x in table.columns.items():
        if not suggests(name, "time") or len(x) < FEWEST or not np.isfinite(x).all():
            continue
        if (np.diff(x) >= 0).mean() < _ONWARD and len(steps := np.diff(np.unique(x))) > len(x) / 2:
            periods = steps / np.quantile(steps, _USUAL_LEAST)
            whole = np.abs(periods - np.rint(periods)) < JITTER * periods
            if whole.mean() > _ONWARD:
                return name
    return ""


def _unlikely(step: float, unit: str) -> float:
    """Return how far a step in this unit is from the usual period, by their ratio."""
    return abs(float(np.log(max(step, 1e-300) * STAMP_UNITS[unit] * 1e-9 / GUESSED_PERIOD)))


def _mean_step(x: FloatArray) -> float:
    """Return the mean step of a time that may start again and be printed with few digits; 0 for no time."""
    steps = np.diff(x)
    onward = steps >= 0
    distinct = int((steps > 0).sum())
    if onward.mean() < _ONWARD or distinct * _MOST_PER_STAMP < 1:
        return 0.0
    median = float(np.median(steps))
    return median if median > 0 else float(steps[onward].mean())
