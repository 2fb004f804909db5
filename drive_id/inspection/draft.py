"""Propose a signals file for a log, with comments on what is uncertain."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from drive_id.common.quantity import counted
from drive_id.core import frames
from drive_id.core.checks.recognition import is_count
from drive_id.core.signals.matching import nearest
from drive_id.errors import ConfigurationError
from drive_id.files.messages.signal_sources import SPEED_UNITS
from drive_id.inspection.choice import TURNS, Choice, blank_columns, choose
from drive_id.inspection.clock import (
    GUESSED_PERIOD,
    INDEX,
    JITTER,
    TimeColumn,
    regular_stamps,
    stated_period,
    time_column,
)
from drive_id.inspection.contents import Contents, Table
from drive_id.inspection.names import (
    begin_alike,
    is_temperature,
    listed,
    name_groups,
    printable,
    quoted,
    stated_unit,
    suggests,
    unit_scale,
    words,
)
from drive_id.inspection.points import (
    PhaseGroup,
    current_points,
    dc_link,
    is_named_link,
    rival_links,
    unit_factor,
    voltage_points,
)
from drive_id.inspection.scales import (
    LARGEST_SHARE,
    full_scale,
    is_whole,
    may_be_half,
    open_by_name,
    open_scale,
    zero_reading,
)
from drive_id.inspection.static_draft import is_slow, static_draft
from drive_id.types import FloatArray

_REFERENCES = {1.0: "in A", float(np.sqrt(2)): "these are rms values", 1e-3: "in mA", 1e3: "in kA"}
"""Factors to A of references that some tools log."""
_SAME_RATE = 0.005
"""Relative difference up to which two sample periods are the same."""
_POOR = 0.35
"""Share of the voltage, unexplained, from which the choice itself is in doubt."""
_LARGEST_CURRENT = 5000.0
"""Largest plausible current, A, the same as in the check ``current_scale``."""
_LARGEST_LINK = 1500.0
"""Largest usual DC-link voltage, V: a larger constant is likely in other units."""
_ASSUMED_LINK = 400.0
"""DC-link voltage, V, for which the scale of duty cycles is written where the log holds none."""
_MOST_POLE_PAIRS = 24
"""Pole pairs that are tried as the ratio of an electrical angle and the speed of a shaft."""
_SAME_SPEED = 0.004
"""Relative difference of a speed and that of the angle, up to which they are the same."""
_VARIED = 0.05
"""Relative difference of two speeds."""
_SAME_TURN = 1e-6
"""Relative difference up to which an angle starts again at a turn of its unit."""
_NO_OFFSET = 0.035
"""Estimated offset, rad, that is not told from none."""
_NO_OFFSET_IN_ROTOR = 0.2
"""The same where one side is logged in d and q: the drive's own frame is that of the angle, and an estimate, some
degrees off, would turn voltages against currents."""
_COARSE = 1e-3
"""Electrical angle of one count, rad, from which the angle is smoothed."""
_SMOOTHING = 0.003
"""Time over which it is smoothed, s: short beside the acceleration of a shaft."""
_COUNTER = 1 << 16
"""Value at which a counter of 16 bits starts again, whatever the counts of a turn."""
_RESOLVERS = {"resolver", "res", "rdc", "rslv"}
"""Words of a sensor that may have several pole pairs of its own."""
_RPM = {"rpm", "min", "umin", "n", "drehzahl"}
"""Words of a speed in rpm: of six times as many pole pairs, it would be in degrees per second."""
_WINDING = {"winding", "wdg", "wicklung", "stator", "copper", "coil"}
"""Words of what has the temperature of a winding."""
_NO_READING = {"limit", "max", "min", "warn", "warning", "set", "setpoint", "ref", "trip"}
"""Words of a temperature that is a setting."""
_TO_CELSIUS = {"K": (1.0, -273.15), "°F": (5 / 9, -160 / 9)}
"""Factor and offset from units of a temperature to degrees Celsius."""
_PART_OF_LINK = {"half", "plus", "minus", "pos", "neg", "upper", "lower", "mid"}
"""Words of a part of the DC link, between a rail and its middle."""
_COLDEST, _HOTTEST = -60.0, 250.0
"""Temperatures of windings, degrees Celsius."""
_GAP = 1.5
"""Median steps of the stamps, from which on samples are missing between."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A proposed signals file."""

    text: str  # YAML with comments
    unsure: tuple[str, ...] = ()  # sentences on what to look at
    static: bool = False  # it is for method ``static``: without an angle


