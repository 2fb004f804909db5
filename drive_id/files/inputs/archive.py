"""Arrays of ``.npz`` files, read only after what they declare was found to be affordable, and written.

A zip archive of some kB can declare and unpack gigabytes. So all sizes are added up first, and each array's header is
compared with the size of its member before memory is taken for the array.
"""

from __future__ import annotations

import io
import json
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from drive_id.errors import ConfigurationError, DriveIdError
from drive_id.files.inputs.input_file import open_input, reason, shown_size

DAMAGED = (
    OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, EOFError, RecursionError,
    NotImplementedError, OverflowError, RuntimeError, zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError,
)  # fmt: skip
"""What reading a damaged archive, and what is made of its arrays, may raise."""
_LONGEST_REASON = 120  # characters of what a library says of a damaged file
UNPACKED = 1 << 25
"""Bytes that an archive of any size may unpack to."""
RATIO = 16
"""Further bytes that it may unpack to for each of its own."""
LARGEST = 1 << 30
"""Bytes to which none may unpack."""
_LARGEST_DIRECTORY = 1 << 20  # bytes of the directory of a zip file: some 10 000 arrays
_END = b"PK\5\6"  # of the end record of a zip archive
_END_SIZE = 22  # bytes, without its comment
_PLAIN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def npz_bytes(arrays: Mapping[str, Any], *, compressed: bool = True) -> bytes:
    """Return the content of an ``.npz`` file."""
    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)
    return stream.getvalue()


def damage(error: Exception) -> str:
    """Say in words what one of :data:`DAMAGED`, or an error of ours, tells."""
    if isinstance(error, DriveIdError):
        return str(error)
    if isinstance(error, OSError):
        return f"{Path(str(error.filename)).name}: {reason(error)}" if error.filename else reason(error)
    if isinstance(error, KeyError):
        return f"{error.args[0]} is missing"
    if isinstance(error, json.JSONDecodeError):
        return "it is not JSON"
    if isinstance(error, ValueError):
        return " ".join(str(error).split())[:_LONGEST_REASON]
    other = isinstance(error, (TypeError, AttributeError, IndexError))
    return "a value is of another kind than it should be" if other else "it is cut short or was altered"


def unpacked_limit(size: int, largest: int = LARGEST) -> int:
    """Return to how many bytes an archive of ``size`` bytes may unpack."""
    return min(UNPACKED + RATIO * size, largest)


def load_npz(
    path: Path, shown: str, names: Collection[str] | None = None, *, largest: int = LARGEST
) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file of a map, all of them or those with these names.

    Raises ConfigurationError when it cannot be read, with a sentence that begins with ``shown``.
    """
    try:
        with open_input(path) as stream:
            return read_arrays(stream, names, largest=largest)
    except DAMAGED as error:
        if str(error).startswith("it would unpack"):
            raise ConfigurationError(f"{shown} is too large ({error}): resample its maps.") from error
        raise ConfigurationError(
            f"{shown} is damaged, not an .npz archive, or holds objects instead of numbers: write it again with "
            "numpy.savez."
        ) from error


def read_arrays(
    source: BinaryIO | bytes, names: Collection[str] | None = None, *, largest: int = LARGEST
) -> dict[str, NDArray[Any]]:
    """Read the arrays of an ``.npz`` file that have one of these names, by default all.

    Raises ValueError when it declares more than :func:`unpacked_limit` allows, ``largest`` bytes as 64-bit numbers at
    most, or other arrays than of plain numbers or texts; others of :data:`DAMAGED` when it is no such file.
    """
    stream = io.BytesIO(source) if isinstance(source, bytes) else source
    limit = unpacked_limit(_checked_size(stream), largest)
    with zipfile.ZipFile(stream) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        if len(members) < len(archive.infolist()):
            raise ValueError("it holds two arrays of one name")
        chosen = {name: info for name, info in members.items() if names is None or name in names}
        _afford(sum(info.file_size for info in chosen.values()), limit)
        _afford(sum(_declared(archive, name, info) for name, info in chosen.items()), limit)
        found = {}
        for name, info in chosen.items():
            with archive.open(info) as member:
                found[name] = np.lib.format.read_array(member, allow_pickle=False)
    return found


def _afford(size: int, limit: int) -> None:
    if size > limit:
        raise ValueError(f"it would unpack to {shown_size(size)}")


def _checked_size(stream: BinaryIO) -> int:
    """Return the size of an archive; ValueError when its table of contents is too large to be read."""
    size = stream.seek(0, io.SEEK_END)
    stream.seek(max(0, size - (1 << 16) - _END_SIZE))
    tail = stream.read()
    at = tail.rfind(_END)
    if at < 0 or len(tail) < at + _END_SIZE:
        raise zipfile.BadZipFile("it has no table of contents")
    (directory,) = struct.unpack_from("<I", tail, at + 12)
    if directory > _LARGEST_DIRECTORY:
        raise ValueError("its table of contents is too large")
    stream.seek(0)
    return size


def _declared(archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> int:
    """Return how many bytes an array takes as 64-bit numbers or as text, after a look at its header."""
    if info.compress_type not in _PLAIN:
        raise ValueError(f"'{name[:40]}' is compressed in an unknown way")
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        if version == (1, 0):
            shape, _, kind = np.lib.format.read_array_header_1_0(member)
        elif version == (2, 0):
            shape, _, kind = np.lib.format.read_array_header_2_0(member)
        else:
            raise ValueError(f"'{name[:40]}' is an array of an unknown version")
        count, position = math.prod(shape), member.tell()
    if kind.hasobject or any(length < 0 for length in shape):
        raise ValueError(f"'{name[:40]}' holds objects")
    if position + count * kind.itemsize != info.file_size:
        raise ValueError(f"'{name[:40]}' is not of the size that it declares")
    return count * max(kind.itemsize, 8)
