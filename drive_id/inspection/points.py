"""Points by which columns are ranked: what their names and values say for and against each meaning.

Only differences between candidates for one meaning count. A column that is named for its meaning outweighs one whose
table is, and two hints of values; what names exclude outweighs all that speaks for it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from drive_id.core.checks.recognition import AngleLike
from drive_id.inspection.contents import Table
from drive_id.inspection.names import (
    NameGroup,
    begin_alike,
    is_derived,
    is_measured,
    is_temperature,
    suggests,
    unit_scale,
)
from drive_id.types import FloatArray

_BY_COLUMN = 2.0
"""Points for a meaning that the name of a column suggests: it is named for what it holds."""
_BY_TABLE = 1.0
"""The same for the name of its table, which holds other columns as well."""
_UNBALANCED = 0.05
"""Sum of the phases, by their size, above which they are no currents of a machine without a neutral wire."""
_PREFERRED = 0.25
"""Points by which one of several columns of a meaning is preferred: commanded voltages, measured currents, and nothing
that was filtered or estimated."""
_LEAST_LINK = 5.0
"""Mean, V, from which a nearly constant column may be the DC-link voltage; lower ones are supplies of electronics."""
_STEADY = 0.25
"""Standard deviation of a DC-link voltage by its mean."""


@dataclass(frozen=True, eq=False)
class PhaseGroup:
    """Phase quantities or components in one table."""

    table: Table
    group: NameGroup
    values: FloatArray
    signs: tuple[int, ...] = ()  # of currents, one of which is reversed; empty: none is

    @property
    def label(self) -> str:
        """What the names of the table and of the columns have in common."""
        return f"{self.table.name} {self.group.stem}"

    @property
    def unit_factor(self) -> float | None:
        """Factor to A or V by the unit that all columns state; None if they state none."""
        return unit_factor(self.table, self.group.names, "AV") or None


@dataclass(frozen=True, eq=False)
class AngleColumn:
    """A column that moves like the angle of a rotor."""

    table: Table
    name: str
    like: AngleLike
    values: FloatArray


def unit_factor(table: Table, names: Sequence[str], bases: str) -> float | None:
    """Return the factor to one of the ``bases`` by the unit that all names state; None for none, 0 for another base."""
    factor, base = (stated := {unit_scale(name, table.unit(name)) for name in names}).pop()
    return None if stated or not base else factor * (base in bases)


def _hints(column: str, table: str, meaning: str) -> float:
    return _BY_COLUMN * suggests(column, meaning) + _BY_TABLE * suggests(table, meaning)


def current_points(found: PhaseGroup) -> float:
    """Return what speaks for currents."""
    hints = partial(_hints, found.group.stem, found.table.name)
    points = hints("current") - hints("voltage") - 2.0 * hints("reference")  # named for currents, too
    points -= 4.0 * (found.group.frame == "line_to_line")  # only voltages are measured so
    common = float(np.abs(found.values.sum(axis=1)).mean() / np.abs(found.values).mean())
    points += len(found.values.T) == 3 and common < _UNBALANCED
    points += _PREFERRED * (is_measured(found.group.stem) - is_derived(found.group.stem))
    return points + (found.group.frame == "abc")  # measured; d and q are often references or filtered


def voltage_points(found: PhaseGroup) -> float:
    """Return what speaks for voltages."""
    hints = partial(_hints, found.group.stem, found.table.name)
    points = hints("voltage") - hints("current")
    stem = found.group.stem
    points += _PREFERRED * (suggests(stem, "reference") - is_measured(stem) - is_derived(stem))
    points += 0.5 * (found.group.frame == "abc")  # among equals: needs no angle
    return points + 0.1 * len(found.values.T)  # among equals: three rather than two of them


def angle_points(found: AngleColumn) -> float:
    """Return what speaks for the angle."""
    points = _hints(found.name, found.table.name, "angle") + found.like.certain + found.like.wraps
    return points - _PREFERRED * is_derived(found.name)


_SAME_LINK = 0.01
"""Relative difference of the means of columns up to which it matters little which one is the DC link."""
_LINK_NAMED = 2.0
"""Points for each hint of the name: no other meaning is confused with it."""
_LINK_VOLTAGE = 1.0
"""Points for the name of a voltage."""
_LINK_ALONE = 0.5
"""Points for the values alone: a steady positive number of some size."""


def dc_link(tables: Sequence[Table], u: PhaseGroup, others: Collection[str] = ()) -> tuple[Table, str] | None:
    """Return the column that looks like the DC-link voltage, by its name, or else by its values alone.

    Of equals, it is the one whose name begins most like that of the voltages ``u``; ``others`` are known to be
    something else.
    """
    own = f"{u.table.name} {u.group.names[0]}"
    found = [
        (_link_points(table, name), begin_alike(own, f"{table.name} {name}"), table, name)
        for table in tables
        for name in table.columns
        if name not in (*u.group.names, *others)
    ]
    points, _, table, name = max(found, key=lambda entry: entry[:2], default=(0.0, 0, None, ""))
    return (table, name) if table is not None and points > 0 else None


def rival_links(tables: Sequence[Table], link: tuple[Table, str] | None, others: Collection[str]) -> list[str]:
    """Return the columns that are named for a DC link as well, with another voltage, as of another drive."""
    if link is None:
        return []
    chosen = float(link[0].columns[link[1]].mean())
    return [
        name
        for table in tables
        for name, x in table.columns.items()
        if name not in (*others, link[1]) and suggests(name, "dc") and _link_points(table, name) > 0
        and abs(float(x.mean()) / chosen - 1) > _SAME_LINK
    ]  # fmt: skip


def is_named_link(table: Table, name: str) -> bool:
    """Tell whether the names suggest that a column is the DC-link voltage."""
    return suggests(name, "dc") or suggests(table.name, "dc")


def _link_points(table: Table, name: str) -> float:
    factor = unit_factor(table, (name,), "V")
    x = table.columns[name] * (1.0 if factor is None else factor)
    if (
        len(x) < 3
        or is_temperature(name, table.unit(name))
        or not np.isfinite(x).all()
        or not (x.mean() > _LEAST_LINK and x.std() < _STEADY * x.mean())
    ):
        return 0.0
    points = _LINK_NAMED * _hints(name, table.name, "dc")
    if x.std() > 0:  # measured, and no setting
        points += _LINK_VOLTAGE * suggests(name, "voltage")
        other = any(suggests(name, what) for what in ("current", "speed", "time"))
        points += _LINK_ALONE * (x.min() > 0 and not other)
    return points
