"""Open a file of columns with the library that reads it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from drive_id.errors import NotABagError
from drive_id.files.logs.arrays import Hdf5Log, MatLog, NpzLog
from drive_id.files.logs.channels import MdfLog, TdmsLog
from drive_id.files.logs.column_log import ColumnLog, one_sentence
from drive_id.files.logs.log_kind import log_kind


@contextmanager
def open_log(path: Path) -> Iterator[ColumnLog]:
    """Open a file of columns; its content decides how, not its name.

    Raises NotABagError when it is none or its library is not installed, and TruncatedBagError when it is damaged.
    """
    kind = log_kind(path)
    if not kind:
        raise NotABagError(
            f"{path} is no bag, text table, Parquet, Feather, NumPy, MATLAB, MDF, TDMS or HDF5 file: export it as CSV."
        )
    with one_sentence(path, kind):
        log = _opened(path, kind)
    with closing(log):
        yield log


def _opened(path: Path, kind: str) -> ColumnLog:
    if kind in ("csv", "jsonl", "parquet", "feather"):
        from drive_id.files.logs.tables import ArrowLog, CsvLog, JsonLog  # noqa: PLC0415  # pandas takes a second to load

        return {"csv": CsvLog, "jsonl": JsonLog}[kind](path) if kind in ("csv", "jsonl") else ArrowLog(path, kind)
    if kind in ("mat73", "hdf5"):
        return Hdf5Log(path, matlab=kind == "mat73")
    kinds: dict[str, Callable[[Path], ColumnLog]] = {"mat": MatLog, "npz": NpzLog, "mdf": MdfLog, "tdms": TdmsLog}
    return kinds[kind](path)