def propose(contents: Contents) -> Draft:
    """Propose a signals file.

    Raises ConfigurationError when no columns look like currents, voltages and an angle: says which are missing.
    """
    static = static_draft(contents)
    if static is None or not is_slow(contents):
        try:
            text = _DraftText(contents, *choose(contents))
            if static is None or text.unexplained <= _POOR:
                return text.draft()
        except ConfigurationError:
            if static is None:
                raise
    return _draft(
        contents, "A slow log in d and q without an angle: fit it with --method static.", *static, static=True
    )


def _draft(contents: Contents, remark: str, body: list[str], unsure: list[str], *, static: bool = False) -> Draft:
    head = [
        f"# Signals file proposed for {printable(contents.path.name)}.",
        "# docs/logs.md explains every setting.",
        f"# {remark}",
        *([f"# NOT SURE: {sentence}" for sentence in unsure] or ["# Nothing is left open."]),
    ]
    return Draft("\n".join([*head, "", *body]) + "\n", tuple(unsure), static)


class _DraftText:
    """Writes the proposal as YAML."""

    def __init__(self, contents: Contents, tables: Sequence[Table], choice: Choice) -> None:
        self._contents = contents
        self._tables = tables
        self._choice = choice
        self._unsure: list[str] = []
        self._period = choice.currents.table.period or 0.0
        taken = (*choice.currents.group.names, *choice.voltages.group.names, choice.angle.name)
        self._taken = {*taken, *(table.stamp_source for table in tables)}
        self._link = dc_link(tables, choice.voltages, taken)
        self._taken |= {self._link[1]} if self._link is not None else set()
        self._rival_links = rival_links(tables, self._link, self._taken)
        self.unexplained = choice.reading.unexplained

    def draft(self) -> Draft:
        """Return the proposal."""
        body = [*self._currents(), "", *self._voltages(), "", *self._rotor(), *self._reference(), *self._optional()]
        if blank := blank_columns(self._contents):
            self._unsure.append(f"The log holds {blank}.")
        left = self.unexplained
        if left > _POOR:
            self._unsure.append(
                f"A rough machine model leaves {100 * left:.0f} % of the voltage unexplained by these signals: "
                "currents, voltages or angle may be other columns, or phases be swapped."
            )
        remark = f"A rough machine model explains all but {100 * left:.2g} % of the voltage with it."
        return _draft(self._contents, remark, body, self._unsure)

    def _mark_of_rivals(
        self, meaning: str, found: PhaseGroup, points: Callable[[PhaseGroup], float], needed: str = ""
    ) -> str:
        """Say which further columns are named for currents or voltages, as of another drive, or measured ones.

        Return the mark of a guess where names do not tell them apart.
        """
        others = [
            PhaseGroup(table, group, np.column_stack([table.columns[name] for name in group.names]))
            for table in self._tables
            for group in name_groups([name for name, x in table.columns.items() if np.ptp(x) > 0])
            if group.frame == found.group.frame and suggests(group.stem, meaning) and len(group.names) > 1
            and not (meaning == "current" and suggests(group.stem, "reference"))
            and not self._taken & {*group.names}
        ]  # fmt: skip
        if not others:
            return ""
        rival = max(others, key=points)
        names = ", ".join(rival.group.names)
        self._unsure.append(
            f"{names} are named for {meaning}s, too; {', '.join(found.group.names)} were taken{needed}."
        )
        return f"   # EDIT: or {printable(names)}, named alike" if points(rival) >= points(found) else ""

    def _source(self, table: Table) -> list[str]:
        """Return the settings that give the place and time of a table's samples."""
        if self._contents.is_bag:
            return [f"topic: {table.name}", *(["stamp: log_time"] if table.stamp_source == "log_time" else [])]
        found = [f"group: {quoted(table.name)}"] if table.name and len(self._contents.tables) > 1 else []
        if table.stamp_source == INDEX:
            stated = stated_period(self._contents)
            found += ["stamp: index", f"sample_period: {stated.seconds if stated else GUESSED_PERIOD:g}"]
        elif table.stamp_source not in ("", "own"):
            time = time_column(table) or TimeColumn(table.stamp_source)
            found += time.settings(table.columns[time.name])
        return found

    def _time(self, table: Table, lines: list[str]) -> list[str]:
        """Return the lines that give the place and time of a table's samples, before other ``lines``."""
        found = [f"  {setting}" for setting in self._source(table)]
        time = time_column(table) if table.stamp_source in table.columns else None
        guessed = time is not None and not time.stated
        said = ""
        if table.stamp_source == INDEX and (stated := stated_period(self._contents)):
            name = printable(stated.name)
            found[-1] += f"    # s, by {name}" if stated.sure else f"    # EDIT: s, by {name}, if that is of the rows"
        elif table.stamp_source == INDEX:
            found[-1] += "         # EDIT: s; no column shows the time of a row"
            said = (
                "No column shows the time of a row: set sample_period in every section to the time between rows (the "
                f"draft assumes {GUESSED_PERIOD:g} s); speed and flux linkages depend on it."
            )
        elif time is not None and guessed:
            found[-1] += "               # EDIT: by whole numbers without a unit; ticks of a timer need stamp_scale, s"
            said = f"{time.name} holds whole numbers without a unit, taken for {time.unit}: flux linkages follow it."
        self._unsure += [said] if said and said not in self._unsure else []
        if table.stamp_source == INDEX:
            return [*found, *lines]
        if table.stamp_source == "log_time":
            found[-1] += "                 # the messages have no header"
        period, jitter = table.period, table.jitter
        counts = [
            name for name, x in table.columns.items() if table.block == 1 and is_count(x) and name != table.stamp_source
        ]
        if counts:
            found.append(f"  first_sample: {quoted(counts[0])}")
        if period is not None and jitter is not None and jitter > JITTER * period * table.block:
            found.append(f"  equally_spaced: true            # the stamps jitter by {jitter * 1e6:.3g} us rms")
            if table.block > 1:
                found.append(f"  sample_period: {_nice(period)}")
        elif period is not None and not guessed:
            steps = np.diff(table.stamp)
            usual = float(np.mean(steps[np.abs(steps) < _GAP * np.median(steps)])) * 1e-9  # dates are whole 256 ns here
            found.append(f"  sample_period: {_nice(usual if abs(usual / period - 1) > 1e-3 else period)}")
        return [*found, *lines]

    def _currents(self) -> list[str]:
        i = self._choice.currents
        mark = self._mark_of_rivals("current", i, current_points)
        lines = [f"  fields: {i.group.fields(i.signs)}{mark}", *_frame(i)]
        zero, largest = zero_reading(i), float(np.abs(i.values).max())
        factor, open_ = i.unit_factor or 1.0, open_scale(i.values, i.unit_factor, "A", i.group.frame)
        open_ += _other_unit(i, "A")
        if zero.any():
            open_ = [f"A per count: these are raw readings of an A/D converter, {_numbers(zero)} without current"]
        elif i.unit_factor is None and largest > _LARGEST_CURRENT:
            factor = 0.001
            open_ = [f"taken as mA, for they reach {largest:.3g}", *open_[is_whole(i.values) :]]
        elif i.unit_factor is None and largest <= LARGEST_SHARE:
            open_ = ["1, if these are A, and no shares of a rated current", *open_]
        sign = self._choice.reading.voltage_sign
        scale = factor * sign * np.array(i.signs or (1,) * len(i.group.names))
        self._tell_reversed("current sensor", i)
        offset = -zero * scale
        if len(zero) == 2 and i.group.missing != 2 and i.group.frame == "abc":
            scale = np.insert(scale, i.group.missing, factor * sign)
            offset = np.insert(offset, i.group.missing, -offset.sum())
        lines += self._scale("currents", _numbers(scale), open_)
        if zero.any():
            lines.append(f"  offset: {_numbers(offset)}       # EDIT: A; minus that reading times scale")
        return ["currents:", *self._time(i.table, lines)]

    def _voltages(self) -> list[str]:
        u = self._choice.voltages
        reading, names = self._choice.reading, u.group.names
        if u.group.frame == "abc" and len(names) == 3:
            names = tuple(u.group.names[k] for k in reading.voltage_order)
            if names != u.group.names:
                self._unsure.append(
                    f"The voltages explain the currents only in the order {', '.join(names)}: compare the wiring."
                )
            if reading.voltage_sign < 0:
                self._unsure.append(
                    "Currents and voltages have opposite signs: currents must be positive into the machine."
                )
        if u.group.frame == "line_to_line" and u.group.frame not in {group.frame for group in name_groups(names)}:
            self._unsure.append(f"{', '.join(names)} explain far more as voltages between phases, ab, bc and ca.")
        mark = self._mark_of_rivals("voltage", u, voltage_points, ": a fit needs the commanded ones")
        lines = [f"  fields: {replace(u.group, names=names).fields()}{mark}", *_frame(u)]
        full = full_scale(u)
        if full:
            lines.append(self._duty_scale(u, full))
        else:
            open_ = [*open_scale(u.values, u.unit_factor, "V", u.group.frame), *_other_unit(u, "V")]
            signs = np.array(u.signs or (1,) * len(names))
            signs = signs[list(reading.voltage_order)] if len(names) == 3 else signs
            lines += self._scale("voltages", _numbers((u.unit_factor or 1.0) * signs), open_)
            self._tell_reversed("voltage", u)
        if not suggests(u.label, "voltage"):
            self._unsure.append(
                f"{', '.join(u.group.names)} were taken for the voltages by their values, not by their names."
            )
        if u.group.frame == "dq":
            lines.append(
                "  angle_advance: 0.0  # EDIT: samples by which the drive's angle is ahead as it transforms them back: "
                "often 0.5 or 1.5"
            )
            self._unsure.append(
                "The voltages are d and q components: set angle_advance if the drive compensates its delay, by 0.5 or "
                "1.5 as a rule. Method full finds another one, most surely at several speeds; R follows it."
            )
        rate = u.table.period
        if rate and self._period and abs(rate / self._period - 1) > 2 * _SAME_RATE:
            self._unsure.append("Voltages and currents are recorded at different rates, which a fit refuses.")
        return ["voltages:", *self._time(u.table, lines)]

    def _tell_reversed(self, what: str, found: PhaseGroup) -> None:
        """Say which sign the draft changes, or that it exchanges d and q."""
        odd = [name for name, sign in zip(found.group.names, found.signs, strict=False) if sign < 0]
        names = found.group.names
        if odd and found.group.frame == "dq":
            self._unsure.append(f"{odd[0]} explains far more with its sign changed, as in the draft: q must lead d.")
        elif found.group.frame == "dq" and names not in {group.names for group in name_groups(names)}:
            self._unsure.append(f"{names[1]} and {names[0]} explain far more exchanged, as in the draft: compare them.")
        elif odd:
            self._unsure.append(f"The {what} of {odd[0]} seems to be reversed, and its sign is changed: compare it.")

    def _duty_scale(self, u: PhaseGroup, full: float) -> str:
        """Return the line that scales duty cycles of this range to volts."""
        known = {1.0: "0 to 1", 2.0: "-1 to 1", 100.0: "0 to 100 %", 200.0: "-100 to 100 %"}
        range_ = known.get(full, f"0 to {full:g}")
        open_ = open_scale(u.values, 1.0, "V", u.group.frame)
        if may_be_half(u, full):
            open_.append("twice that for voltages over the DC-link voltage")
            self._unsure.append(
                f"The duty cycles lie around zero and were taken to reach from {range_}: if they are voltages over "
                "the DC-link voltage, half of that, double the scale. The data cannot tell; R and flux follow it."
            )
        if self._link is None:
            self._unsure.append(
                f"{', '.join(u.group.names)} are duty cycles from {range_}, and no DC-link voltage is in the log: set "
                f"scale of the voltages to that voltage{f' over {full:g}' if full != 1.0 else ''} (written for "
                f"{_ASSUMED_LINK:g} V); R and flux are proportional to it."
            )
            wanted = "U_dc" if full == 1.0 else f"U_dc/{full:g}"
            said = "; ".join([f"{wanted}, V, for duty cycles from {range_}", *open_])
            return f"  scale: {_ASSUMED_LINK / full:g}  # EDIT: {said}"
        table, name = self._link
        factor, of_link = _link_scale(self._link, self._rival_links)
        if not is_named_link(table, name):
            self._unsure.append(f"{name} was taken for the DC-link voltage by its values, not by its name.")
            of_link = [*of_link, f"{printable(name)} was taken for the DC link by its values, not by its name"]
        source = [*([] if table is u.table else self._source(table)), f"field: {quoted(name)}"]
        source += [] if factor == full and not of_link else [f"scale: {factor / full:g}"]
        open_ = [*of_link, *open_]
        said = "; ".join([f"{'EDIT: for ' if open_ else ''}duty cycles from {range_}", *open_])
        return f"  scale: {{{', '.join(source)}}}   # {said}"

    def _scale(
        self, what: str, factor: str, open_: Sequence[str], follows: str = "R and map depend on it"
    ) -> list[str]:
        """Return the line of a scale, with the mark of a guess where something is ``open_`` about it."""
        if open_:
            self._unsure += [f"The scale of the {what} is a guess ({said}): {follows}." for said in open_]
            return [f"  scale: {factor}            # EDIT: {'; '.join(open_)}"]
        return [] if factor == "1" else [f"  scale: {factor}"]

    def _rotor(self) -> list[str]:
        choice, angle, reading = self._choice, self._choice.angle, self._choice.reading
        lines = [f"  angle: {quoted(angle.name)}"]
        unit = angle.like.unit
        turn, pole_pairs, why = self._by_speed() or (choice.turn, abs(reading.ratio[0]), "")
        if not why and (unit == "counts" or pole_pairs != 1):
            turn, pole_pairs, why = self._turn_of_shaft()
        if unit == "counts":
            lines += ["  angle_unit: counts", f"  counts_per_turn: {turn:.15g}"]
            if pole_pairs == 1:
                lines[-1] += "          # of an electrical turn"
            if choice.modulus:
                lines.append(f"  angle_modulus: {choice.modulus:g}")
        else:
            lines += [] if unit == "rad" else [f"  angle_unit: {unit}"]
            scale = TURNS[unit] / turn
            lines += [] if abs(scale - 1) < _SAME_TURN else [f"  angle_scale: {scale:.15g}"]
        if pole_pairs != 1:
            lines += ["  mechanical: true", f"  pole_pairs: {pole_pairs}{why}"]
        if reading.ratio[0] < 0:
            lines.append("  direction: -1                   # counts against the order of the phases")
        lines += self._offset()
        coarse = 2 * np.pi * pole_pairs / turn if unit == "counts" else 0.0
        if coarse > _COARSE:
            lines.append(
                f"  smoothing: {_SMOOTHING:g}                # s: one count is {coarse * 1e3:.2g} mrad electrical"
            )
        else:
            lines += self._speed(turn, pole_pairs)
        rate = angle.table.period
        if rate and abs(rate / self._period - 1) > _SAME_RATE:
            lines.append(
                f"  interpolate: true             # every {rate * 1e6:.4g} us, the currents {self._period * 1e6:.4g} us"
            )
        return ["resolver:", *self._time(angle.table, lines)]

    def _offset(self) -> list[str]:
        choice, reading = self._choice, self._choice.reading
        if choice.currents.group.frame == choice.voltages.group.frame == "dq":
            return []
        offset = reading.angle_offset
        if reading.voltage_sign < 0:  # written as a sign of the currents, which turns the axes by half a turn
            offset -= float(np.copysign(np.pi, offset))
        in_rotor = "dq" in (choice.currents.group.frame, choice.voltages.group.frame)  # in the drive's, by this angle
        offset = offset if abs(offset) > (_NO_OFFSET_IN_ROTOR if in_rotor else _NO_OFFSET) else 0.0
        if not reading.certain_offset:
            self._unsure.append(
                "The angle offset follows from the saliency only, so it may be wrong by a multiple of 90 degrees "
                "(1.5708), which exchanges or reverses the axes: compare with the d axis of your drive."
            )
        said = "estimated; method full corrects the rest" if offset else "no offset was found"
        if in_rotor:
            said = "estimated to some degrees, and turns d and q as well" if offset else "of the drive's d axis"
        if not reading.certain_offset:
            said = f"{said}, up to multiples of 1.5708"
        if (in_rotor and offset) or not reading.certain_offset:
            said = f"EDIT: rad; {said}"
        return [f"  angle_offset: {offset:.4g}          # {said}"]

    def _by_speed(self) -> tuple[float, int, str] | None:
        """Return a turn of the shaft, in the unit of the angle, and pole pairs, where its speed shows them."""
        electrical = self._choice.turn / abs(self._choice.reading.ratio[0])
        pairs, unit, _, name, sure = next(self._speeds(electrical), (1, "", 1, "", False))
        if pairs > 1 and sure and self._named_speed(name):
            return electrical * pairs, pairs, f"               # by {printable(name)}, in {unit} of the shaft"
        return None

    def _turn_of_shaft(self) -> tuple[float, int, str]:
        """Return a turn in the unit of the angle, its pole pairs, and what makes them known; 1 for the electrical turn.

        A resolver may start again several times per turn of the shaft, and a counter anywhere: without a speed of the
        shaft, they show only the electrical turn.
        """
        choice, angle = self._choice, self._choice.angle
        pole_pairs = abs(choice.reading.ratio[0])
        counts = angle.like.unit == "counts"
        of_sensor = (
            (angle.like.wraps or not counts) and pole_pairs > 1 and not (choice.modulus or choice.turn == _COUNTER)
        )
        of_sensor = of_sensor and not words(angle.name) & _RESOLVERS
        electrical = choice.turn / pole_pairs
        if of_sensor:
            what = "count" if counts else "angle"
            self._unsure.append(
                f"The pole pairs, {pole_pairs}, hold if the {what} starts again once per turn of the shaft: torque is "
                "proportional to them."
            )
            return choice.turn, pole_pairs, f"               # if the {what} starts again once per turn of the shaft"
        self._unsure.append(
            f"The log shows {electrical:.6g} {angle.like.unit} per electrical turn, but not the pole pairs: for torque "
            "give them to analyze (--pole-pairs), or here with mechanical: true and the scale of a turn of the shaft."
        )
        return electrical, 1, ""

    def _speed(self, turn: float, pole_pairs: int) -> list[str]:
        """Return the speed next to the angle, if the angle makes its unit clear."""
        for pairs, unit, sign, name, _ in self._speeds(turn, most=_MOST_POLE_PAIRS if pole_pairs == 1 else 1):
            scale = pairs * sign
            why = f"   # {counted(pairs, 'pole pair')}: the angle is electrical, the speed that of the shaft"
            scaled = [f"  speed_scale: {scale}{why if pairs > 1 else ''}"] if scale != 1 else []
            return [f"  speed: {quoted(name)}", f"  speed_unit: {unit}", *scaled]
        return ["  # no field is the speed of this angle: it is derived from the angle"]

    def _speeds(self, turn: float, most: int = _MOST_POLE_PAIRS) -> Iterator[tuple[int, str, int, str, bool]]:
        """Yield columns that are the speed of the angle, by its ``turn``, or a part of it by pole pairs.

        Each as pole pairs, unit, sign, name, and whether these pole pairs and this unit are the only ones that fit.
        """
        angle, choice = self._choice.angle, self._choice
        at = regular_stamps(angle.table)
        x = np.unwrap(angle.values, period=choice.modulus or choice.turn) if angle.like.wraps else angle.values
        x = x * (2 * np.pi / turn)
        seconds = (at - at[0]) * 1e-9
        half = len(x) // 2
        if x[-1] == x[0] or not 0 < seconds[half] < seconds[-1]:
            return
        by_angle = np.array([(x[-1] - x[0]) / seconds[-1], (x[half] - x[0]) / seconds[half]])
        varied = abs(by_angle[1] / by_angle[0] - 1) > _VARIED  # any constant is some multiple of a constant speed
        columns = sorted(
            angle.table.columns.items(),
            key=lambda column: (suggests(column[0], "speed"), begin_alike(column[0], angle.name)),
            reverse=True,
        )
        for name, y in columns:
            if name in self._taken or len(y) != len(x) or not np.isfinite(y).all() or not y.any():
                continue
            means = np.array([y.mean(), y[:half].mean()])
            named = self._named_speed(name)
            fitting: list[tuple[int, str, int]] = []
            for pairs, (unit, factor) in product(range(1, _MOST_POLE_PAIRS + 1), SPEED_UNITS.items()):
                ratios = means * factor * pairs / by_angle
                near = np.abs(np.abs(ratios) - 1)
                alike = pairs == 1 or (unit == "rpm" and varied and near.max() < _SAME_SPEED / 4)
                sure = named or (np.ptp(y) > 0 and alike)
                if near[0] < _SAME_SPEED and near[1] < 2.5 * _SAME_SPEED and sure:
                    fitting.append((pairs, unit, 1 if ratios[0] > 0 else -1))
            said = bool(words(f"{name} {angle.table.unit(name)}") & _RPM)
            for pairs, unit, sign in fitting:
                if pairs <= most:
                    yield pairs, unit, sign, name, len(fitting) == 1 or (said and unit == "rpm")

    def _named_speed(self, name: str) -> bool:
        """Tell whether a column is a speed by its name or its unit."""
        return suggests(name, "speed") or suggests(self._choice.angle.table.unit(name), "speed")

    def _reference(self) -> list[str]:
        """Return the pair of columns that the currents follow."""
        choice = self._choice
        theta = choice.samples.angle * choice.reading.ratio[0] + choice.reading.angle_offset
        i_dq = frames.to_dq(choice.samples.i_abc, theta)
        clock, own = choice.samples.stamp, choice.currents.group.names
        found_references: list[tuple[tuple[bool, float], list[str]]] = []
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
                factor = min(_REFERENCES, key=lambda known: abs(np.log(max(gain, 1e-300) / known)))
                if alike > 0.9 and 0.8 < gain / factor < 1.25:
                    scale = [f"  scale: {factor:.6g}          # by the currents: {_REFERENCES[factor]}"]
                    lines = [f"  fields: {listed(group.names)}", *(scale if factor != 1 else [])]
                    found_references.append(((factor == 1, alike), ["", "reference:", *self._time(table, lines)]))
        if found_references:
            return max(found_references)[1]
        self._unsure.append(
            "No columns are the references of i_d and i_q: a fit then takes i_max from the currents and corrects less "
            "for their noise."
        )
        return []

    def _optional(self) -> list[str]:
        found = [*self._optional_link(), *self._optional_temperature()]
        return ["", "optional:", *found] if found else []

    def _optional_link(self) -> list[str]:
        if self._link is None or not is_named_link(*self._link):
            return []
        table, name = self._link
        factor, open_ = _link_scale(self._link, self._rival_links)
        follows = "R and map depend on it" if full_scale(self._choice.voltages) else "torque over speed depends on it"
        scale = [f"  {line}" for line in self._scale("DC-link voltage", f"{factor:g}", open_, follows)]
        return ["  dc_link_voltage:", *self._scalar(table, name), *scale]

    def _optional_temperature(self) -> list[str]:
        """Return the column that is named for the temperature of the winding, in degrees Celsius or K."""
        for table in self._tables:
            for name, x in table.columns.items():
                unit = table.unit(name)
                scale, offset = _TO_CELSIUS.get(unit_scale(name, unit)[1], (1.0, 0.0))
                celsius = scale * x + offset
                if (
                    is_temperature(name, unit)
                    and words(name) & _WINDING
                    and not words(name) & _NO_READING
                    and name not in self._taken
                    and np.all((celsius > _COLDEST) & (celsius < _HOTTEST))
                ):
                    lines = [f"    scale: {scale:.6g}"] if scale != 1 else []
                    lines += [f"    offset: {offset:.6g}"] if offset else []
                    return ["  winding_temperature:", *self._scalar(table, name), *lines]
        return []

    def _scalar(self, table: Table, name: str) -> list[str]:
        """Return the lines of an optional signal: its time and its field."""
        time = [f"  {line}" for line in self._time(table, []) if "equally" not in line and "first_sample" not in line]
        return [*time, f"    field: {quoted(name)}"]


