"""Tell by its content what a file of columns is, without numpy, for a fast ``drive-id info``."""

from __future__ import annotations

from pathlib import Path

from drive_id.files.storage.container import LZ4_MAGIC, MCAP_MAGIC, ROSBAG1_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC

_BAGS = (MCAP_MAGIC, SQLITE_MAGIC, ROSBAG1_MAGIC, ZSTD_MAGIC, LZ4_MAGIC)
_MAGIC = {
    b"PAR1": "parquet",
    b"TDSm": "tdms",
    b"MDF     ": "mdf",
    b"MATLAB 5.0 MAT-file": "mat",
    b"MATLAB 7.3 MAT-file": "mat73",
    b"\x89HDF\r\n\x1a\n": "hdf5",
}
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
"""Byte order marks of UTF-16 text, as written by MATLAB and Excel."""
_TEXT_ENDINGS = (".csv", ".tsv", ".txt", ".dat", ".asc")


def log_kind(path: Path) -> str:
    """Return the kind of a file of columns, such as ``csv``; empty for anything else, such as a bag."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as stream:
            head = stream.read(32)
    except OSError:
        return ""
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    plain = b"\0" not in head or head.startswith(UTF_16)
    text = path.suffix.lower() in _TEXT_ENDINGS and head and plain and not head.startswith(_BAGS)
    return "csv" if text else ""
