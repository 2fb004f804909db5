"""Propose a signals file for slow logs in d and q without an angle, by the names of the columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drive_id.inspection.clock import stamp_unit, timed
from drive_id.inspection.contents import Contents, Table
from drive_id.inspection.names import listed, name_groups, quoted, stated_unit, suggests, words
from drive_id.inspection.points import unit_factor
from drive_id.inspection.scales import open_by_name, open_scale

_RPM = {"n", "min", "drehzahl", "speed"}
"""Words of a speed that is likely one in rpm, though no unit is stated."""
_STATED = {"rpm": "rpm", "erpm": "rpm", "rps": "rev/s", "hz": "rev/s", "dps": "deg/s"}
"""Words that are the unit of a speed."""
_UNITS = {"rpm": "rpm", "min-1": "rpm", "1/min": "rpm", "U/min": "rpm", "rad/s": "rad/s", "Hz": "rev/s"}
"""Units of speeds by what logs call them."""
_SHAFT = {"rpm", "rps", "mech", "mechanical", "shaft", "m", "rotor", "motor", "mot"} | _RPM
"""Words of the speed of a shaft."""
_ELECTRICAL = {"erpm", "el", "elec", "electrical", "e", "hz"}
"""Words of a speed that is electrical."""
_SLOW = 5e-3
"""Time between rows, s, from which on a log is too slow for method ``full``."""


def is_slow(contents: Contents) -> bool:
    """Tell whether all rows of a log with a time are too far apart for a drive's currents to be followed."""
    periods = [table.period for table in (timed(table, contents) for table in contents.tables)]
    known = [period for period in periods if period]
    return bool(known) and min(known) > _SLOW


def static_draft(contents: Contents) -> tuple[list[str], list[str]] | None:
    """Return the lines of a signals file for method ``static``, and what is unsure; None without d, q and a speed.

    Rows may have blank cells, as where each CAN frame is a row: each section takes the rows in which it has values.
    """
    for table in contents.tables:
        pairs = [group for group in name_groups(list(table.columns)) if group.frame == "dq"]
        measured = [group for group in pairs if not suggests(group.stem, "reference")]
        currents = [group.names for group in measured if suggests(group.stem, "current")]
        pairs.sort(key=lambda group: suggests(group.stem, "reference"), reverse=True)  # voltages are commanded
        voltages = [group.names for group in pairs if suggests(group.stem, "voltage") and group.names not in currents]
        taken = {name for group in pairs for name in group.names}
        speeds = [name for name in table.columns if suggests(name, "speed") and name not in taken]
        speeds.sort(key=lambda name: suggests(name, "reference"))
        if currents and voltages and speeds:
            return _lines(contents, table, currents[0], voltages[0], speeds[0])
    return None


def _lines(
    contents: Contents, table: Table, currents: Sequence[str], voltages: Sequence[str], speed: str
) -> tuple[list[str], list[str]]:
    unsure = []
    where = [f"topic: {table.name}"] if contents.is_bag else []
    if table.name and len(contents.tables) > 1 and not contents.is_bag:
        where = [f"group: {quoted(table.name)}"]
    time = next((name for name, x in table.columns.items() if suggests(name, "time") and _is_time(x)), "")
    if time and not len(table.stamp):
        said = stamp_unit(table, time)
        where += [f"stamp: {quoted(time)}", f"stamp_unit: {said or 's'}"]
        if not said:
            unsure.append(f"The unit of {time} was taken to be s.")
    elif not len(table.stamp):
        unsure.append("The log has no time column, so each row is taken for an operating point.")
    unit, shaft, open_speed = _speed_of(speed, table.unit(speed))
    unsure.append(
        f"{speed} was taken as {f'the speed of the shaft in {unit}' if shaft else f'the electrical speed in {unit}'}: "
        "the fluxes follow its unit" + (" and pole_pairs, which no data show." if shaft else ".")
    )
    body = [f"defaults: {{{', '.join(where)}}}"] if where else []
    for what, unit_, names in (
        ("currents", "A", currents),
        ("voltages", "V, phase to neutral, as commanded", voltages),
    ):
        x = np.concatenate([table.columns[name] for name in names])
        factor = unit_factor(table, names, "AV")
        open_ = open_scale(x[np.isfinite(x)], factor or None, unit_[0], "dq") + open_by_name(names[0])
        body += [f"{what}:", "  frame: dq", f"  fields: {listed(names)}   # {unit_}, peak"]
        body += [f"  scale: {factor or 1:g}   # EDIT: {'; '.join(open_)}"]
    mark = f"   # EDIT: {'; '.join(open_speed)}" if open_speed else ""
    body += ["resolver:", f"  speed: {quoted(speed)}", f"  speed_unit: {unit}{mark}"]
    if shaft:
        body += ["  mechanical: true", "  pole_pairs: 1   # EDIT: that of the machine"]
    return body, unsure


def _speed_of(name: str, given: str) -> tuple[str, bool, list[str]]:
    """Return the unit of a speed, whether it is that of the shaft, and what neither the log nor its name states."""
    own = words(name)
    known = _UNITS.get(stated_unit(name, given)[1]) or next((_STATED[word] for word in _STATED if word in own), "")
    shaft, electrical = bool(own & _SHAFT or known == "rpm"), bool(own & _ELECTRICAL)
    open_ = [] if known else ["the log states no unit"]
    if not (shaft or electrical):
        open_.append("if it is that of the shaft, add mechanical: true and pole_pairs")
    return known or ("rpm" if own & _RPM else "rad/s"), shaft and not electrical, open_


def _is_time(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    there = values[np.isfinite(values)]
    return len(there) > 2 and bool(np.all(np.diff(there) >= 0)) and there[-1] > there[0]
