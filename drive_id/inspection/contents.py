"""The numbers of any log as tables: the first rows of each topic of a bag or group of columns."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drive_id.errors import DriveIdError, MessageTypeError
from drive_id.files.logs.column_log import NUMBERS, OWN_TIME, Column, ColumnGroup, ColumnLog
from drive_id.files.logs.log_kind import log_kind
from drive_id.files.logs.open_log import open_log
from drive_id.files.messages.field_path import FieldPath, FieldPathError, parse_field_path
from drive_id.files.messages.message_reader import DECODE_ERRORS, decoder
from drive_id.files.messages.signal_sources import SignalMap
from drive_id.files.storage.bag import Bag, open_bag
from drive_id.files.storage.container import TopicInfo
from drive_id.types import FloatArray, IntArray

ROWS = 40_000
"""Rows of each group of columns, or samples in blocks of each topic, that are inspected."""
MESSAGES = 20_000
"""Messages of each topic that are inspected; fewer, because each is decoded as a Python object."""
_MOST_MESSAGES = 200_000  # of all topics
_MOST_ELEMENTS = 16
"""Longest array whose elements are columns of their own; longer ones are blocks of samples."""
_DEPTH = 4  # of fields within fields, beyond which nobody keeps a signal
_FIRST_ROWS = 100  # by which columns are judged to hold numbers
_DATES = ("timestamp", "datetime")
"""Begins of types of dates, which are read as ns, whatever their resolution."""
_STEADY = 0.02
"""Difference of a step of the stamps from their median, by the median, up to which it is a usual one."""
_MOSTLY = 0.8
"""Share of usual steps from which longer ones are lost messages, and no jitter."""


@dataclass(frozen=True, eq=False)
class Table:
    """The first rows of a topic, or of a group of columns."""

    name: str  # topic, or group
    kind: str  # message type, or kind of file
    rows: int | None  # in the log; messages of a topic
    columns: dict[str, FloatArray] = field(default_factory=dict)  # each (n,), by field path or name
    types: dict[str, str] = field(default_factory=dict)
    stamp: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))  # (n,), ns; empty if only a column is a time
    stamp_source: str = ""  # "header", "log_time", "own" (the container's), or empty
    block: int = 1  # samples per message; 1 for columns
    problem: str = ""  # why a topic cannot be read

    def unit(self, name: str) -> str:
        """Return the unit that the log gives for a column, such as ``ms``; empty if it gives none."""
        kind, _, unit = self.types.get(name, "").partition("[")
        return "ns" if kind.startswith(_DATES) else unit.rstrip("]")

    @property
    def period(self) -> float | None:
        """Usual time between rows, s, without gaps where all others are steady; None without stamps."""
        if len(self.stamp) < 3:
            return None
        steps = np.diff(self.stamp).astype(np.float64)
        near = steps[np.abs(steps - np.median(steps)) < 0.5 * np.median(steps)]
        steady = len(near) > _MOSTLY * len(steps) and near.std() < _STEADY * near.mean()
        return float(near.mean() if steady else steps.mean()) * 1e-9 or None

    @property
    def jitter(self) -> float | None:
        """Root mean square deviation of the time between messages from its median, s; lost messages are no jitter."""
        each = self.stamp[:: self.block]
        if len(each) < 3:
            return None
        steps = np.diff(each).astype(np.float64)
        usual = float(np.median(steps))
        if usual == 0.0:  # several rows share each printed time
            return float(np.sqrt(np.mean((steps - steps.mean()) ** 2))) * 1e-9
        near = steps[np.abs(steps - usual) < 20 * max(np.median(np.abs(steps)), 1.0)]
        if np.mean(np.abs(near - usual) < _STEADY * usual) > _MOSTLY:
            near = near - usual * (np.maximum(np.rint(near / usual), 1) - 1)
        return float(np.sqrt(np.mean((near - np.median(near)) ** 2))) * 1e-9


@dataclass(frozen=True, eq=False)
class Contents:
    """Contents of a log."""

    path: Path
    kind: str  # "mcap", "sqlite3", "rosbag1", "csv", "parquet", "mat", "mat73", "hdf5", "mdf" or "tdms"
    tables: tuple[Table, ...]
    bounded: bool = True  # a fit reads it part by part
    facts: Mapping[str, float] = field(default_factory=dict)  # single numbers beside its tables

    @property
    def is_bag(self) -> bool:
        """Whether its tables are topics."""
        return bool(set(self.kind.split("+")) & {"mcap", "sqlite3", "rosbag1"})


def read_contents(path: Path, signals: SignalMap | None = None) -> Contents:
    """Read the first rows of everything in a log; raises BagError when it is no log, or cannot be read."""
    if log_kind(path):
        with open_log(path) as log:
            tables = tuple(_of_group(log, group) for group in log.groups)
            return Contents(path, log.kind, tables, log.bounded, log.facts)
    with open_bag(path) as bag:
        kinds = "+".join(sorted({storage.kind for storage in bag.storages}))
        return Contents(path, kinds, tuple(_of_topics(bag, signals or SignalMap())))


def _of_group(log: ColumnLog, group: ColumnGroup) -> Table:
    columns = [Column(group.name, name) for name in group.columns]
    table = _table(log, group, _of_numbers(log, columns, _FIRST_ROWS))
    if table.problem and not table.columns:  # a column may hold a text later on
        return _table(log, group, _of_numbers(log, columns, ROWS))
    return table


def _table(log: ColumnLog, group: ColumnGroup, wanted: list[Column]) -> Table:
    time = Column(group.name, OWN_TIME)
    found: dict[Column, list[Any]] = defaultdict(list)
    problem, count, total = "", 0, group.rows
    try:
        for rows in log.parts([*wanted, *([time] if group.own_time else [])], ROWS):
            for column, values in rows.values.items():
                found[column].append(values)
            count += len(next(iter(rows.values.values()), ()))
            if count >= ROWS:
                break
        else:
            total = count if total is None else total
    except DriveIdError as error:
        problem = str(error)
    columns = {
        column.name: np.concatenate(values).astype(np.float64)
        for column, values in found.items()
        if column != time and all(np.asarray(part).dtype.kind in NUMBERS for part in values)
    }
    stamp = np.concatenate(found[time]).astype(np.int64) if time in found else np.zeros(0, np.int64)
    return Table(
        group.name, log.kind, total, columns, dict(group.columns), stamp, "own" if time in found else "", 1, problem
    )


def _of_numbers(log: ColumnLog, columns: list[Column], rows: int) -> list[Column]:
    """Return the columns that hold numbers or times, judged by the first ``rows``; all columns if none does."""

    def readable(wanted: list[Column]) -> bool:
        try:
            next(iter(log.parts(wanted, rows)), None)
        except MessageTypeError:
            return False
        return True

    if readable(columns):
        return columns
    return [column for column in columns if readable([column])] or columns


def _of_topics(bag: Bag, signals: SignalMap) -> Iterator[Table]:
    readers = {name: _TopicReader(topic, signals) for name, topic in bag.topics.items()}
    usable = {name for name, reader in readers.items() if not reader.problem}
    for seen, message in enumerate(bag.messages(frozenset(usable)), 1):
        reader = readers[message.topic]
        if not (reader.full or reader.problem):
            reader.add(bytes(message.data), message.log_time)
            if reader.full:
                usable.discard(message.topic)
        if seen >= _MOST_MESSAGES or not usable:
            break
    for name in sorted(readers):
        yield readers[name].table()


class _TopicReader:
    """Collects all numbers in the messages of a topic."""

    def __init__(self, topic: TopicInfo, signals: SignalMap) -> None:
        self.topic = topic
        self.problem = ""
        self.logged: list[int] = []
        self._stamps: list[int] = []
        self._paths: dict[str, FieldPath] = {}
        self._rows: list[list[Any]] = []  # of messages: numbers, or (n,) of blocks, by path
        self._block = 1
        try:
            self._decode = decoder(topic, signals)
        except DriveIdError as error:
            self.problem = str(error)

    @property
    def full(self) -> bool:
        """Whether no more messages are needed."""
        return len(self.logged) >= MESSAGES or len(self.logged) * self._block >= ROWS

    def add(self, data: bytes, log_time: int) -> None:
        """Add a message; messages with another shape than the first are left out."""
        try:
            decoded = self._decode(data)
        except DECODE_ERRORS as error:
            self.problem = f"A message cannot be decoded ({' '.join(str(error).split())[:120]})."
            return
        if not self._paths:
            self._begin(decoded)
        try:
            row: list[Any] = (
                [float(path.find(decoded)) for path in self._paths.values()]
                if self._block == 1
                else [path.values(decoded) for path in self._paths.values()]
            )
        except (FieldPathError, TypeError, ValueError):
            return
        if self._block > 1:
            sizes = {len(values) for values in row if len(values) > 1}
            if len(sizes) != 1:
                return
            row = [values if len(values) > 1 else np.repeat(values, *sizes) for values in row]
        self._rows.append(row)
        self.logged.append(log_time)
        stamp = getattr(getattr(decoded, "header", None), "stamp", None)
        if stamp is not None:
            self._stamps.append(int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec))

    def _begin(self, decoded: Any) -> None:
        paths = dict(leaves(decoded))
        long = {name: count for name, count in paths.items() if count > _MOST_ELEMENTS}
        size = max(long.values(), default=1)
        for name, count in paths.items():
            if size > 1:
                names = [name] if count in (0, size) else []
            else:
                names = [name] if count == 0 else [f"{name}[{k}]" for k in range(count)]
            for own in names:
                self._paths[own] = parse_field_path(own, "field")
        self._block = size

    def table(self) -> Table:
        """Return what was collected."""
        columns: dict[str, FloatArray] = {}
        if self._rows and self._block == 1:
            columns = dict(zip(self._paths, np.array(self._rows, np.float64).T, strict=True))
        elif self._rows:
            columns = {
                name: np.concatenate(parts)
                for name, parts in zip(self._paths, zip(*self._rows, strict=True), strict=True)
            }
        headed = len(self._stamps) == len(self.logged) and len(set(self._stamps[:50])) > 1
        stamp = np.array(self._stamps if headed else self.logged, np.int64)
        if self._block > 1 and len(stamp) > 1:
            step = (stamp[-1] - stamp[0]) / (len(stamp) - 1) / self._block
            stamp = (stamp[:, None] + np.rint(step * np.arange(self._block)).astype(np.int64)).ravel()
            if any(len(values) != len(stamp) for values in columns.values()):
                columns = {}
        return Table(
            self.topic.name,
            self.topic.type_name,
            self.topic.count if self.topic.count is not None else len(self.logged),
            columns,
            dict.fromkeys(columns, "number"),
            stamp,
            "header" if headed else "log_time",
            self._block,
            self.problem,
        )


def leaves(value: Any, path: str = "", depth: int = 0) -> Iterator[tuple[str, int]]:
    """Yield the paths of all numbers in a decoded message, with the length of arrays; 0 for single numbers."""
    if depth > _DEPTH:
        return
    if dataclasses.is_dataclass(value):
        members = {item.name.rstrip("_"): getattr(value, item.name) for item in dataclasses.fields(value)}
    elif isinstance(value, dict):
        members = value
    else:
        members = {}
    for name, member in members.items():
        own = f"{path}.{name}" if path else str(name)
        if name in ("__msgtype__", "header", "stamp"):
            continue
        if isinstance(member, (bool, int, float, np.number)):
            yield own, 0
        elif isinstance(member, (list, tuple, np.ndarray)) and len(member):
            if isinstance(member[0], (int, float, np.number)):
                yield own, len(member)
            elif len(member) <= _MOST_ELEMENTS and not isinstance(member[0], (str, bytes)):
                for k, entry in enumerate(member):
                    yield from leaves(entry, f"{own}[{k}]", depth + 1)
        else:
            yield from leaves(member, own, depth + 1)
