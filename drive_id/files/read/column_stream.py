"""Columns of a log to signals in SI units, at once or part by part: the counterpart of messages of a bag."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.common.messages import Message
from drive_id.common.quantity import counted
from drive_id.core.signals.restarts import Restarts
from drive_id.errors import ConfigurationError, MessageTypeError, MissingTopicError
from drive_id.files.logs.column_log import (
    NUMBERS,
    OWN_TIME,
    Column,
    ColumnLog,
    Rows,
    find_column,
    part_of_second,
    seconds_columns,
)
from drive_id.files.logs.open_log import open_log
from drive_id.files.messages.field_path import FieldPathError
from drive_id.files.messages.message_reader import MessageSamples, ticks_to_ns
from drive_id.files.messages.signal_sources import NAMED_STAMPS, SignalMap, TimeSource
from drive_id.files.read.extraction import LogSignals
from drive_id.files.storage.container import TopicInfo

NO_TIME = np.iinfo(np.int64).min
"""Stamp of a row whose time is blank."""


@dataclass(frozen=True)
class _Section:
    """Where one section is: its columns, those of stamp, count and period, or None."""

    source: TimeSource
    values: tuple[Column, ...]
    stamp: tuple[Column, ...]  # none, one, or seconds and nanoseconds
    count: Column | None
    period: Column | None

    @property
    def columns(self) -> tuple[Column, ...]:
        named = (column for column in (self.count, self.period) if column is not None)
        return (*self.values, *self.stamp, *named)


class ColumnStream(LogSignals):
    """The signals of one drive in an open log of columns.

    Raises MissingTopicError when a required column is not there, ConfigurationError when the signals file names topics,
    or no time.
    """

    def __init__(self, log: ColumnLog, signals: SignalMap) -> None:
        if not signals.of_columns:
            raise ConfigurationError(
                f"{log.path} is a {log.kind} file, but no signals file says which columns hold the signals: "
                f"'drive-id check {log.path} --draft signals.yaml' writes one, and --signals signals.yaml uses it."
            )
        self._log = log
        self._sections: dict[str, _Section] = {}
        for name, source in signals.sources().items():
            with suppress(*[] if name in signals.needed else [MissingTopicError]):
                self._sections[name] = _located(log, source, name)
        sources = {name: section.source for name, section in self._sections.items()}
        names = {name: f"{name} ({', '.join(source.paths)})" for name, source in sources.items()}
        topics = {name: TopicInfo(shown, log.kind, None, "") for name, shown in names.items()}
        super().__init__(log.path, signals, sources, topics, signals.needed, blanks=True)
        self._share = 0.0
        self._restarts: dict[tuple[tuple[Column, ...], float], Restarts] = {}

    def _pieces(self) -> Iterator[tuple[str, MessageSamples]]:
        wanted = dict.fromkeys(column for section in self._sections.values() for column in section.columns)
        self._restarts = {}
        for rows in self._log.parts(list(wanted)):
            self._share = rows.progress
            times: dict[tuple[tuple[Column, ...], float], NDArray[Any]] = {}
            for name, section in self._sections.items():
                try:
                    key = section.stamp, section.source.tick
                    if section.stamp and key not in times:
                        times[key] = self._times(rows, section)
                    piece = _piece(rows, section, times.get(key))
                except (FieldPathError, ValueError, TypeError) as error:
                    raise MessageTypeError(
                        f"{self.topics[name].name} in {self._path} cannot be read ({error}): name other columns."
                    ) from error
                if len(piece.columns[0]):
                    yield name, piece

    def _times(self, rows: Rows, section: _Section) -> NDArray[Any]:
        """Return the times of some rows (N,), those of captures one behind the other; :data:`NO_TIME` for none."""
        key = section.stamp, section.source.tick
        found = _stamps(rows, section)
        if section.source.stamp_bits is not None:
            return found  # which starts again at a known value
        restarts = self._restarts.setdefault(key, Restarts())
        there = found != NO_TIME
        found[there] = restarts.continued(found[there])
        return found

    def remarks(self) -> tuple[Message, ...]:
        """Return what :meth:`LogSignals.remarks` does, and where time starts again."""
        found = {
            key[0]: Message("time_restarts", column=_shown(key[0]), places=restarts.places, row=restarts.first + 1)
            for key, restarts in self._restarts.items()
            if restarts.places
        }
        return (*super().remarks(), *found.values())

    def progress(self) -> float:  # noqa: D102  # as in LogSignals
        return self._share


def largest_reference(path: Path, signals: SignalMap) -> float | None:
    """Return the largest amplitude of the current references of a file of columns, A; None if it has none."""
    source = signals.reference
    if source is None:
        return None
    with open_log(path) as log:
        try:
            section = _located(log, source, "reference")
        except MissingTopicError:
            return None
        largest = 0.0
        for rows in log.parts(section.columns):
            columns = [column.astype(np.float64) for column in _piece(rows, section, None).columns]
            amplitude = np.hypot(*source.in_si_units(columns).T)
            largest = max(largest, float(np.max(amplitude, initial=0.0, where=np.isfinite(amplitude))))
    return largest


def _located(log: ColumnLog, source: TimeSource, name: str) -> _Section:
    values = tuple(find_column(log, path, source.group, name) for path in source.paths)
    group = next(entry for entry in log.groups if entry.name == values[0].group)
    if any(column.group != values[0].group for column in values) and group.own_time:
        groups = ", ".join(dict.fromkeys(column.group for column in values))
        raise ConfigurationError(
            f"The columns of section '{name}' ({', '.join(column.name for column in values)}) have different times in "
            f"{log.path} ({groups}): write them with one start and one rate."
        )
    stamp: tuple[Column, ...] = ()
    if source.stamp not in NAMED_STAMPS:
        stamp = tuple(Column(group.name, column) for column in seconds_columns(source.stamp, group.columns))
        stamp = stamp or (find_column(log, source.stamp, source.group or group.name, name),)
    elif source.stamp != "index":
        if group.own_time:
            stamp = (Column(group.name, OWN_TIME),)
        elif source.sample_period is None:
            raise ConfigurationError(
                f"Section '{name}' names no time, and {log.path} has none of its own: give stamp (the column of the "
                "time) with its stamp_unit, or sample_period."
            )
        else:
            source = replace(source, stamp="index")
    count = find_column(log, source.first_sample, source.group or group.name, name) if source.first_sample else None
    period = source.sample_period
    period_column = find_column(log, period, source.group, name) if isinstance(period, str) else None
    return _Section(source, values, stamp, count, period_column)


def _shown(columns: tuple[Column, ...]) -> str:
    return " and ".join(column.name or "the file's own time" for column in columns)


def _stamps(rows: Rows, section: _Section) -> NDArray[Any]:
    """Return the times of some rows (N,), ns; :data:`NO_TIME` where the cell is blank."""
    name = _shown(section.stamp)
    raw = [np.asarray(rows.values[column]) for column in section.stamp]
    if section.stamp[0].name == OWN_TIME:
        return np.asarray(np.maximum(raw[0], NO_TIME + 1))
    there = ~np.any([np.isnan(column) for column in raw], axis=0)
    found: NDArray[Any] = np.full(len(raw[0]), NO_TIME)
    ticks = [1e9, part_of_second(section.stamp[1].name)] if len(raw) > 1 else [section.source.tick]
    found[there] = sum(ticks_to_ns(column[there], tick, name) for column, tick in zip(raw, ticks, strict=True))
    return found


def _piece(rows: Rows, section: _Section, stamps: NDArray[Any] | None) -> MessageSamples:
    """Return the rows of one section in which any of its values is there, and the time."""
    source = section.source
    columns = [np.asarray(rows.values[column]) for column in section.values]
    if any(len(column) != len(columns[0]) for column in columns):
        raise FieldPathError(f"its columns have {', '.join(str(len(column)) for column in columns)} rows")
    for column in columns:
        if column.dtype.kind not in NUMBERS:
            raise FieldPathError("its columns hold no numbers")
    there = ~np.all([np.isnan(column) for column in columns], axis=0)
    if stamps is not None:
        if len(stamps) != len(there):
            raise FieldPathError(
                f"'{_shown(section.stamp)}' has {counted(len(stamps), 'row')}, and the values {len(there)}"
            )
        there &= stamps != NO_TIME

    def kept(column: Column) -> NDArray[Any]:
        found = np.asarray(rows.values[column])
        if len(found) != len(there):
            raise FieldPathError(f"'{column.name}' has {counted(len(found), 'row')}, and the values {len(there)}")
        return found if there.all() else found[there]

    stamp = np.zeros(int(there.sum()), np.int64) if stamps is None else stamps[there]
    count = None if section.count is None else np.asarray(kept(section.count)).astype(np.int64)
    period: float | None = None if isinstance(source.sample_period, str) else source.sample_period
    if section.period is not None and there.any():
        period = float(kept(section.period)[0])
    return MessageSamples(stamp, count, period, tuple(column[there].astype(np.float64) for column in columns))
