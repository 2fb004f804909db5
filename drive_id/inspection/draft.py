"""Propose a signals file for a log: which columns look like currents, voltages and angle, and what is not sure."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drive_id.core import frames
from drive_id.core.checks.readings import LikelyReading, likely_reading
from drive_id.core.checks.recognition import AngleLike, angle_like, is_count, likely_counts, rotation_of
from drive_id.core.signals.equal_spacing import equal_spacing
from drive_id.core.signals.matching import nearest
from drive_id.errors import ConfigurationError, DataError
from drive_id.files.messages.signal_sources import SPEED_UNITS, STAMP_UNITS
from drive_id.inspection.contents import Contents, Table
from drive_id.inspection.names import NameGroup, name_groups, suggests, words
from drive_id.types import FloatArray, IntArray, Samples

_SPAN = 1 << 13
_SPANS = 5
_BALANCED = 0.35
_JITTER = 0.02
_SAME_RATE = 0.005
_LARGEST_DUTY = 1.17
_MOST_TRIED = 12
_GOOD, _POOR = 0.15, 0.35
_NAME = 0.1
"""Share of the voltage, unexplained, that weighs as much as one hint of a name."""
_PERIODS = (5e-7, 0.05)
_NO_OFFSET = 0.035
"""Estimated offset, rad, that is not told from none."""
_COARSE, _SMOOTHING = 1e-3, 0.003
"""Electrical angle of one count, rad, from which the angle is smoothed, and for how long, s."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A proposed signals file.

    Parameters
    ----------
    text : str
        YAML with comments.
    unsure : tuple of str
        Sentences on what to look at.
    """

    text: str
    unsure: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Group:
    """Phase quantities or components in one table."""

    table: Table
    group: NameGroup
    values: FloatArray

    @property
    def label(self) -> str:
        return f"{self.table.name} {self.group.stem}"


@dataclass(frozen=True, eq=False)
class _Angle:
    table: Table
    name: str
    like: AngleLike
    values: FloatArray


@dataclass(frozen=True, eq=False)
class _Choice:
    """Currents, voltages and angle, how the angle is read, and the samples so read."""

    currents: _Group
    voltages: _Group
    angle: _Angle
    reading: LikelyReading
    turn: float
    modulus: float | None
    samples: Samples


@dataclass
class _Notes:
    unsure: list[str] = field(default_factory=list)


def propose(contents: Contents) -> Draft:
    """Propose a signals file.

    Parameters
    ----------
    contents : Contents

    Raises
    ------
    ConfigurationError
        When no columns look like currents, voltages and an angle: says which are missing.
    """
    tables = [_timed(table, contents) for table in contents.tables]
    tables = [table for table in tables if len(table.stamp) > 200 and table.columns]
    groups = [found for table in tables for found in _groups(table)]
    angles = [found for table in tables for found in _angles(table)]
    currents = sorted(groups, key=_as_current, reverse=True)
    voltages = sorted(groups, key=_as_voltage, reverse=True)
    angles = sorted(angles, key=_as_angle, reverse=True)
    missing = [
        what
        for what, found in (("three balanced currents or voltages", groups), ("a rotor angle", angles))
        if not found
    ]
    if missing:
        raise ConfigurationError(
            f"Nothing in {contents.path} looks like {' or '.join(missing)}: write the signals file by hand, from "
            "config/signals_example_stranger.yaml or signals_example_columns.yaml."
        )
    choice = _chosen(currents, voltages, angles, _dc_link(tables))
    if choice is None:
        raise ConfigurationError(
            f"{contents.path} holds no two sets of phase quantities that share their time with an angle: write the "
            "signals file by hand, from config/signals_example_stranger.yaml or signals_example_columns.yaml."
        )
    return _Writer(contents, tables, choice).draft()


# -- recognizing ---------------------------------------------------------------------------------------------------


def _timed(table: Table, contents: Contents) -> Table:
    """Return a table of columns with stamps from the column that looks like its time."""
    if len(table.stamp) or contents.is_bag:
        return table
    found = time_column(table)
    if found is None:
        return table
    name, unit = found
    values = table.columns[name]
    stamp = np.rint((values - values[0]) * STAMP_UNITS[unit]).astype(np.int64)
    return replace(table, stamp=stamp, stamp_source=name)


def time_column(table: Table) -> tuple[str, str] | None:
    """Return the column that looks like the time, and its unit; None if none does."""
    for name, x in sorted(table.columns.items(), key=lambda item: not suggests(item[0], "time")):
        if len(x) < 200 or not np.isfinite(x).all() or not suggests(name, "time"):
            continue
        step = float(np.median(np.diff(x)))
        if step <= 0 or float(np.mean(np.diff(x) > 0)) < 0.9:
            continue
        said = re.search(r"(?:[\[(_ ])(ns|us|µs|ms|s)[\])]?$", name.lower())
        units = [said.group(1).replace("µ", "u")] if said else ["s", "ms", "us", "ns"]
        for unit in units:
            if _PERIODS[0] <= step * STAMP_UNITS[unit] * 1e-9 <= _PERIODS[1]:
                return name, unit
    return None


def _groups(table: Table) -> Iterator[_Group]:
    moving = {name: x for name, x in table.columns.items() if len(x) == len(table.stamp) and np.ptp(x) > 0}
    for group in name_groups(list(moving)):
        values = np.column_stack([moving[name] for name in group.names])
        if np.isfinite(values).all() and (group.frame != "abc" or _balanced(values)):
            yield _Group(table, group, values)


def _balanced(values: FloatArray) -> bool:
    """Tell whether phases (N, 2 or 3) have about equal size, their common part left out, and are no angles or times."""
    three = values if values.shape[1] == 3 else np.column_stack([values, -values.sum(axis=1)])
    part = three - three.mean(axis=1, keepdims=True)
    size = part.std(axis=0)
    return bool(size.min() > 0 and size.max() / size.min() < 1 + _BALANCED)


def _angles(table: Table) -> Iterator[_Angle]:
    for name, x in table.columns.items():
        if len(x) != len(table.stamp) or is_count(x) or suggests(name, "time"):
            continue
        like = angle_like(x)
        if like is not None:
            yield _Angle(table, name, like, x)


def _hints(found: _Group, meaning: str) -> float:
    return 2.0 * suggests(found.group.stem, meaning) + 1.0 * suggests(found.table.name, meaning)


def _as_current(found: _Group) -> float:
    common = float(np.abs(found.values.sum(axis=1)).mean() / np.abs(found.values).mean())
    score = _hints(found, "current") - _hints(found, "voltage") - 2 * _hints(found, "reference")
    return score + (len(found.values.T) == 3) * (common < 0.05) + (found.group.frame == "abc")


def _as_voltage(found: _Group) -> float:
    score = _hints(found, "voltage") - _hints(found, "current")
    return score + 0.5 * (found.group.frame == "abc") + 0.1 * len(found.values.T)


def _as_angle(found: _Angle) -> float:
    name = suggests(found.name, "angle") + 0.5 * suggests(found.table.name, "angle")
    return 2 * name + found.like.certain + found.like.wraps


def _dc_link(tables: Sequence[Table]) -> tuple[Table, str] | None:
    """Return the column that looks like the DC-link voltage."""
    best: tuple[float, Table, str] | None = None
    for table in tables:
        for name, x in table.columns.items():
            score = 2.0 * suggests(name, "dc") + suggests(table.name, "dc")
            steady = len(x) > 2 and np.isfinite(x).all() and x.mean() > 5 and x.std() < 0.25 * x.mean()
            if score and steady and (best is None or score > best[0]):
                best = (score, table, name)
    return best and (best[1], best[2])


# -- choosing ------------------------------------------------------------------------------------------------------


def _chosen(
    currents: Sequence[_Group], voltages: Sequence[_Group], angles: Sequence[_Angle], dc: tuple[Table, str] | None
) -> _Choice | None:
    """Return the likeliest currents, voltages and angle: by their names, and by whether a rough machine explains them."""
    pairs = [
        (i, u)
        for i in currents
        for u in voltages
        if not set(zip([i.table.name] * 3, i.group.names, strict=False))
        & set(zip([u.table.name] * 3, u.group.names, strict=False))
    ]
    pairs.sort(key=lambda pair: _as_current(pair[0]) + _as_voltage(pair[1]), reverse=True)
    best: tuple[float, _Choice] | None = None
    tried = 0
    for i, u in pairs:
        for angle in angles[:3]:
            if tried >= _MOST_TRIED:
                break
            tried += 1
            found = _read(i, u, angle, dc)
            if found is None:
                continue
            likely = found.reading.unexplained - _NAME * (_as_current(i) + _as_voltage(u) + _as_angle(angle))
            if best is None or likely < best[0]:
                best = likely, found
            if found.reading.unexplained < _GOOD and _as_current(i) > 1.5 and _as_voltage(u) > 1:
                return best[1]
    return best and best[1]


def _read(i: _Group, u: _Group, angle: _Angle, dc: tuple[Table, str] | None) -> _Choice | None:
    """Read the angle in the likeliest way, for these currents and voltages."""
    options: list[tuple[float, float | None, tuple[int, ...] | None]] = []
    if angle.like.turn:
        options.append((angle.like.turn, None, None))
    if angle.like.unit == "counts":
        options += _by_rotation(u, angle)
    best: _Choice | None = None
    for turn, modulus, ratios in options:
        if best is not None and best.reading.unexplained < _GOOD:
            break
        try:
            samples = _samples(i, u, replace(angle, like=replace(angle.like, turn=turn)), modulus, dc)
        except DataError:
            continue
        if samples is None:
            continue
        largest = float(np.quantile(np.abs(frames.space_vector(samples.i_abc)), 0.999))
        in_rotor = "dq" in (i.group.frame, u.group.frame)
        found = likely_reading(_runs(samples), largest, (1,) if in_rotor else ratios) if largest > 0 else None
        if found is not None and (best is None or found.unexplained < best.reading.unexplained):
            best = _Choice(i, u, angle, found, turn, modulus, samples)
    return best


def _by_rotation(u: _Group, angle: _Angle) -> list[tuple[float, float | None, tuple[int, ...] | None]]:
    """Return counts per revolution, modulus and pole pairs by which the angle turns as the voltages do."""
    if u.group.frame == "dq":
        return []
    z = _vector(u)
    seconds = float(u.table.stamp[-1] - u.table.stamp[0])
    x = angle.like.unwrapped(angle.values)
    moved = float(x[-1] - x[0]) / float(angle.table.stamp[-1] - angle.table.stamp[0]) * seconds
    if not moved:
        return []
    modulus = angle.like.turn or None
    likely = likely_counts(rotation_of(z) / (2 * np.pi), moved)[:6]
    return [(float(count), modulus, (pole_pairs, -pole_pairs)) for count, pole_pairs in likely]


def _vector(found: _Group) -> np.ndarray[tuple[int, ...], np.dtype[np.complex128]]:
    if found.group.frame == "alpha_beta":
        return np.asarray(found.values[:, 0] + 1j * found.values[:, 1])
    values = found.values
    three = values if values.shape[1] == 3 else np.column_stack([values, -values.sum(axis=1)])
    return np.asarray(frames.space_vector(three))


def _regular(table: Table) -> IntArray:
    """Return the stamps of a table, without jitter if they have much."""
    period, jitter = table.period, table.jitter
    if period is None or jitter is None or jitter < _JITTER * period * table.block:
        return table.stamp
    return equal_spacing(table.stamp, np.ones(len(table.stamp), np.int64), name=table.name).stamp


def _samples(
    i: _Group, u: _Group, angle: _Angle, modulus: float | None, dc: tuple[Table, str] | None
) -> Samples | None:
    """Put currents, voltages and angle on the stamps of the currents."""
    clock = _regular(i.table)
    if np.any(np.diff(clock) <= 0):
        kept = np.append(True, np.diff(np.maximum.accumulate(clock)) > 0)
        clock, i = clock[kept], replace(i, values=i.values[kept])
    period = float(np.median(np.diff(clock))) * 1e-9
    if not _PERIODS[0] <= period <= _PERIODS[1]:
        return None
    x = np.unwrap(angle.values, period=modulus or angle.like.turn) if angle.like.wraps else angle.values
    x = x * (2 * np.pi / angle.like.turn)
    at = _regular(angle.table)
    theta = np.interp((clock - clock[0]).astype(float), (at - clock[0]).astype(float), x)
    i_s = _rotated(i, i.values, theta)
    at = _regular(u.table)
    u_values = u.values if u.table is i.table and len(u.values) == len(clock) else u.values[nearest(clock, at)]
    u_s = _rotated(u, u_values, theta)
    if dc is not None and np.abs(u.values).max() < _LARGEST_DUTY:
        table, name = dc
        u_s = u_s * np.interp(
            (clock - clock[0]).astype(float), (table.stamp - clock[0]).astype(float), table.columns[name]
        )
    inside = (clock >= max(angle.table.stamp[0], at[0])) & (clock <= min(angle.table.stamp[-1], at[-1]))
    if inside.sum() < 200:
        return None
    clock, theta, i_s, u_s = clock[inside], theta[inside], i_s[inside], u_s[inside]
    starts = np.append(0, np.flatnonzero(np.diff(clock) > 1.5e9 * period) + 1)
    return Samples(
        clock, frames.phases(i_s), frames.phases(u_s), theta, np.gradient(theta, period), period, run_starts=starts
    )


def _rotated(
    found: _Group, values: FloatArray, theta: FloatArray
) -> np.ndarray[tuple[int, ...], np.dtype[np.complex128]]:
    if found.group.frame == "dq":
        return np.asarray((values[:, 0] + 1j * values[:, 1]) * np.exp(1j * theta))
    return _vector(replace(found, values=values))


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


# -- writing -------------------------------------------------------------------------------------------------------


class _Writer:
    """Writes the proposal as YAML."""

    def __init__(self, contents: Contents, tables: Sequence[Table], choice: _Choice) -> None:
        self._contents = contents
        self._tables = tables
        self._choice = choice
        self._unsure: list[str] = []
        self._period = choice.currents.table.period or 0.0

    def draft(self) -> Draft:
        """Return the proposal."""
        body = [*self._currents(), "", *self._voltages(), "", *self._rotor(), *self._reference(), *self._optional()]
        left = self._choice.reading.unexplained
        if left > _POOR:
            self._doubt(
                f"A rough machine model leaves {100 * left:.0f} % of the voltage unexplained by these signals: currents, "
                "voltages or angle may be other columns, or phases be swapped."
            )
        head = [
            f"# Signals file proposed for {self._contents.path.name}. docs/signals_file.md explains every setting.",
            f"# A rough machine model explains all but {100 * left:.2g} % of the voltage with it.",
        ]
        head += [f"# NOT SURE: {sentence}" for sentence in self._unsure] or ["# Nothing is left open."]
        return Draft("\n".join([*head, "", *body]) + "\n", tuple(self._unsure))

    def _doubt(self, sentence: str) -> None:
        self._unsure.append(sentence)

    def _time(self, table: Table, lines: list[str]) -> list[str]:
        """Return the lines that say where and when the samples of a table are."""
        found = []
        if self._contents.is_bag:
            found.append(f"  topic: {table.name}")
            if table.stamp_source == "log_time":
                found.append("  stamp: log_time                 # the messages have no header")
        else:
            if table.name and len(self._contents.tables) > 1:
                found.append(f"  group: {_quoted(table.name)}")
            if table.stamp_source not in ("", "own"):
                _, unit = time_column(table) or ("", "s")
                found += [f"  stamp: {_quoted(table.stamp_source)}", f"  stamp_unit: {unit}"]
        period, jitter = table.period, table.jitter
        counts = [
            name for name, x in table.columns.items() if table.block == 1 and is_count(x) and name != table.stamp_source
        ]
        if counts:
            found.append(f"  first_sample: {_quoted(counts[0])}")
        if period is not None and jitter is not None and jitter > _JITTER * period * table.block:
            found.append(f"  equally_spaced: true            # the stamps jitter by {jitter * 1e6:.3g} us rms")
            if table.block > 1:
                found.append(f"  sample_period: {_nice(period)}")
        elif period is not None:
            usual = float(np.median(np.diff(table.stamp))) * 1e-9
            found.append(f"  sample_period: {_nice(usual if abs(usual / period - 1) > 1e-3 else period)}")
        return [*found, *lines]

    def _currents(self) -> list[str]:
        i = self._choice.currents
        lines = [f"  fields: {_listed(i.group.names)}", *_frame(i)]
        label = " ".join(i.group.names).lower()
        scale = 0.001 if "[ma]" in label or "(ma)" in label else 1.0
        scale *= self._choice.reading.voltage_sign
        if scale != 1.0:
            lines.append(f"  scale: {scale:g}")
        return ["currents:", *self._time(i.table, lines)]

    def _voltages(self) -> list[str]:
        u = self._choice.voltages
        reading, names = self._choice.reading, u.group.names
        if u.group.frame == "abc" and len(names) == 3:
            names = tuple(u.group.names[k] for k in reading.voltage_order)
            if names != u.group.names:
                self._doubt(f"The voltages explain the currents only in the order {', '.join(names)}: compare the wiring.")
            if reading.voltage_sign < 0:
                self._doubt("Currents and voltages have opposite signs: currents must be positive into the machine.")
        lines = [f"  fields: {_listed(names)}", *_frame(u)]
        low, high = float(u.values.min()), float(u.values.max())
        percent = low >= 0 and _LARGEST_DUTY < high <= 101 and bool(words(u.label) & {"duty", "pwm", "dutycycle"})
        if max(-low, high) <= _LARGEST_DUTY or percent:
            share = 0.01 if percent else 1.0 if low >= -0.02 else 0.5
            range_ = "0 to 100 %" if percent else "0 to 1" if low >= -0.02 else "-1 to 1"
            dc = _dc_link(self._tables)
            if dc is None:
                lines.append(
                    f"  scale: {share * 100:g}                      # EDIT: duty cycles, so {share:g} times the DC-link voltage, V"
                )
                self._doubt(
                    f"The voltages are duty cycles from {range_}, and no DC-link voltage is in the log: set scale of the "
                    f"voltages to {share:g} times that voltage (written for 100 V)."
                )
            else:
                table, name = dc
                where = self._where(table)
                scaled = "" if share == 1.0 else f", scale: {share:g}"
                lines.append(f"  scale: {{{where}field: {_quoted(name)}{scaled}}}   # duty cycles from {range_}")
        elif not suggests(u.label, "voltage"):
            self._doubt(f"{', '.join(u.group.names)} were taken for the voltages by their values, not by their names.")
        if u.group.frame == "dq":
            lines.append(
                "  angle_advance: 0.0              # EDIT if the drive transforms them back with an angle ahead: often 1.5"
            )
            self._doubt("The voltages are d and q components: set angle_advance if the drive compensates its delay.")
        rate = u.table.period
        if rate and self._period and abs(rate / self._period - 1) > 2 * _SAME_RATE:
            self._doubt("Voltages and currents are recorded at different rates, which a fit refuses.")
        return ["voltages:", *self._time(u.table, lines)]

    def _where(self, table: Table) -> str:
        if self._contents.is_bag:
            stamp = "stamp: log_time, " if table.stamp_source == "log_time" else ""
            return f"topic: {table.name}, {stamp}"
        group = f"group: {_quoted(table.name)}, " if table.name and len(self._contents.tables) > 1 else ""
        if table.stamp_source in ("", "own"):
            return group
        _, unit = time_column(table) or ("", "s")
        return f"{group}stamp: {_quoted(table.stamp_source)}, stamp_unit: {unit}, "

    def _rotor(self) -> list[str]:
        choice, angle, reading = self._choice, self._choice.angle, self._choice.reading
        lines = [f"  angle: {_quoted(angle.name)}"]
        unit = angle.like.unit
        if unit == "counts":
            lines += ["  angle_unit: counts", f"  counts_per_turn: {choice.turn:g}"]
            if choice.modulus:
                lines.append(f"  angle_modulus: {choice.modulus:g}")
            if choice.modulus or not angle.like.wraps:
                self._doubt(
                    "The encoder never starts again at a whole revolution: only the ratio of counts_per_turn and "
                    "pole_pairs follows from the log."
                )
        elif unit != "rad":
            lines.append(f"  angle_unit: {unit}")
        pole_pairs = abs(reading.ratio)
        if pole_pairs != 1 or unit == "counts":
            lines += ["  mechanical: true", f"  pole_pairs: {pole_pairs}"]
        if reading.ratio < 0:
            lines.append("  direction: -1                   # counts against the order of the phases")
        if choice.currents.group.frame == choice.voltages.group.frame == "dq":
            offset = 0.0
        else:
            offset = reading.angle_offset
            if reading.voltage_sign < 0:  # written as a sign of the currents, which turns the axes by half a turn
                offset -= float(np.copysign(np.pi, offset))
            offset = offset if abs(offset) > _NO_OFFSET else 0.0
            said = "estimated; method full corrects the rest" if offset else "no offset was found"
            lines.append(f"  angle_offset: {offset:.4g}          # {said}")
            if not reading.certain_offset:
                self._doubt(
                    "The angle offset follows from the saliency only, so it may be wrong by a multiple of 90 degrees "
                    "(1.5708), which exchanges or reverses the axes: compare with the d axis of your drive."
                )
        coarse = 2 * np.pi * pole_pairs / choice.turn if unit == "counts" else 0.0
        if coarse > _COARSE:
            lines.append(
                f"  smoothing: {_SMOOTHING:g}                # s: one count is {coarse * 1e3:.2g} mrad electrical"
            )
        else:
            lines += self._speed(pole_pairs)
        rate = angle.table.period
        if angle.table is not choice.currents.table and rate and abs(rate / self._period - 1) > _SAME_RATE:
            lines.append(
                f"  interpolate: true               # recorded every {rate * 1e6:.4g} us, the currents every {self._period * 1e6:.4g} us"
            )
        return ["resolver:", *self._time(angle.table, lines)]

    def _speed(self, pole_pairs: int) -> list[str]:
        """Return the speed beside the angle, if its unit is plain from the angle."""
        angle, choice = self._choice.angle, self._choice
        at = _regular(angle.table)
        x = np.unwrap(angle.values, period=choice.modulus or choice.turn) if angle.like.wraps else angle.values
        x = x * (2 * np.pi / choice.turn)
        moved, seconds = float(x[-1] - x[0]), float(at[-1] - at[0]) * 1e-9
        half = len(x) // 2
        first = float(x[half] - x[0]) / (float(at[half] - at[0]) * 1e-9)
        for name, y in angle.table.columns.items():
            if name == angle.name or len(y) != len(x) or not np.isfinite(y).all() or not y.any():
                continue
            for unit, factor in SPEED_UNITS.items():
                for scale in (1, -1):
                    ratio = scale * float(y.mean()) * factor * seconds / moved
                    halves = scale * float(y[:half].mean()) * factor / first if first else 0.0
                    close = abs(ratio - 1) < 0.004 and abs(halves - 1) < 0.01
                    if close and (suggests(name, "speed") or np.ptp(y) > 0):
                        sign = ["  speed_scale: -1"] if scale < 0 else []
                        return [f"  speed: {_quoted(name)}", f"  speed_unit: {unit}", *sign]
        return ["  # no field is the speed of this angle: it is derived from the angle"]

    def _reference(self) -> list[str]:
        """Return the pair of columns that the currents follow."""
        choice = self._choice
        theta = choice.samples.angle * choice.reading.ratio + choice.reading.angle_offset
        i_dq = frames.to_dq(choice.samples.i_abc, theta)
        clock, own = choice.samples.stamp, choice.currents.group.names
        for table in self._tables:
            for group in name_groups(list(table.columns)):
                if group.frame != "dq" or group.names in (own, choice.voltages.group.names):
                    continue
                values = np.column_stack([table.columns[name] for name in group.names])
                if len(values) != len(table.stamp) or not np.isfinite(values).all():
                    continue
                there = (clock >= table.stamp[0]) & (clock <= table.stamp[-1])
                if there.sum() < 200:
                    continue
                wanted, found = values[nearest(clock[there], table.stamp)], i_dq[there]
                gain = float(np.sum(wanted * found) / max(np.sum(wanted**2), 1e-300))
                alike = float(np.sum(wanted * found) / np.sqrt(max(np.sum(wanted**2) * np.sum(found**2), 1e-300)))
                if alike > 0.9 and 0.8 < gain < 1.25:
                    return ["", "reference:", *self._time(table, [f"  fields: {_listed(group.names)}"])]
        self._doubt(
            "No columns are the references of i_d and i_q: a fit then takes i_max from the currents and corrects less for "
            "their noise."
        )
        return []

    def _optional(self) -> list[str]:
        dc = _dc_link(self._tables)
        if dc is None:
            return []
        table, name = dc
        time = [f"  {line}" for line in self._time(table, []) if "equally" not in line and "first_sample" not in line]
        return ["", "optional:", "  dc_link_voltage:", *time, f"    field: {_quoted(name)}"]


def _frame(found: _Group) -> list[str]:
    return [] if found.group.frame == "abc" else [f"  frame: {found.group.frame}"]


def _quoted(name: str) -> str:
    """Return a name as YAML takes it, quoted unless it is a plain word."""
    if re.fullmatch(r"[A-Za-z_][\w.]*", name) and name.lower() not in (
        "y",
        "n",
        "yes",
        "no",
        "on",
        "off",
        "true",
        "false",
        "null",
    ):
        return name
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _listed(names: Sequence[str]) -> str:
    return "[" + ", ".join(_quoted(name) for name in names) + "]"


def _nice(period: float) -> str:
    """Write a period, s, as that of the nearest round rate if it is one."""
    rate = 1 / period
    for step in (1000.0, 100.0, 10.0, 1.0):
        near = round(rate / step) * step
        if near and abs(rate / near - 1) < 2e-4:
            return f"{1 / near:.10g}"
    return f"{period:.7g}"
