"""What logs of columns share: their base class, its errors, and how a column is found by its name."""

from __future__ import annotations

import difflib
import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drive_id.common.messages import Message
from drive_id.errors import DriveIdError, MissingTopicError, NotABagError, TruncatedBagError
from drive_id.files.inputs.input_file import reason
from drive_id.files.storage.container import UnpackBudget

ROWS = 1 << 16
"""Rows of a part."""
NUMBERS = "iufb"
"""Kinds of numpy's types that are numbers."""
_NUMBER = 8
"""Bytes."""
_FILLS = np.array(
    [999.0, 999.25, 9999.0, 99999.0, 999999.0, 1e20, 1e30, 1e36, 1e37, 9.969209968386869e36, 3.4028234663852886e38,
     32767.0, 32768.0, 65535.0, 2.0**31 - 1, 2.0**31, 2.0**32 - 1],
)  # fmt: skip
"""Sizes of numbers that tools write where they have none: of loggers, of netCDF, and the ends of number types."""
_SINGLE, _FAR, _MOST_FILLS = 1e-6, 3.0, 3
"""Relative rounding of single precision, the least ratio to all other values, and most such numbers in one column."""
_NAMES = {
    "jsonl": "JSON lines",
    "npz": "NumPy .npz",
    "parquet": "Parquet",
    "feather": "Feather",
    "mat": "MATLAB",
    "mat73": "MATLAB",
}
"""Names of kinds that are not those of the kinds in capitals, such as CSV."""
UNIT = r"([nuµmk]?)(A|V|s|%|rad|deg|°|rev|rpm|min-1|1/min|U/min|rad/s|Hz|N ?m|°?C|°F|K|W)"
"""Units of logs, by prefix and base."""
UNIT_NAMES = ("unit", "units", "Unit", "Units")
"""Names of what holds the unit of a column, beside its data."""
_UNIT_WORDS = {"volt": "V", "volts": "V", "amp": "A", "amps": "A", "ampere": "A", "second": "s", "seconds": "s"}
_MOST_NAMED = 12  # columns or groups in a message: two lines of a terminal
_SECONDS = (
    ("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"), ("seconds", "nanoseconds"), ("s", "ns"),
    ("sec", "usec"), ("secs", "usecs"), ("seconds", "microseconds"),
)  # fmt: skip
"""Ends of the names of seconds and their parts in two columns, as ROS 2, ROS 1, Linux and others write them."""
_MICROSECONDS = ("usec", "usecs", "microseconds")


@dataclass(frozen=True)
class ColumnGroup:
    """Columns of equal length that share their time."""

    name: str  # empty in a container without groups
    columns: dict[str, str]  # name to type, such as float64
    rows: int | None  # None where a file does not tell without being read
    own_time: bool = False  # the container itself knows the time of the rows
    part_of: str = ""  # name of the container's group, where its channels begin at different times


class Column(NamedTuple):
    """A column by group and name; the name ``""`` is the container's own time, ns."""

    group: str
    name: str


OWN_TIME = ""
"""Name of the container's own time."""


class Rows(NamedTuple):
    """Some consecutive rows of some columns, and the share of the file that has been read by now."""

    values: dict[Column, NDArray[Any]]
    progress: float


class ColumnLog(ABC):
    """One file of columns, open for reading; a library may raise anything from a damaged one."""

    kind: str
    """Such as ``csv`` or ``mdf``."""
    path: Path
    _file: Any = None
    """Of the library, to be closed."""
    groups: tuple[ColumnGroup, ...]
    bounded = True
    """Whether the file is read part by part; otherwise it is held in memory as a whole."""
    checked = False
    """Whether checksums cover the samples."""
    facts: Mapping[str, float] = MappingProxyType({})
    """Single numbers beside the columns, by name, such as ``fs``."""
    warnings: tuple[Message, ...] = ()
    """As of a bag, which has several files, too."""

    def parts(self, wanted: Sequence[Column], rows: int = ROWS) -> Iterator[Rows]:
        """Yield the wanted columns, parts of some ``rows``; groups of different length advance together in time.

        Refuses what is too much for the size of the file, and raises TruncatedBagError when it is damaged.
        """
        with one_sentence(self.path, self.kind):
            lengths = {group.name: group.rows or 0 for group in self.groups}
            UnpackBudget(self.path.stat().st_size).take(_NUMBER * sum(lengths[column.group] for column in wanted))
            for part in self._parts(wanted, rows):
                values = {
                    column: x if column.name == OWN_TIME else without_fills(x) for column, x in part.values.items()
                }
                yield part._replace(values=values)

    @abstractmethod
    def _parts(self, wanted: Sequence[Column], rows: int) -> Iterator[Rows]:
        """Yield the wanted columns."""

    def close(self) -> None:
        """Release the file."""
        if self._file is not None:
            self._file.close()


def without_fills(values: NDArray[Any]) -> NDArray[Any]:
    """Return values (N,) in which a number that tools write where they have none, such as -9999, is NaN.

    It is a known one, and far beyond all others.
    """
    if values.dtype.kind not in "iuf":
        return values
    for _ in range(_MOST_FILLS):
        size = np.abs(values, dtype=np.float64)
        finite = np.isfinite(size)
        largest = np.max(size, initial=0.0, where=finite)
        if not np.isclose(largest, _FILLS, rtol=_SINGLE, atol=0.0).any():
            break
        of_fill = size == largest
        rest = np.max(size, initial=0.0, where=finite & ~of_fill)
        if _FAR * rest > largest or 2 * np.count_nonzero(of_fill) > len(values):
            break
        values = np.where(of_fill, np.nan, values)
    return values


