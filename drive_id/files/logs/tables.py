"""CSV by pandas, and Parquet by pyarrow: one table, read part by part."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from drive_id.errors import MessageTypeError
from drive_id.files.logs.column_log import NUMBERS, Column, ColumnGroup, ColumnLog, Rows
from drive_id.files.logs.log_kind import UTF_16

WHITE = r"\s+"
_DELIMITERS = ("\t", ";", ",", "|", WHITE)
_CLOCK = re.compile(r"\s*\d{1,3}:\d\d(:\d\d)?([.,]\d+)?\s*")
_DATES = ("ISO8601", "%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S")
_HEAD = 1 << 16  # bytes that tell how a table is written
_EXACT: dict[str, Any] = {"float_precision": "round_trip"} if int(pd.__version__.split(".")[0]) < 3 else {}
"""Pandas 3 reads every digit without being asked."""
_LAST = 50
"""Lines from which the number of columns is determined."""
_NUMBER = re.compile(r"\s*[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?\s*|\s*[-+]?(nan|inf(inity)?)\s*", re.IGNORECASE)


@dataclass(frozen=True)
class CsvDialect:
    """How a text file writes its table."""

    delimiter: str  # WHITE for any white space
    decimal: str
    header: int  # line of the names, from 0
    skipped: tuple[int, ...]  # lines below it that hold no numbers, such as units
    names: tuple[str, ...]
    encoding: str = "utf-8-sig"


class CsvLog(ColumnLog):
    """A text file with one row per sample and the names of the columns above."""

    kind = "csv"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._dialect = csv_dialect(path)
        self.groups = (ColumnGroup("", dict.fromkeys(self._dialect.names, "number"), None),)

    def _parts(self, wanted: Sequence[Column], rows: int) -> Iterator[Rows]:
        dialect, size = self._dialect, max(self.path.stat().st_size, 1)
        numbers = {column: dialect.names.index(column.name) for column in wanted}
        with self.path.open("rb") as stream:
            chunks = pd.read_csv(
                stream,
                sep=dialect.delimiter,
                decimal=dialect.decimal,
                header=None,
                names=list(range(len(dialect.names))),
                skiprows=[*range(dialect.header + 1), *dialect.skipped],
                usecols=sorted(set(numbers.values())),
                chunksize=rows,
                skipinitialspace=True,
                encoding=dialect.encoding,
                encoding_errors="replace",
                index_col=False,
                **_EXACT,
            )
            for chunk in chunks:
                values = {column: _numbers(chunk[k], column.name, self.path) for column, k in numbers.items()}
                yield Rows(values, min(stream.tell() / size, 1.0))


class ParquetLog(ColumnLog):
    """A Parquet file."""

    kind = "parquet"

    def __init__(self, path: Path) -> None:
        from pyarrow.parquet import ParquetFile  # noqa: PLC0415  # text needs only pandas

        self.path = path
        self._file = ParquetFile(path)
        schema = self._file.schema_arrow
        columns = {name: str(kind) for name, kind in zip(schema.names, schema.types, strict=True)}
        self.groups = (ColumnGroup("", columns, self._file.metadata.num_rows),)

    def _parts(self, wanted: Sequence[Column], rows: int) -> Iterator[Rows]:
        total, done = max(self._file.metadata.num_rows, 1), 0
        names = list(dict.fromkeys(column.name for column in wanted))
        for batch in self._file.iter_batches(batch_size=rows, columns=names):
            done += batch.num_rows
            found = {column: batch.column(column.name).to_pandas() for column in wanted}
            yield Rows({column: _numbers(x, column.name, self.path) for column, x in found.items()}, done / total)


def _numbers(found: Any, name: str, path: Path) -> NDArray[Any]:
    """Return dates as ns, and numbers also from texts; raises MessageTypeError when they are neither."""
    if found.dtype.kind in NUMBERS:
        return np.asarray(found)
    if found.dtype.kind == "M":
        return np.asarray(found.astype("datetime64[ns]").astype(np.int64))
    numbers = pd.to_numeric(found, errors="coerce")
    if numbers.notna().mean() > 0.5:
        return np.asarray(numbers, np.float64)
    texts = found.astype(str).str.strip()
    if texts.map(lambda text: _CLOCK.fullmatch(text) is not None).all():
        spans = pd.to_timedelta(
            texts.str.replace(",", ".").map(lambda text: text if text.count(":") > 1 else f"0:{text}")
        )
        return np.asarray(spans.astype("timedelta64[ns]").astype(np.int64))
    for form in _DATES:
        dates = pd.to_datetime(texts.str.replace(",", "."), errors="coerce", utc=True, format=form)
        if dates.notna().all():
            return np.asarray(dates.dt.tz_localize(None).astype("datetime64[ns]").astype(np.int64))
    raise MessageTypeError(
        f"Column '{name}' of {path} holds no numbers, such as '{found.iloc[0]!s:.40}': name another."
    )


def csv_dialect(path: Path) -> CsvDialect:
    """Tell delimiter, decimal sign and header from the first lines.

    Raises MessageTypeError when there is no table with names above.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    encoding = "utf-16" if head.startswith(UTF_16) else "utf-8-sig"
    text = head.decode(encoding, errors="replace")
    lines = text.splitlines()[:200]
    lines = lines[:-1] if len(head) >= _HEAD and len(lines) < 200 else lines
    for delimiter in _DELIMITERS:
        found = _table([_cells(line, delimiter) for line in lines], delimiter)
        if found is not None:
            return replace(found, encoding=encoding)
    names, first = (len(_cells(line, ",")) for line in (*lines, "", "")[:2])
    if first > names > 1:
        raise MessageTypeError(
            f"{path} has {first} cells below {names} names, as if commas separated columns and were decimal signs as "
            "well: write decimal points, or separate columns by semicolons."
        )
    raise MessageTypeError(
        f"{path} is not a table of numbers below a line with the names of its columns: add such a line."
    )


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == WHITE:
        return line.split()
    return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])


def _table(rows: list[list[str]], delimiter: str) -> CsvDialect | None:
    """Return the dialect if these rows, divided by the delimiter, end in numbers below a row of names."""
    widths = [len(row) for row in rows if any(cell.strip() for cell in row)]
    if not widths or max(widths) < 2:
        return None
    usual = Counter(widths[-_LAST:]).most_common(1)[0][0]  # settings above the table may look like rows, too
    numeric = [_is_numeric(row) and len(row) == max(usual, 2) for row in rows]
    first = next((k for k, good in enumerate(numeric) if good and all(numeric[k : k + 3])), None)
    if first is None or not first:
        return None
    width = len(rows[first])
    above = [k for k in range(first) if len(rows[k]) == width and all(cell.strip() for cell in rows[k][1:-1])]
    if not above:
        return None
    header = above[0] if len(above) > 1 and first - above[0] <= len(above) else above[-1]
    names = [cell.strip() or f"column {k + 1}" for k, cell in enumerate(rows[header])]
    names[0] = names[0].lstrip("#% ")
    unique = tuple(name if name not in names[:k] else f"{name} ({k + 1})" for k, name in enumerate(names))
    comma = delimiter != "," and any("," in cell for row in rows[first : first + 20] for cell in row)
    return CsvDialect(delimiter, "," if comma else ".", header, tuple(range(header + 1, first)), unique)


def _is_numeric(row: list[str]) -> bool:
    """Tell whether a row holds numbers, perhaps beside a date and empty cells."""
    cells = [cell for cell in row if cell.strip()]
    numbers = sum(bool(_NUMBER.fullmatch(cell)) for cell in cells)
    return numbers >= max(len(cells) - 1, 1)
