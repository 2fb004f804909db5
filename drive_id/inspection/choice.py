"""Choose the columns of a log that are currents, voltages and angle, by names, values and a rough machine model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np

from drive_id.core import frames
from drive_id.core.checks.readings import LikelyReading, likely_reading
from drive_id.core.checks.recognition import angle_like, is_count, likely_counts, rotation_of
from drive_id.core.numerics.largest import USUAL_QUANTILE
from drive_id.core.signals.matching import nearest
from drive_id.errors import ConfigurationError, DataError
from drive_id.files.messages.signal_sources import ANGLE_UNITS
from drive_id.inspection.clock import (
    FEWEST,
    PERIODS,
    by_own_time,
    numbered,
    regular_stamps,
    timed,
    together,
    unsorted_time,
)
from drive_id.inspection.contents import Contents, Table
from drive_id.inspection.names import NameGroup, name_groups, suggests, words
from drive_id.inspection.points import AngleColumn, PhaseGroup, angle_points, current_points, dc_link, voltage_points
from drive_id.inspection.scales import full_scale, zero_reading
from drive_id.types import FloatArray, Samples

TURNS = {unit: 2 * np.pi / factor for unit, factor in ANGLE_UNITS.items()}
"""A turn in the units of an angle."""
_SPAN = 1 << 13
"""Samples of an excerpt by which a reading is judged: some tenths of a second."""
_SPANS = 5
"""Excerpts, spread over the log."""
_BALANCED = 0.35
"""Relative difference of the sizes of three phases, as gains of current sensors and a short log may cause."""
_SUM = 0.05
"""Deviation of the sum of three currents, one of them with its sign changed, by that of all."""
_BETWEEN, _LEAST_BETWEEN = 0.6, 0.005
"""Largest ratio of unexplained voltage, and least of it before, by which voltages are between phases, or q lags d."""
_MOST_TRIED = 12
"""Combinations of currents, voltages and angle that are tried: each takes some tenths of a second."""
_LARGEST = 1e30
"""Larger numbers are no measurements but damage: they count as missing."""
_GOOD = 0.15
"""Share of the voltage, unexplained, that a right choice hardly exceeds."""
_NAME = 0.1
"""Share of the voltage, unexplained, that weighs as much as one hint of a name."""
SURE_CURRENT = 1.5
"""Points of currents whose names leave little doubt, so that a good fit of them ends the search."""
SURE_VOLTAGE = 1.0
"""The same of voltages, whose sum cannot speak for them as it does for currents."""
_MOST_THERE = 0.8
"""Least share of rows with a value for which missing values of a column are interpolated."""
_LINES = np.exp(-1j * np.pi / 6) / np.sqrt(3)
"""Space vector of the phases by that of voltages between them."""
_LONG = {"value", "values"}
"""Columns of a table in long format: the value, beside a time and the name of its signal."""
_ODOMETERS = {
    "tachometer", "odometer", "hours", "charge", "charged", "used", "consumed", "energy", "distance", "trip", "soc",
    "ah", "wh", "battery", "level",
}  # fmt: skip
"""Words of what only grows, as an angle without wraps does."""


@dataclass(frozen=True, eq=False)
class Choice:
    """Currents, voltages and angle, how the angle is read, and the resulting samples."""

    currents: PhaseGroup
    voltages: PhaseGroup
    angle: AngleColumn
    reading: LikelyReading
    turn: float
    modulus: float | None
    samples: Samples


def choose(contents: Contents) -> tuple[list[Table], Choice]:
    """Choose currents, voltages and angle of a log; return its tables with a time, too.

    Raises ConfigurationError when no columns look like currents, voltages and an angle: says which are missing.
    """
    own = [part for table in contents.tables for part in by_own_time(table)]
    parts = [part for table in own for part in by_presence(_with_time(table))]
    tables = together([timed(_filled(part), contents) for part in parts])
    tables = [_onward(_distinct(table)) for table in tables]
    if not any(len(table.stamp) for table in tables):
        tables = [numbered(table, contents) for table in tables]
    tables = [table for table in tables if len(table.stamp) > FEWEST and table.columns]
    unread = [table.problem for table in contents.tables if table.problem and not table.columns]
    if unread and len(unread) == len(contents.tables):
        raise ConfigurationError(f"Nothing in {contents.path} can be read: {unread[0]}")
    for name in filter(None, map(unsorted_time, tables)):
        raise ConfigurationError(f"The rows of {contents.path} are not in the order of their times, {name}: sort them.")
    groups = [found for table in tables for found in _groups(table)]
    angles = sorted((found for table in tables for found in _angles(table)), key=angle_points, reverse=True)
    currents = sorted(groups, key=current_points, reverse=True)
    voltages = sorted(groups, key=voltage_points, reverse=True)
    blank = f" ({said})" if (said := blank_columns(contents)) else ""
    kinds = (("three balanced currents or voltages", groups), ("a rotor angle", angles))
    missing = [what for what, found in kinds if not found]
    if missing and any(name.lower().strip("_") in _LONG for table in tables for name in table.columns):
        raise ConfigurationError(
            f"{contents.path} seems to hold one value of one signal in each row: pivot it, so that each signal has a "
            "column."
        )
    if missing == ["a rotor angle"] and (why := _no_angle(tables)):
        raise ConfigurationError(f"{contents.path}: {why}")
    if missing:
        raise ConfigurationError(
            f"Nothing in {contents.path} looks like {' or '.join(missing)}{blank}: write the signals file "
            "by hand, from config/signals_example_stranger.yaml or signals_example_columns.yaml, or without an angle "
            "for a slow log in d and q, as in docs/logs.md."
        )
    choice = _chosen(currents, voltages, angles, tables)
    if choice is None:
        sets = [", ".join(found.group.names) for found in groups]
        seen = f" (there {'is' if len(sets) == 1 else 'are'} {' and '.join(sets[:2])})"
        raise ConfigurationError(
            f"{contents.path} holds no two sets of phase quantities that share their time with an angle"
            f"{seen}{blank}: write the signals file by hand, from "
            "config/signals_example_stranger.yaml or signals_example_columns.yaml."
        )
    return tables, _q_behind(_between_phases(choice, tables), tables)


def _no_angle(tables: Sequence[Table]) -> str:
    """Return why a column that is named as an angle is none; empty if there is none."""
    columns = {name: x for table in tables for name, x in table.columns.items() if not suggests(name, "time")}
    pair = [name for word in ("sin", "cos") for name in columns if word in words(name)]
    if len(pair) > 1:
        return f"{pair[0]} and {pair[-1]} are those of an angle: add a column with the angle, atan2(sin, cos), in rad."
    named = [name for name in columns if suggests(name, "angle") and not suggests(name, "speed")]
    return "".join(
        f"{name} ({columns[name].min():.5g} to {columns[name].max():.5g}) moves as no angle in rad, degrees, turns or "
        "counts does: log it as sampled, not interpolated or filtered, or write its angle_scale into a signals file."
        for name in named[:1]
    )


def _between_phases(choice: Choice, tables: Sequence[Table]) -> Choice:
    """Return the choice with its three voltages as those between phases, where they explain far more as such.

    These sum to zero, whatever they are called.
    """
    u, left = choice.voltages, choice.reading.unexplained
    three = u.group.frame == "abc" and len(u.group.names) == 3 and not full_scale(u)
    if not three or left < _LEAST_BETWEEN or np.abs(u.values.sum(axis=1)).max() > _SUM * np.abs(u.values).max():
        return choice
    return _far_better(choice, (choice.currents, replace(u, group=replace(u.group, frame="line_to_line"))), tables)


def _q_behind(choice: Choice, tables: Sequence[Table]) -> Choice:
    """Return the choice with the sign of q changed, or d and q exchanged, where that explains far more.

    Both differ by a quarter turn of the axes, which a magnet or the saliency shows.
    """
    groups = (choice.currents, choice.voltages)
    if choice.reading.unexplained < _LEAST_BETWEEN or "dq" not in (groups[0].group.frame, groups[1].group.frame):
        return choice
    behind = _far_better(choice, [_in_rotor(found, exchanged=False) for found in groups], tables)
    if behind is choice or abs(behind.reading.angle_offset) < np.pi / 4:
        return behind
    return _far_better(choice, [_in_rotor(found, exchanged=True) for found in groups], tables)


def _in_rotor(found: PhaseGroup, *, exchanged: bool) -> PhaseGroup:
    """Return components in d and q exchanged, or with q's sign changed; others as they are."""
    if found.group.frame != "dq":
        return found
    if not exchanged:
        return replace(found, signs=(1, -1))
    return replace(found, group=replace(found.group, names=found.group.names[::-1]), values=found.values[:, ::-1])


