"""Tables that pandas and pyarrow read part by part: text, lines of JSON, Parquet and Feather."""

from __future__ import annotations

import json
import re
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from drive_id.errors import MessageTypeError
from drive_id.files.inputs.input_file import open_input
from drive_id.files.logs.column_log import NUMBERS, OWN_TIME, UNIT_NAMES, Column, ColumnGroup, ColumnLog, Rows, typed
from drive_id.files.logs.csv_dialect import INFINITE, csv_dialect
from drive_id.files.logs.log_kind import text_stream
from drive_id.files.storage.container import UnpackBudget

_CLOCK = re.compile(r"\s*\d{1,3}:\d\d(:\d\d)?([.,]\d+)?\s*")
_DATES = ("ISO8601", "%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S",
          "%m/%d/%Y %I:%M:%S.%f %p", "%m/%d/%Y %I:%M:%S %p")  # fmt: skip
_EXACT: dict[str, Any] = {"float_precision": "round_trip"} if int(pd.__version__.split(".")[0]) < 3 else {}
"""Pandas 3 reads every digit without being asked."""
_FORTRAN = re.compile(r"^(\s*[-+]?[\d.]+)[dD]([-+]?\d+)")
"""A number whose exponent is written with D."""
_FIRST_LINES = 1000
"""Lines of JSON that tell the names."""
_LONGEST_LIST = 16  # numbers of a list in a line of JSON that are columns of their own
_FILETIME_1970 = 116_444_736_000_000_000
"""100 ns from 1601 to 1970."""


class FrameLog(ColumnLog):
    """A table that a library hands over as frames of pandas."""

    _decimal = "."

    def _parts(self, wanted: Sequence[Column], rows: int) -> Iterator[Rows]:
        names = list(dict.fromkeys(column.name for column in wanted if column.name != OWN_TIME))
        for frame, share in self._frames(names, rows):
            values = {
                column: _numbers(frame[column.name], column.name, self.path, self._decimal)
                for column in wanted
                if column.name != OWN_TIME
            }
            yield Rows(values, share)

    @abstractmethod
    def _frames(self, names: list[str], rows: int) -> Iterator[tuple[Any, float]]:
        """Yield some rows of these columns at a time, and the share of the file that has been read."""


class CsvLog(FrameLog):
    """A text file with one row per sample and the names of the columns above, plain or packed."""

    kind = "csv"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._dialect = dialect = csv_dialect(path)
        self._decimal = dialect.decimal
        types = [f"number [{unit}]" if unit else "number" for unit in dialect.units or [""] * len(dialect.names)]
        every = [k for k in range(len(dialect.names)) if k not in dialect.blank]
        self.groups = tuple(
            ColumnGroup(name, {dialect.names[k]: types[k] for k in columns}, None, dialect.period is not None)
            for name, columns in dialect.groups or (("", every),)
        )

    def _parts(self, wanted: Sequence[Column], rows: int) -> Iterator[Rows]:
        """Yield the wanted columns; the time of a file that declares only its period is that of the row's number."""
        own, period = [column for column in wanted if column.name == OWN_TIME], self._dialect.period
        if not own or not period:
            yield from super()._parts(wanted, rows)
            return
        read = 0
        others = [column for column in wanted if column.name != OWN_TIME]
        first = Column(self.groups[0].name, next(iter(self.groups[0].columns)))
        for part in super()._parts(others or [first], rows):
            count = len(next(iter(part.values.values())))
            stamp = np.rint(np.arange(read, read + count) * (period * 1e9)).astype(np.int64)
            read += count
            yield Rows({**part.values, **dict.fromkeys(own, stamp)}, part.progress)

    def _frames(self, names: list[str], rows: int) -> Iterator[tuple[Any, float]]:
        dialect, size = self._dialect, max(self.path.stat().st_size, 1)
        numbers = {dialect.names.index(name): name for name in names}
        budget = UnpackBudget(size)
        with text_stream(self.path) as (stream, file):
            chunks = pd.read_csv(
                stream,
                sep=dialect.delimiter,
                decimal=dialect.decimal,
                header=None,
                names=list(range(len(dialect.names))),
                skiprows=[*range(dialect.header + 1), *dialect.skipped],
                usecols=sorted(numbers),
                chunksize=rows,
                skipinitialspace=True,
                encoding=dialect.encoding,
                encoding_errors="replace",
                index_col=False,
                na_values=list(INFINITE),
                **_EXACT,
            )
            before = 0
            for chunk in chunks:
                budget.take(stream.tell() - before)
                before = stream.tell()
                for k in set(dialect.ticks) & set(numbers):
                    chunk[k] = (pd.to_numeric(chunk[k], errors="coerce") - _FILETIME_1970) * 100
                yield chunk.rename(columns=numbers), min(file.tell() / size, 1.0)


