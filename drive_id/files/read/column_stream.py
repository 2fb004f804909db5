"""Columns of a log to signals in SI units, at once or part by part: the counterpart of messages of a bag."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.errors import ConfigurationError, MessageTypeError, MissingTopicError
from drive_id.files.logs.column_log import NUMBERS, OWN_TIME, Column, ColumnLog, Rows, find_column
from drive_id.files.logs.open_log import open_log
from drive_id.files.messages.field_path import FieldPathError
from drive_id.files.messages.message_reader import MessageSamples, ticks_to_ns
from drive_id.files.messages.signal_sources import NAMED_STAMPS, SignalMap, TimeSource
from drive_id.files.read.extraction import LogSignals
from drive_id.files.storage.container import TopicInfo


@dataclass(frozen=True)
class _Section:
    """Where one section is: its columns, those of stamp, count and period, or None."""

    source: TimeSource
    values: tuple[Column, ...]
    stamp: Column | None
    count: Column | None
    period: Column | None

    @property
    def columns(self) -> tuple[Column, ...]:
        named = (column for column in (self.stamp, self.count, self.period) if column is not None)
        return (*self.values, *named)


class ColumnStream(LogSignals):
    """The signals of one drive in an open log of columns.

    Raises MissingTopicError when a required column is not there, ConfigurationError when the signals file names topics,
    or no time.
    """

    def __init__(self, log: ColumnLog, signals: SignalMap) -> None:
        if not signals.of_columns:
            raise ConfigurationError(
                f"{log.path} is a {log.kind} file, but the signals are read from topics: give a signals file that "
                "names columns, which 'drive-id check LOG --draft FILE' proposes."
            )
        self._log = log
        self._sections: dict[str, _Section] = {}
        for name, source in signals.sources().items():
            with suppress(*[] if name in signals.needed else [MissingTopicError]):
                self._sections[name] = _located(log, source, name)
        sources = {name: section.source for name, section in self._sections.items()}
        names = {name: f"{name} ({', '.join(source.paths)})" for name, source in sources.items()}
        topics = {name: TopicInfo(shown, log.kind, None, "") for name, shown in names.items()}
        super().__init__(log.path, signals, sources, topics, signals.needed)
        self._share = 0.0

    def _pieces(self) -> Iterator[tuple[str, MessageSamples]]:
        wanted = dict.fromkeys(column for section in self._sections.values() for column in section.columns)
        for rows in self._log.parts(list(wanted)):
            self._share = rows.progress
            for name, section in self._sections.items():
                try:
                    piece = _piece(rows, section)
                except (FieldPathError, ValueError, TypeError) as error:
                    raise MessageTypeError(
                        f"{self.topics[name].name} in {self._path} cannot be read ({error}): name other columns."
                    ) from error
                if len(piece.columns[0]):
                    yield name, piece

    def _progress(self) -> float:
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
            columns = [column.astype(np.float64) for column in _piece(rows, section).columns]
            amplitude = np.hypot(*source.in_si_units(columns).T)
            largest = max(largest, float(np.max(amplitude, initial=0.0, where=np.isfinite(amplitude))))
    return largest


def _located(log: ColumnLog, source: TimeSource, name: str) -> _Section:
    values = tuple(find_column(log, path, source.group, name) for path in source.paths)
    group = next(entry for entry in log.groups if entry.name == values[0].group)
    stamp: Column | None = None
    if source.stamp not in NAMED_STAMPS:
        stamp = find_column(log, source.stamp, source.group or group.name, name)
    elif source.stamp != "index":
        if group.own_time:
            stamp = Column(group.name, OWN_TIME)
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


def _piece(rows: Rows, section: _Section) -> MessageSamples:
    """Return the rows of one section in which any of its values is there."""
    source = section.source
    columns = [np.asarray(rows.values[column]) for column in section.values]
    if any(len(column) != len(columns[0]) for column in columns):
        raise FieldPathError(f"its columns have {', '.join(str(len(column)) for column in columns)} rows")
    for column in columns:
        if column.dtype.kind not in NUMBERS:
            raise FieldPathError("its columns hold no numbers")
    there = ~np.all([np.isnan(column) for column in columns], axis=0)

    def kept(column: Column) -> NDArray[Any]:
        found = np.asarray(rows.values[column])
        if len(found) != len(there):
            raise FieldPathError(f"'{column.name}' has {len(found)} rows, and the values {len(there)}")
        return found if there.all() else found[there]

    stamp = np.zeros(int(there.sum()), np.int64)
    if section.stamp is not None:
        own = section.stamp.name == OWN_TIME
        stamp = kept(section.stamp) if own else ticks_to_ns(kept(section.stamp), source.tick, section.stamp.name)
    count = None if section.count is None else np.asarray(kept(section.count)).astype(np.int64)
    period: float | None = None if isinstance(source.sample_period, str) else source.sample_period
    if section.period is not None and there.any():
        period = float(kept(section.period)[0])
    return MessageSamples(stamp, count, period, tuple(column[there].astype(np.float64) for column in columns))