def _far_better(choice: Choice, groups: Sequence[PhaseGroup], tables: Sequence[Table]) -> Choice:
    """Return the choice of these currents and voltages where they explain far more, in order; else the one before."""
    i, u = groups
    other = _read(i, u, choice.angle, dc_link(tables, u, (*i.group.names, choice.angle.name)))
    straight = other is not None and other.reading.voltage_order == (0, 1, 2) and other.reading.voltage_sign > 0
    far = _BETWEEN * choice.reading.unexplained
    return other if other and straight and other.reading.unexplained < far else choice


def blank_columns(contents: Contents) -> str:
    """Return what names columns whose values are all blank or invalid; empty if there are none."""
    blank = [name for table in contents.tables for name, x in table.columns.items() if len(x) and np.isnan(x).all()]
    return f"{', '.join(blank[:3])} without a valid value" if blank else ""


# -- recognizing ---------------------------------------------------------------------------------------------------


def _with_time(table: Table) -> Table:
    """Return a table without the few rows whose time is blank, as the headers between captures of one file."""
    times = [x for name, x in table.columns.items() if suggests(name, "time")]
    known = [np.isfinite(x) for x in times if np.isfinite(x).mean() >= _MOST_THERE]
    there = np.all(known, axis=0) if known else np.ones(1, np.bool_)
    if there.all() or len(table.stamp):
        return table
    return replace(table, columns={name: x[there] for name, x in table.columns.items()})


