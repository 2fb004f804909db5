"""How a text file writes its table: separator, decimal sign, names, and what stands above and below them."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from drive_id.common.quantity import counted
from drive_id.errors import MessageTypeError
from drive_id.files.logs.column_log import unit_of
from drive_id.files.logs.log_kind import UTF_16, text_stream

WHITE = r"\s+"
INFINITE = ("∞", "-∞", "+∞")
"""What scopes write for values beyond their range."""
_DELIMITERS = ("\t", ";", ",", "|", WHITE)
_HEAD = 1 << 16  # bytes that tell how a table is written
_LAST = 50
"""Lines from which the number of columns is determined."""
_NUMBER = re.compile(r"\s*[-+]?(\d+[.,]?\d*|[.,]\d+)([eEdD][-+]?\d+)?\s*|\s*[-+]?(nan|inf(inity)?|∞)\s*", re.IGNORECASE)
_DATE = re.compile(r"\s*(\d{1,4}[-./]\d{1,2}[-./]\d{2,4}|\d{1,3}:\d\d).*")
_MOSTLY = 0.9  # share of rows with a number, from which on a column holds numbers
_TWINCAT = "Name"
"""First cell of the names in exports of TwinCAT Scope, which stands above each column of times, too."""
_TICKS = 1e16  # from which on its times are 100 ns since 1601, not ms
_UNITS = "unit"
"""Word in the first cell of a line of units above the names, as LabVIEW and oscilloscopes write them."""
_COMMENTS = (["#"], ["%"])
"""First cell of a line of names that is a comment, as numpy.savetxt writes it."""
_STEP, _LABVIEW = "Delta_X", "X_Value"
"""First cell of the lines of sample periods, s, and of names in LabVIEW measurement files."""


@dataclass(frozen=True)
class CsvDialect:
    """How a text file writes its table."""

    delimiter: str  # WHITE for any white space
    decimal: str
    header: int  # line of the names, from 0
    skipped: tuple[int, ...]  # lines below it that hold no numbers, such as units
    names: tuple[str, ...]
    encoding: str = "utf-8-sig"
    groups: tuple[tuple[str, tuple[int, ...]], ...] = ()  # names of several groups of columns with times of their own
    blank: tuple[int, ...] = ()  # columns without a name and without values
    period: float | None = None  # s, where the file declares it and holds no time
    units: tuple[str, ...] = ()  # of the columns, where a line below the names gives them; empty for unknown ones
    ticks: tuple[int, ...] = ()  # columns of times in 100 ns since 1601


def csv_dialect(path: Path) -> CsvDialect:
    """Tell delimiter, decimal sign and header from the first lines.

    Raises MessageTypeError when there is no table with names above.
    """
    with text_stream(path) as (stream, _):
        head = stream.read(_HEAD)
    encoding = _encoding(head)
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
            f"{path} has {counted(first, 'cell')} below {names} names, as if commas separated columns and were decimal "
            "signs as well: write decimal points, or separate columns by semicolons."
        )
    raise MessageTypeError(
        f"{path} is not a table of numbers below a line with the names of its columns: add such a line, and give each "
        "signal a column of its own."
    )


def _encoding(head: bytes) -> str:
    if head.startswith(UTF_16):
        return "utf-16"
    try:
        head[: head.rfind(b"\n") + 1].decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == WHITE:
        return line.split()
    return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])


def _table(rows: list[list[str]], delimiter: str) -> CsvDialect | None:
    """Return the dialect if these rows, divided by the delimiter, end in numbers below a row of names."""
    filled = [k for k, row in enumerate(rows) if any(cell.strip() for cell in row)]
    widths = [len(rows[k]) for k in filled]
    if not widths or max(widths) < 2:
        return None
    usual = Counter(widths[-_LAST:]).most_common(1)[0][0]  # settings above the table may look like rows, too
    numeric = _numeric_rows(rows, max(usual, 2))
    first = next((k for k in filled if numeric[k] and all(numeric[n] for n in filled if k <= n < k + 3)), None)
    if first is None or not first:
        return None
    width = len(rows[first])
    rows = [row[1:] if row[:1] in _COMMENTS and len(row) == width + 1 else row for row in rows]
    rows = [row[:width] if row[:1] == [_LABVIEW] else row for row in rows]  # whose comments need not have a cell
    above = [k for k in filled if k < first and len(rows[k]) == width and all(cell.strip() for cell in rows[k][1:-1])]
    while len(above) > 1 and all(unit_of(cell) for cell in rows[above[0]][1:]):
        above = above[1:]  # units above the names
    if not above:
        return None
    between = sum(above[0] <= k < first for k in filled)
    header = above[0] if len(above) > 1 and between <= len(above) else above[-1]
    named = [k for k in above if rows[k][0].strip() == _TWINCAT and width > 2]
    header = named[-1] if named else header
    comma = delimiter != "," and any("," in cell for row in rows[first : first + 20] for cell in row)
    found = CsvDialect(delimiter, "," if comma else ".", header, tuple(range(header + 1, first)), ())
    body = [rows[k] for k in filled if k >= first and len(rows[k]) == width]
    if named:
        return _of_twincat(found, rows[header], body)
    blank = [k for k in range(width) if not any(row[k].strip() for row in body)]
    step = next((row for row in rows[:header] if row and row[0].strip() == _STEP), ())
    period = _float(next(iter(step[1:]), "")) if 0 in blank else None
    unnamed = tuple(k for k in blank if not rows[header][k].strip() or (k == 0 and period))
    below = [rows[header + 1]] if header + 1 < first else []
    stated = [["", *row[1:]] for row in rows[:header] if _UNITS in "".join(row[:1]).lower() and all(row[1:width])]
    units = next(([unit_of(cell) for cell in row] for row in (*below, *stated) if len(row) == width), [""] * width)
    dated = [sum(bool(_NUMBER.fullmatch(row[k])) for row in body) * 2 < sum(bool(row[k].strip()) for row in body)
             for k in range(width)]  # fmt: skip
    units = ["ns" if date else unit for unit, date in zip(units, dated, strict=True)]  # as which dates are read
    return replace(found, names=_unique(rows[header]), blank=unnamed, period=period, units=tuple(units))


def _unique(cells: Sequence[str]) -> tuple[str, ...]:
    names = [cell.strip() or f"column {k + 1}" for k, cell in enumerate(cells)]
    names[0] = names[0].lstrip("#% ")
    return tuple(name if name not in names[:k] else f"{name} ({k + 1})" for k, name in enumerate(names))


def _of_twincat(found: CsvDialect, header: Sequence[str], body: Sequence[Sequence[str]]) -> CsvDialect:
    """Return the dialect of an export of TwinCAT Scope: columns of times, each for those behind it.

    Columns whose times are equal share a group.
    """
    times = [k for k, cell in enumerate(header) if cell.strip() == _TWINCAT]
    ticks = tuple(k for k in times if any((_float(row[k]) or 0.0) > _TICKS for row in body[:1]))
    names = _unique([("Time [ns]" if k in ticks else "Time [ms]") if k in times else x for k, x in enumerate(header)])
    groups: dict[tuple[str, ...], list[int]] = {}
    for start, end in zip(times, [*times[1:], len(header)], strict=True):
        groups.setdefault(tuple(row[start] for row in body), []).extend(range(start, end))
    several = tuple((f"group {k + 1}", tuple(columns)) for k, columns in enumerate(groups.values()))
    return replace(found, names=names, groups=several if len(several) > 1 else (), ticks=ticks)


def _float(cell: str) -> float | None:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return None


def _numeric_rows(rows: list[list[str]], width: int) -> list[bool]:
    """Tell which rows hold numbers, and those in the columns where nearly all of the last ones do."""
    like = [len(row) == width and _is_numeric(row) for row in rows]
    last = [row for row, good in zip(rows, like, strict=True) if good][-_LAST:]
    numbers = [
        k for k in range(width) if sum(bool(_NUMBER.fullmatch(row[k])) for row in last) >= max(_MOSTLY * len(last), 1)
    ]
    return [
        good and all(not row[k].strip() or _NUMBER.fullmatch(row[k]) for k in numbers)
        for row, good in zip(rows, like, strict=True)
    ]


def _is_numeric(row: list[str]) -> bool:
    """Tell whether a row holds numbers, perhaps beside dates, one other text and empty cells."""
    cells = [cell for cell in row if cell.strip() and not _DATE.fullmatch(cell)]
    numbers = sum(bool(_NUMBER.fullmatch(cell)) for cell in cells)
    return numbers >= max(len(cells) - 1, 1)