class SlicedLog(ColumnLog):
    """A log whose library reads any rows of a column."""

    def _parts(self, wanted: Sequence[Column], rows: int) -> Iterator[Rows]:
        """Yield the wanted columns part by part: all groups advance by the same share of their length."""
        lengths = {group.name: group.rows or 0 for group in self.groups if group.name in {c.group for c in wanted}}
        count = max(-(-max(lengths.values(), default=0) // rows), 1)
        for part in range(count):
            at = {name: slice(n * part // count, n * (part + 1) // count) for name, n in lengths.items()}
            yield Rows({column: self._slice(column, at[column.group]) for column in wanted}, (part + 1) / count)

    @abstractmethod
    def _slice(self, column: Column, at: slice) -> NDArray[Any]:
        """Return some rows of a column."""


@contextmanager
def one_sentence(path: Path, kind: str) -> Iterator[None]:
    """Turn what the libraries raise for damaged files into one error."""
    name = _NAMES.get(kind, kind.upper())
    try:
        yield
    except (DriveIdError, MemoryError):
        raise
    except ImportError as error:
        raise NotABagError(
            f"{path} is a {name} file, and {error.name} is not installed, which reads it: run pip install "
            "'drive_id[containers]'."
        ) from error
    except OSError as error:
        said = reason(error) if error.strerror else " ".join(str(error).split())[:160]
        raise TruncatedBagError(f"{path} cannot be read as a {name} file ({said}): check the file.") from error
    except Exception as error:  # the libraries raise anything from damaged files
        said = " ".join(str(error).split())[:160] or type(error).__name__
        raise TruncatedBagError(
            f"{path} cannot be read as a {name} file ({said}): it is damaged or of another kind."
        ) from error


def find_column(log: ColumnLog, name: str, group: str, wanted_for: str) -> Column:
    """Find a column by its name, in a group or in the only group that has it.

    Raises MissingTopicError when there is none, or several groups have one.
    """
    if not log.groups:
        raise MissingTopicError(f"{log.path} holds no column of numbers: give a log that does.")
    near = [entry for entry in log.groups if not group or any(same_name(x, group) for x in (entry.name, entry.part_of))]
    if not near and any(same_name(known, f"{group}.{name}") for entry in log.groups for known in entry.columns):
        near, name = list(log.groups), f"{group}.{name}"  # the group is a struct
    if not near:
        names = ", ".join(entry.name or "(none)" for entry in log.groups[:_MOST_NAMED])
        raise MissingTopicError(f"{log.path} has no group '{group}' for the {wanted_for}: its groups are {names}.")
    if name == OWN_TIME:
        return Column(near[0].name, OWN_TIME)
    found = [Column(entry.name, known) for entry in near for known in entry.columns if same_name(known, name)]
    exact = [column for column in found if column.name == name]
    found = exact or found
    if len({column.group for column in found}) > 1:
        groups = ", ".join(column.group for column in found[:_MOST_NAMED])
        raise MissingTopicError(
            f"Several groups of {log.path} have a column '{name}' ({groups}): name the group in the section for the "
            f"{wanted_for}."
        )
    if found:
        return found[0]
    known_names = list(dict.fromkeys(known for entry in near for known in entry.columns))
    meant = difflib.get_close_matches(name, known_names, 1, 0.5)
    guess = f", did you mean '{meant[0]}'" if meant else ""
    shown = ", ".join(known_names[:_MOST_NAMED]) + (", ..." if len(known_names) > _MOST_NAMED else "")
    raise MissingTopicError(
        f"{log.path} has no column '{name}' for the {wanted_for}{guess} (it has {shown or 'none at all'}): name "
        "another one in the signals file."
    )


def unit_of(said: Any) -> str:
    """Return the unit in what a file says of a column, such as ``(ms)`` or ``Volts``; empty if it is none."""
    text = said.decode("utf-8", "replace") if isinstance(said, bytes) else str(said)
    plain = text.strip().strip("[]()").strip().replace("μ", "µ")
    unit = _UNIT_WORDS.get(plain.lower(), plain)
    return unit if re.fullmatch(UNIT, unit) else ""


def typed(kind: Any, *said: Any) -> str:
    """Return the type of a column with the first unit among what a file says of it: ``float64 [mA]``."""
    unit = next((unit for entry in said if (unit := unit_of(entry))), "")
    return f"{kind} [{unit}]" if unit else str(kind)


def same_name(one: str, other: str) -> bool:
    """Tell whether two names are the same, structs and groups divided by a dot or a slash."""
    return one.strip("/").replace("/", ".") == other.strip("/").replace("/", ".")


def seconds_columns(stamp: str, names: Collection[str]) -> tuple[str, ...]:
    """Return the columns of seconds and of their parts that a time has among ``names``; nothing for one of one column.

    ``stamp`` is the column of the seconds, or what the names of both begin with: ``header.stamp``.
    """
    for end, other in _SECONDS:
        stem, last = stamp[: -len(end)], stamp[-len(end) :]
        if last.lower() == end and not stem[-1:].isalnum() and {stamp, stem + other} <= set(names):
            return stamp, stem + other
        for sign in "._/":
            if {f"{stamp}{sign}{end}", f"{stamp}{sign}{other}"} <= set(names):
                return f"{stamp}{sign}{end}", f"{stamp}{sign}{other}"
    return ()


def part_of_second(name: str) -> float:
    """Return the unit, ns, of the column beside that of the seconds."""
    return 1e3 if name.lower().endswith(_MICROSECONDS) else 1.0