def _other_unit(found: PhaseGroup, unit: str) -> list[str]:
    """Return what is open about the scale of columns that state a unit of something else, or one that may be a word."""
    name = found.group.names[0]
    given, of_another = found.table.unit(name), unit_factor(found.table, found.group.names, unit) == 0
    said = "".join(stated_unit(name, given))
    return [f"{unit} per {said}, the unit that their names state"] * of_another + open_by_name(name, given)


def _link_scale(link: tuple[Table, str], rivals: Sequence[str]) -> tuple[float, list[str]]:
    """Return the factor from the column of the DC link to V, and what is open about it beside columns like it."""
    table, name = link
    x, factor = table.columns[name], unit_factor(table, (name,), "V")
    setting = np.ptp(x) == 0 and x[0] <= _LARGEST_LINK  # in V, as it was typed
    open_ = [] if setting else open_scale(x, factor, "V")
    if part := words(name) & _PART_OF_LINK:
        open_.append(f"it may be a part of the link, as its name says: {min(part)}")
    open_ += open_by_name(name)
    if rivals:
        open_.append(f"or {' or '.join(map(printable, rivals))}, named for a DC link as well")
    return factor or 1.0, open_


def _frame(found: PhaseGroup) -> list[str]:
    return [] if found.group.frame == "abc" else [f"  frame: {found.group.frame}"]


def _numbers(x: FloatArray) -> str:
    """Return one number where all are alike, or a list."""
    each = [f"{number:.6g}" for number in x]
    return each[0] if len(set(each)) == 1 else f"[{', '.join(each)}]"


def _nice(period: float) -> str:
    """Write a period, s, rounded to that of a round rate if it is close to one."""
    rate = 1 / period
    for step in (1000.0, 100.0, 10.0, 1.0):
        near = round(rate / step) * step
        if near and abs(rate / near - 1) < 2e-4:
            return f"{1 / near:.10g}"
    return f"{period:.7g}"
