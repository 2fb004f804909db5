"""Tell by its content what a file of columns is, without numpy, for a fast ``drive-id info``."""

from __future__ import annotations

import gzip
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NoReturn, cast

from drive_id.errors import NotABagError
from drive_id.files.inputs.input_file import open_input
from drive_id.files.storage.container import LZ4_MAGIC, MCAP_MAGIC, ROSBAG1_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC

_BAGS = (MCAP_MAGIC, SQLITE_MAGIC, ROSBAG1_MAGIC, ZSTD_MAGIC, LZ4_MAGIC)
_BAG_ENDINGS = (".mcap", ".db3", ".bag")
_MAGIC = {
    b"PAR1": "parquet",
    b"ARROW1": "feather",
    b"TDSm": "tdms",
    b"MDF     ": "mdf",
    b"UnFinMF ": "mdf",
    b"MATLAB 5.0 MAT-file": "mat",
    b"MATLAB 7.3 MAT-file": "mat73",
    b"\x89HDF\r\n\x1a\n": "hdf5",
}
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
"""Byte order marks of UTF-16 text, as written by MATLAB and Excel."""
_GZIP, _ZIP = b"\x1f\x8b", b"PK\3\4"
_CSV = "export it from its tool as CSV"
_FOREIGN = {
    b"\xd0\xcf\x11\xe0": ("an Excel or another OLE file", "save it as CSV"),
    b"\x80\x04": ("a Python pickle, which may run any code when it is read", "save it with to_parquet or to_csv"),
    b"\x80\x05": ("a Python pickle, which may run any code when it is read", "save it with to_parquet or to_csv"),
    b"\x93NUMPY": ("a single array", "save the columns by name with numpy.savez"),
    b"FEA1": ("a Feather file of version 1", "save it with to_feather of a current pandas"),
    b"BZh": ("a file packed by bzip2", "unpack it"),
    b"\xfd7zXZ": ("a file packed by xz", "unpack it"),
    b"7z\xbc\xaf": ("a 7-Zip archive", "unpack it"),
    b"Rar!": ("a RAR archive", "unpack it"),
    b"AG10": ("a file of a Keysight oscilloscope", _CSV),
    b":WFM#": ("a file of a Tektronix oscilloscope", _CSV),
    b"WFM": ("a file of an oscilloscope", _CSV),
    b"#9": ("a file of a LeCroy oscilloscope", _CSV),
    b"WAVEDESC": ("a file of a LeCroy oscilloscope", _CSV),
    b"Pico": ("a file of PicoScope", _CSV),
    b"SCPSVT": ("a file of TwinCAT Scope", _CSV),
}
"""Files that are not read, by their first bytes: what they are, and the way out."""
_HEAD = 4096
_MOST_CONTROLS = 0.05
"""Share of control characters up to which bytes are a text."""
_CONTROLS = bytes(set(range(32)) - set(b"\t\n\r\f"))


def log_kind(path: Path) -> str:
    """Return the kind of a file of columns, such as ``csv``; empty for anything else, such as a bag.

    The file may be packed: text by gzip or zip. Raises NotABagError for a file that is known and not read, with the
    way out.
    """
    try:
        if not path.is_file():
            return ""
        with open_input(path) as stream:
            head = stream.read(_HEAD)
    except OSError:
        return ""
    if not head or head.startswith(_BAGS):
        return ""
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    for magic, (what, remedy) in _FOREIGN.items():
        if head.startswith(magic):
            _refuse(path, f"is {what}", remedy)
    if head.startswith((_ZIP, _GZIP)):
        return _zip_kind(path) if head.startswith(_ZIP) else _packed_kind(path)
    return "" if path.suffix in _BAG_ENDINGS else _text_kind(head)


def _text_kind(head: bytes) -> str:
    """Return ``csv`` or ``jsonl`` for the beginning of a text, and an empty one for anything else."""
    if head.startswith(UTF_16):
        return "csv"
    controls = len(head) - len(head.translate(None, _CONTROLS))
    if not head or b"\0" in head or controls > _MOST_CONTROLS * len(head):
        return ""
    return "jsonl" if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{") else "csv"


def _zip_kind(path: Path) -> str:
    try:
        with open_input(path) as stream, zipfile.ZipFile(stream) as archive:
            names = [info.filename for info in archive.infolist() if not info.is_dir()]
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise NotABagError(f"{path} is a damaged zip archive: copy it again from its origin.") from error
    if "[Content_Types].xml" in names:
        _refuse(path, "is an Excel workbook", "save its sheet as CSV")
    if names and all(name.endswith(".npy") for name in names):
        return "npz"
    if len(names) != 1:
        _refuse(path, f"holds {len(names)} files", "unpack it, and give the one that holds the samples")
    return _packed_kind(path)


def _packed_kind(path: Path) -> str:
    try:
        with text_stream(path) as (stream, _):
            kind = _text_kind(stream.read(_HEAD))
    except (OSError, EOFError, ValueError, RuntimeError, NotImplementedError, zlib.error, zipfile.BadZipFile) as error:
        raise NotABagError(f"{path} cannot be unpacked: copy it again from its origin.") from error
    if not kind:
        _refuse(path, "is packed and holds no text", "unpack it, and give what it holds")
    return kind


def _refuse(path: Path, what: str, remedy: str) -> NoReturn:
    raise NotABagError(f"{path} {what}, which is not read: {remedy}.")


@contextmanager
def text_stream(path: Path) -> Iterator[tuple[IO[bytes], IO[bytes]]]:
    """Open a text, plain or packed by gzip or zip: what it holds, and the file itself, which tells the progress."""
    with open_input(path) as file:
        magic = file.read(4)
        file.seek(0)
        if magic.startswith(_GZIP):
            with gzip.GzipFile(fileobj=file) as text:
                yield cast(IO[bytes], text), file
        elif magic.startswith(_ZIP):
            with zipfile.ZipFile(file) as archive:
                member = next(info for info in archive.infolist() if not info.is_dir())
                with archive.open(member) as text:
                    yield text, file
        else:
            yield file, file