def by_presence(table: Table) -> Iterator[Table]:
    """Yield a table divided by which of its columns hold values in the same rows, as where each row is of one topic.

    The columns that hold values in all rows come first, and again beside the others.
    """
    there = {name: np.isfinite(x) for name, x in table.columns.items() if len(x)}
    sparse = [name for name, known in there.items() if known.any() and known.mean() < _MOST_THERE]
    if not sparse or len(table.stamp):
        yield table
        return
    full = [name for name in there if there[name].mean() >= _MOST_THERE]
    yield replace(table, columns={name: table.columns[name] for name in full})
    parts: dict[bytes, list[str]] = {}
    for name in sparse:
        parts.setdefault(there[name].tobytes(), []).append(name)
    for names in parts.values():
        rows = there[names[0]]
        yield replace(
            table, columns={name: table.columns[name][rows] for name in table.columns if name in {*names, *full}}
        )


def _distinct(table: Table) -> Table:
    """Return a table without rows that are those before, time and all, which a fit cuts out: they are no jitter."""
    columns = [x for x in table.columns.values() if len(x) == len(table.stamp)]
    same = np.all([np.diff(x) == 0 for x in (table.stamp, *columns)], axis=0)
    if not same.any():
        return table
    kept = np.append(True, ~same)
    shortened = {name: x[kept] if len(x) == len(kept) else x for name, x in table.columns.items()}
    return replace(table, stamp=table.stamp[kept], columns=shortened)


def _onward(table: Table) -> Table:
    """Return the rows of a table before its clock is set back, if they are enough to recognize the columns."""
    back = np.flatnonzero(np.diff(table.stamp) < 0)
    if not len(back) or back[0] < 2 * FEWEST:
        return table
    kept = slice(0, int(back[0]) + 1)
    columns = {name: x[kept] if len(x) == len(table.stamp) else x for name, x in table.columns.items()}
    return replace(table, stamp=table.stamp[kept], columns=columns)


def _filled(table: Table) -> Table:
    """Return a table with missing or damaged values of a column interpolated if they are few: it may be recognized."""

    def filled(x: FloatArray) -> FloatArray:
        there = np.abs(x) < _LARGEST
        if there.all():
            return x
        if there.mean() <= _MOST_THERE:
            return np.where(there, x, np.nan)
        return np.interp(np.arange(len(x)), np.flatnonzero(there), x[there])

    return replace(table, columns={name: filled(x) for name, x in table.columns.items() if len(x)})


def _groups(table: Table) -> Iterator[PhaseGroup]:
    moving = {name: x for name, x in table.columns.items() if len(x) == len(table.stamp) and np.ptp(x) > 0}
    for group in name_groups(list(moving)):
        values = np.column_stack([moving[name] for name in group.names])
        units = {table.unit(name) for name in group.names}
        if len(units) > 1:
            continue
        stem = group.stem
        if any(units):
            stem = f"{group.stem} [{units.pop()}]"
        if not np.isfinite(values).all():
            continue
        balanced = group.frame not in ("abc", "line_to_line") or _balanced(values)
        two = len(group.names) == 2 and suggests(stem, "voltage")  # which may be those between phases
        signs = () if balanced or two or group.frame != "abc" else _one_reversed(values)
        if balanced or signs:
            yield PhaseGroup(table, replace(group, stem=stem), values, signs)