class JsonLog(FrameLog):
    """A text file with one JSON object per line; inner fields are ``header.stamp.sec``, numbers of lists ``i[0]``."""

    kind = "jsonl"

    def __init__(self, path: Path) -> None:
        self.path = path
        first = next(self._records(_FIRST_LINES), (pd.DataFrame(), 0.0))[0]
        self.groups = (ColumnGroup("", dict.fromkeys(first.columns, "number"), None),)

    def _frames(self, names: list[str], rows: int) -> Iterator[tuple[Any, float]]:
        for frame, share in self._records(rows):
            yield frame.reindex(columns=names), share

    def _records(self, rows: int) -> Iterator[tuple[Any, float]]:
        size = max(self.path.stat().st_size, 1)
        budget = UnpackBudget(size)
        with text_stream(self.path) as (stream, file):
            while lines := list(islice(stream, rows)):
                budget.take(sum(map(len, lines)))
                try:
                    entries = [json.loads(line.decode("utf-8-sig")) for line in lines if line.strip()]
                except ValueError as error:
                    raise MessageTypeError(
                        f"{self.path} has no JSON object in each line ({error}): write one a line, or a CSV file."
                    ) from error
                yield (
                    _flat(pd.json_normalize([entry for entry in entries if isinstance(entry, dict)])),
                    min(file.tell() / size, 1.0),
                )


class ArrowLog(FrameLog):
    """A Parquet or Feather file; numbers in structs are ``i.a``, and those of short lists ``i[0]``."""

    def __init__(self, path: Path, kind: str) -> None:
        self.path = path
        self.kind = kind
        with ExitStack() as stack:
            stream = stack.enter_context(open_input(path))
            if kind == "parquet":
                from pyarrow.parquet import ParquetFile  # noqa: PLC0415  # text needs only pandas

                self._arrow: Any = ParquetFile(stream)
                schema, rows = self._arrow.schema_arrow, self._arrow.metadata.num_rows
            else:
                from pyarrow import ipc  # noqa: PLC0415  # likewise

                self._arrow, rows = ipc.open_file(stream), None
                schema = self._arrow.schema
            self._within: dict[
                str, tuple[str, Callable[[Any], Any]]
            ] = {}  # the column that holds it, and how it is taken
            columns = {name: kind for field in schema for name, kind in self._columns(field)}
            self._open = stack.pop_all()
        self.groups = (ColumnGroup("", columns, rows),)

    def _columns(self, field: Any) -> Iterator[tuple[str, str]]:
        """Yield names and types of the columns of a field."""
        from pyarrow import types  # noqa: PLC0415  # likewise

        name, kind, units = field.name, field.type, _units(field.metadata or {})
        lists = types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)
        parts = list[tuple[str, Any, Callable[[Any], Any]]]()
        if lists and (width := self._width(name)):
            parts = [(f"{name}[{k}]", kind.value_type, partial(_entry, k)) for k in range(width)]
        elif types.is_struct(kind):
            parts = [(f"{name}.{part.name}", part.type, partial(_member, part.name)) for part in kind]
        for own, of_part, taken in parts:
            self._within[own] = name, taken
            yield own, typed(of_part, *units)
        if not parts:
            yield name, typed(kind, *units)

    def _width(self, name: str) -> int:
        """Return the number of entries of the lists of a column, 0 for long ones and those of different lengths."""
        first = next(self._batches([name], _FIRST_LINES), (None, 0.0))[0]
        lengths = {len(entry) for entry in first.column(0).to_pylist() if entry is not None} if first else set()
        return lengths.pop() if len(lengths) == 1 and max(lengths) <= _LONGEST_LIST else 0

    def close(self) -> None:
        """Release the file."""
        self._open.close()

    def _frames(self, names: list[str], rows: int) -> Iterator[tuple[Any, float]]:
        read = list(dict.fromkeys(self._within.get(name, (name, None))[0] for name in names))
        plain = [name for name in names if name not in self._within]
        for batch, share in self._batches(read, rows):
            frame = batch.select(plain).to_pandas(ignore_metadata=True)
            for name in self._within.keys() & names:
                column, taken = self._within[name]
                frame[name] = taken(batch.column(column)).to_pandas()
            yield frame, share

    def _batches(self, names: list[str], rows: int) -> Iterator[tuple[Any, float]]:
        """Yield some rows of these columns at a time, and the share of the file that has been read."""
        if self.kind == "parquet":
            total, done = max(self._arrow.metadata.num_rows, 1), 0
            for batch in self._arrow.iter_batches(batch_size=rows, columns=names):
                done += batch.num_rows
                yield batch, done / total
            return
        count = self._arrow.num_record_batches
        for k in range(count):
            batch = self._arrow.get_batch(k).select(names)
            for start in range(0, batch.num_rows, rows):
                yield batch.slice(start, rows), (k + 1) / count


