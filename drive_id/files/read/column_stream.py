"""Columns of a log to signals in SI units, at once or part by part: the counterpart of messages of a bag."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.core.signals.signal import Signal
from drive_id.errors import ConfigurationError, EmptyTopicError, MessageTypeError, MissingTopicError
from drive_id.files.logs.column_log import OWN_TIME, Column, ColumnLog, Rows, find_column
from drive_id.files.logs.open_log import open_log
from drive_id.files.messages.field_path import FieldPathError
from drive_id.files.messages.message_reader import MessageSamples, ticks_to_ns
from drive_id.files.messages.si_units import in_si_units
from drive_id.files.messages.signal_sources import NAMED_STAMPS, SignalMap, TimeSource
from drive_id.files.read.extraction import INTERPOLATED, SignalBuilder, SignalPart, spacing_remarks
from drive_id.files.read.memory import MemoryGuard
from drive_id.files.storage.container import TopicInfo


@dataclass(frozen=True)
class ColumnFile:
    """What stands for the bag of a log of columns: its file, without warnings."""

    path: Path
    checked = False
    """Whether checksums cover the samples."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The file itself."""
        return (self.path,)

    @property
    def warnings(self) -> tuple[str, ...]:
        """None."""
        return ()


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


class ColumnStream:
    """The signals of one drive in an open log of columns.

    Parameters
    ----------
    log : ColumnLog
    signals : SignalMap

    Raises
    ------
    MissingTopicError
        When a required column is not there.
    ConfigurationError
        When the signals file names topics, or no time.
    """

    def __init__(self, log: ColumnLog, signals: SignalMap) -> None:
        if not signals.of_columns:
            raise ConfigurationError(
                f"{log.path} is a {log.kind} file, and its signals are looked for on topics: give a signals file that "
                "names columns, which 'drive-id check LOG --draft FILE' proposes."
            )
        self._log = log
        self._signals = signals
        self._sections: dict[str, _Section] = {}
        for name, source in signals.sources().items():
            with suppress(*[] if name in signals.needed else [MissingTopicError]):
                self._sections[name] = _located(log, source, name)
        self.topics = {
            name: TopicInfo(f"{name} ({', '.join(section.source.paths)})", log.kind, None, "")
            for name, section in self._sections.items()
        }
        self._builders = {
            name: SignalBuilder(self.topics[name].name, name, section.source)
            for name, section in self._sections.items()
        }

    @property
    def continuous(self) -> bool:
        """Whether every part is complete by itself."""
        required = (section.source for name, section in self._sections.items() if name not in INTERPOLATED)
        declared = all(source.sample_period is not None for source in required)
        return bool(self._signals.resolver.own_speed) and declared and not self._signals.at_once

    def whole(self) -> dict[str, Signal]:
        """Return the complete signals."""
        pieces: dict[str, list[MessageSamples]] = defaultdict(list)
        guard = MemoryGuard(self._log.path)
        for rows in self._log.parts(self._wanted):
            for name, piece in self._pieces(rows):
                pieces[name].append(piece)
                if name == "currents":
                    guard.add(len(piece.columns[0]), rows.progress)
        self._refuse_empty(pieces)
        return self._built(pieces)

    def parts(self) -> Generator[SignalPart, None, None]:
        """Yield the signals part by part."""
        seen: set[str] = set()
        for rows in self._log.parts(self._wanted):
            pieces = {name: [piece] for name, piece in self._pieces(rows)}
            seen.update(pieces)
            yield SignalPart(self._built(pieces), rows.progress)
        self._refuse_empty(seen)

    def remarks(self) -> tuple[str, ...]:
        """Return sentences on how the time of the signals was found; after :meth:`whole`."""
        return spacing_remarks(self._builders.values())

    @property
    def _wanted(self) -> list[Column]:
        return list(dict.fromkeys(column for section in self._sections.values() for column in section.columns))

    def _refuse_empty(self, seen: Any) -> None:
        for name in self._signals.needed:
            if name not in seen and name not in INTERPOLATED:
                raise EmptyTopicError(f"{self.topics[name].name} in {self._log.path} holds no sample: check the log.")

    def _built(self, pieces: dict[str, list[MessageSamples]]) -> dict[str, Signal]:
        with np.errstate(invalid="ignore", over="ignore"):  # the join reports values that are not finite
            return {name: self._builders[name].build(found) for name, found in pieces.items()}

    def _pieces(self, rows: Rows) -> Iterator[tuple[str, MessageSamples]]:
        for name, section in self._sections.items():
            try:
                piece = _piece(rows, section)
            except (FieldPathError, ValueError, TypeError) as error:
                raise MessageTypeError(
                    f"{self.topics[name].name} in {self._log.path} cannot be read ({error}): name other columns."
                ) from error
            if len(piece.columns[0]):
                yield name, piece


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
            values = in_si_units(columns, source)
            amplitude = np.hypot(*values.T)
            largest = max(largest, float(np.max(amplitude, initial=0.0, where=np.isfinite(amplitude))))
    return largest


def _located(log: ColumnLog, source: TimeSource, name: str) -> _Section:
    """Find the columns of a section."""
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
        if column.dtype.kind not in "iufb":
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