def _balanced(values: FloatArray) -> bool:
    """Return whether phases (N, 2 or 3), less their common part, have about equal size and are no angles or times."""
    three = _three(values)
    part = three - three.mean(axis=1, keepdims=True)
    size = part.std(axis=0)
    return bool(size.min() > 0 and size.max() / size.min() < 1 + _BALANCED)


def _one_reversed(values: FloatArray) -> tuple[int, ...]:
    """Return the signs of phases (N, 2 or 3) by which they balance, one of them negative; empty if none do.

    Of three, they sum to zero then. Of two, which one is reversed follows from the voltages.
    """
    part = values - values.mean(axis=0)
    for k in range(1, len(part.T) + 1):
        signs = np.where(np.arange(len(part.T)) == len(part.T) - k, -1, 1)
        left = _three(part * signs).sum(axis=1)
        if _balanced(part * signs) and left.std() < _SUM * part.std():
            return tuple(int(sign) for sign in signs)
    return ()


def _three(values: FloatArray, missing: int = 2) -> FloatArray:
    """Return three phases (N, 3); the ``missing`` one of two is minus their sum."""
    return values if values.shape[1] == 3 else np.insert(values, missing, -values.sum(axis=1), axis=1)


def _angles(table: Table) -> Iterator[AngleColumn]:
    for name, x in table.columns.items():
        if len(x) != len(table.stamp) or is_count(x) or suggests(name, "time"):
            continue
        named = suggests(name, "angle") and not suggests(name, "speed")
        like = angle_like(x, table.stamp, named=named)
        if like is not None and (like.wraps or not words(name) & _ODOMETERS):
            yield AngleColumn(table, name, like, x)


# -- choosing ------------------------------------------------------------------------------------------------------


def _chosen(
    currents: Sequence[PhaseGroup],
    voltages: Sequence[PhaseGroup],
    angles: Sequence[AngleColumn],
    tables: Sequence[Table],
) -> Choice | None:
    """Return the likeliest currents, voltages and angle, by their names and the fit of a rough machine model."""
    pairs = [
        (i, u)
        for i in currents
        for u in voltages
        if not u.signs or (suggests(u.label, "voltage") and not full_scale(u))
        if i.table.name != u.table.name or not set(i.group.names) & set(u.group.names)
    ]
    pairs.sort(key=lambda pair: current_points(pair[0]) + voltage_points(pair[1]), reverse=True)
    best: tuple[float, Choice] | None = None
    for (i, u), angle in islice(product(pairs, angles[:3]), _MOST_TRIED):
        found = _read(i, u, angle, dc_link(tables, u, (*i.group.names, angle.name)))
        if found is None:
            continue
        left = found.reading.unexplained
        likely = left - _NAME * (current_points(i) + voltage_points(u) + angle_points(angle))
        if best is None or likely < best[0]:
            best = likely, found
        if left < _GOOD and current_points(i) > SURE_CURRENT and voltage_points(u) > SURE_VOLTAGE:
            break
    return best and best[1]


def _read(i: PhaseGroup, u: PhaseGroup, angle: AngleColumn, dc: tuple[Table, str] | None) -> Choice | None:
    """Read the angle in the likeliest way, for these currents and voltages."""
    logged, i = (i, u), replace(i, values=(i.values - zero_reading(i)) * (i.signs or 1))
    u = replace(u, values=u.values * (u.signs or 1))
    units = TURNS.items() if angle.like.turn and not angle.like.wraps else [(angle.like.unit, angle.like.turn)]
    options: list[tuple[float, float | None, tuple[int, ...] | None]] = [
        (turn, None, None) for _, turn in units if turn
    ]
    if angle.like.unit == "counts":
        options += _by_rotation(u, angle)
    best: Choice | None = None
    for turn, modulus, ratios in options:
        if ratios and best and best.turn == angle.like.turn and best.reading.unexplained < _GOOD:
            break  # it starts again at each turn
        unit = angle.like.unit if angle.like.wraps else next((one for one, of in units if of == turn), "counts")
        taken = replace(angle, like=replace(angle.like, unit=unit, turn=turn))
        try:
            samples = _samples(i, u, taken, modulus, dc)
        except DataError:
            continue
        if samples is None:
            continue
        largest = float(np.quantile(np.abs(frames.space_vector(samples.i_abc)), USUAL_QUANTILE))
        in_rotor = "dq" in (i.group.frame, u.group.frame)
        found = likely_reading(_runs(samples), largest, (1,) if in_rotor else ratios) if largest > 0 else None
        if found is not None and (best is None or found.unexplained < best.reading.unexplained):
            best = Choice(*logged, taken, found, turn, modulus, samples)
    return best