def _entry(k: int, lists: Any) -> Any:
    """Return an entry of each list of a column."""
    from pyarrow.compute import list_element  # noqa: PLC0415  # takes 35 ms, which plain columns do without

    return list_element(lists, k)


def _member(name: str, structs: Any) -> Any:
    """Return a member of each struct of a column."""
    from pyarrow.compute import struct_field  # noqa: PLC0415  # likewise

    return struct_field(structs, name)


def _units(metadata: Mapping[bytes, bytes]) -> list[bytes]:
    """Return what the metadata of a field say of its unit."""
    return [metadata[name.encode()] for name in UNIT_NAMES if name.encode() in metadata]


def _flat(frame: Any) -> Any:
    """Return a frame in which the numbers of short lists are columns of their own."""
    for name in list(frame.columns):
        lists = frame[name].map(lambda entry: isinstance(entry, list))
        if not lists.any():
            continue
        width = min(int(frame.loc[lists, name].map(len).max()), _LONGEST_LIST)
        for k in range(width):
            frame[f"{name}[{k}]"] = frame[name].map(
                lambda entry, k=k: entry[k] if isinstance(entry, list) and len(entry) > k else np.nan
            )
        frame = frame.drop(columns=name)
    return frame


def _numbers(found: Any, name: str, path: Path, decimal: str) -> NDArray[Any]:
    """Return dates as ns, and numbers also from texts; raises MessageTypeError when they are neither."""
    if found.dtype.kind in NUMBERS:
        return np.asarray(found)
    if found.dtype.kind == "M":
        return np.asarray(pd.to_datetime(found, utc=True).astype("datetime64[ns, UTC]").astype(np.int64))
    found = found.mask(found.astype(str).str.strip() == name)  # its name again, above the next capture
    pointed = found if decimal == "." else found.astype(str).str.replace(decimal, ".")
    numbers = pd.to_numeric(pointed, errors="coerce")
    if numbers.isna().any():
        numbers = pd.to_numeric(pointed.replace(_FORTRAN, r"\1E\2", regex=True), errors="coerce")
    if numbers.notna().mean() > 0.5:
        return np.asarray(numbers, np.float64)
    texts = found.dropna().astype(str).str.strip()
    if texts.map(lambda text: _CLOCK.fullmatch(text) is not None).all():
        spans = pd.to_timedelta(
            texts.str.replace(",", ".").map(lambda text: text if text.count(":") > 1 else f"0:{text}")
        )
        return _whole(spans.astype("timedelta64[ns]").astype(np.int64), found)
    for form in _DATES:
        dates = pd.to_datetime(texts.str.replace(",", "."), errors="coerce", utc=True, format=form)
        if dates.notna().all():
            return _whole(dates.dt.tz_localize(None).astype("datetime64[ns]").astype(np.int64), found)
    example = next(iter(texts), "")
    raise MessageTypeError(f"Column '{name}' of {path} holds no numbers, such as '{example:.40}': name another.")


def _whole(times: Any, found: Any) -> NDArray[Any]:
    """Return times (n,) of a column, NaN where it is blank."""
    return np.asarray(times if len(times) == len(found) else times.reindex(found.index).astype(np.float64))
