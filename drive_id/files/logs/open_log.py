"""Open a file of columns with the library that reads it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from drive_id.errors import DriveIdError, NotABagError, TruncatedBagError
from drive_id.files.inputs.input_file import reason
from drive_id.files.logs.column_log import ROWS, missing_library
from drive_id.files.logs.log_kind import log_kind
from drive_id.files.storage.container import UnpackBudget

if TYPE_CHECKING:
    from drive_id.files.logs.column_log import Column, ColumnLog, Rows

_NUMBER = 8
"""Bytes."""
_NAMES = {
    "csv": "CSV",
    "parquet": "Parquet",
    "tdms": "TDMS",
    "mdf": "MDF",
    "mat": "MATLAB",
    "mat73": "MATLAB",
    "hdf5": "HDF5",
}


@contextmanager
def open_log(path: Path) -> Iterator[ColumnLog]:
    """Open a file of columns; its content decides how, not its name.

    Raises
    ------
    NotABagError
        When it is none, or the library that reads it is not installed.
    TruncatedBagError
        When it is damaged.
    """
    kind = log_kind(path)
    if not kind:
        raise NotABagError(f"{path} is neither a bag nor a CSV, Parquet, MATLAB, MDF, TDMS or HDF5 file: check it.")
    with _one_sentence(path, kind):
        log = _opened(path, kind)
    try:
        yield _Guarded(log)
    finally:
        log.close()


class _Guarded:
    """A log whose reading raises our errors only."""

    def __init__(self, log: ColumnLog) -> None:
        self._log = log
        self.kind, self.path, self.bounded, self.groups = log.kind, log.path, log.bounded, log.groups

    def parts(self, wanted: Sequence[Column], rows: int = ROWS) -> Iterator[Rows]:
        """Yield the wanted columns part by part; refuse what is too much for the size of the file."""
        with _one_sentence(self.path, self.kind):
            lengths = {group.name: group.rows or 0 for group in self.groups}
            UnpackBudget(self.path.stat().st_size).take(_NUMBER * sum(lengths[column.group] for column in wanted))
            parts = self._log.parts(wanted, rows)
        while True:
            with _one_sentence(self.path, self.kind):
                part = next(parts, None)
            if part is None:
                return
            yield part

    def close(self) -> None:
        """Release the file."""
        self._log.close()


@contextmanager
def _one_sentence(path: Path, kind: str) -> Iterator[None]:
    """Turn what the libraries raise for damaged files into one error."""
    try:
        yield
    except (DriveIdError, MemoryError):
        raise
    except ImportError as error:
        raise missing_library(path, _NAMES[kind], error) from error
    except OSError as error:
        said = reason(error) if error.strerror else " ".join(str(error).split())[:160]
        raise TruncatedBagError(f"{path} cannot be read as a {_NAMES[kind]} file ({said}): check the file.") from error
    except Exception as error:  # the libraries raise anything from damaged files
        said = " ".join(str(error).split())[:160] or type(error).__name__
        raise TruncatedBagError(
            f"{path} cannot be read as a {_NAMES[kind]} file ({said}): it is damaged or of another kind."
        ) from error


def _opened(path: Path, kind: str) -> ColumnLog:
    if kind == "csv":
        from drive_id.files.logs.tables import CsvLog  # noqa: PLC0415  # pandas takes a second to load

        return CsvLog(path)
    if kind == "parquet":
        from drive_id.files.logs.tables import ParquetLog  # noqa: PLC0415  # likewise

        return ParquetLog(path)
    if kind == "mat":
        from drive_id.files.logs.arrays import MatLog  # noqa: PLC0415  # likewise

        return MatLog(path)
    if kind in ("mat73", "hdf5"):
        from drive_id.files.logs.arrays import Hdf5Log  # noqa: PLC0415  # likewise

        return Hdf5Log(path, matlab=kind == "mat73")
    from drive_id.files.logs.channels import MdfLog, TdmsLog  # noqa: PLC0415  # likewise

    return MdfLog(path) if kind == "mdf" else TdmsLog(path)