def _by_rotation(u: PhaseGroup, angle: AngleColumn) -> list[tuple[float, float | None, tuple[int, ...] | None]]:
    """Return the counts per revolution, modulus and pole pairs that make the angle rotate with the voltages."""
    if u.group.frame == "dq":
        return []
    z = _vector(u.group, u.values)
    seconds = float(u.table.stamp[-1] - u.table.stamp[0])
    x = angle.like.unwrapped(angle.values)
    moved = float(x[-1] - x[0]) / float(angle.table.stamp[-1] - angle.table.stamp[0]) * seconds
    if not moved:
        return []
    modulus = angle.like.turn or None
    likely = likely_counts(rotation_of(z) / (2 * np.pi), moved)[:6]
    return [(float(count), modulus, (pole_pairs, -pole_pairs)) for count, pole_pairs in likely]


def _vector(
    group: NameGroup, values: FloatArray, theta: FloatArray | None = None
) -> np.ndarray[tuple[int, ...], np.dtype[np.complex128]]:
    """Return the space vector of phase quantities or components, those in d and q at the angles ``theta``."""
    if group.frame in ("alpha_beta", "dq"):
        z = values[:, 0] + 1j * values[:, 1]
        return np.asarray(z if theta is None or group.frame == "alpha_beta" else z * np.exp(1j * theta))
    z = frames.space_vector(_three(values, group.missing))
    return np.asarray(_LINES * z if group.frame == "line_to_line" else z)  # which lead by 30 degrees, and are larger


def _samples(
    i: PhaseGroup, u: PhaseGroup, angle: AngleColumn, modulus: float | None, dc: tuple[Table, str] | None
) -> Samples | None:
    """Put currents, voltages and angle on the stamps of the currents."""
    clock = regular_stamps(i.table)
    if np.any(np.diff(clock) <= 0):
        kept = np.append(True, np.diff(np.maximum.accumulate(clock)) > 0)
        clock, i = clock[kept], replace(i, values=i.values[kept])
    period = float(np.median(np.diff(clock))) * 1e-9
    if not PERIODS[0] <= period <= PERIODS[1]:
        return None
    x = np.unwrap(angle.values, period=modulus or angle.like.turn) if angle.like.wraps else angle.values
    x = x * (2 * np.pi / angle.like.turn)
    at = regular_stamps(angle.table)
    theta = np.interp((clock - clock[0]).astype(float), (at - clock[0]).astype(float), x)
    i_s = _vector(i.group, i.values, theta)
    at = regular_stamps(u.table)
    u_values = u.values if u.table is i.table and len(u.values) == len(clock) else u.values[nearest(clock, at)]
    u_s = _vector(u.group, u_values, theta)
    full = full_scale(u)
    u_s = u_s / (full or 1.0)
    if dc is not None and full:
        table, name = dc
        u_s = u_s * np.interp(
            (clock - clock[0]).astype(float), (table.stamp - clock[0]).astype(float), table.columns[name]
        )
    inside = (clock >= max(angle.table.stamp[0], at[0])) & (clock <= min(angle.table.stamp[-1], at[-1]))
    if inside.sum() < FEWEST:
        return None
    clock, theta, i_s, u_s = clock[inside], theta[inside], i_s[inside], u_s[inside]
    starts = np.append(0, np.flatnonzero(np.diff(clock) > 1.5e9 * period) + 1)
    return Samples(
        clock, frames.phases(i_s), frames.phases(u_s), theta, np.gradient(theta, period), period, run_starts=starts
    )


def _runs(samples: Samples) -> list[Samples]:
    """Return some gap-free excerpts, spread over the samples."""
    long = sorted((run for run in samples.runs() if run.stop - run.start >= 64), key=lambda run: run.start - run.stop)
    pieces = [
        samples.part(start, min(start + _SPAN, run.stop))
        for run in long[:20]
        for start in range(run.start, run.stop, _SPAN)
    ]
    pieces = [piece for piece in pieces if len(piece) >= 64]
    every = -(-len(pieces) // _SPANS)
    return pieces[:: max(every, 1)]
