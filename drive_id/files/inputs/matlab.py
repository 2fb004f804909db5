"""Files of MATLAB's versions 5 to 7, read only after what they unpack to was found to be affordable."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Mapping, Sequence
from multiprocessing.spawn import get_executable
from pathlib import Path
from typing import Any

from drive_id.errors import ConfigurationError
from drive_id.files.inputs.archive import unpacked_limit
from drive_id.files.inputs.input_file import read_input, shown_size

_HEADER = 128  # bytes
_TAG = 8  # bytes before each element
_MATRIX = 14  # miMATRIX
_COMPRESSED = 15  # miCOMPRESSED
_LARGEST = 1 << 27  # bytes
_MOST_MATRICES = 50_000  # scipy makes an object of each
_DEEPEST = 20  # structs within structs
_LONGEST_TRIAL = 120.0  # s; files of the largest size take 0.6 to 0.8 s of processor time
_TRIAL = "import sys; from scipy.io import loadmat; loadmat(sys.argv[1])"


def load_matlab(path: Path, shown: str, names: Sequence[str] | None = None) -> Mapping[str, Any]:
    """Return the variables of a file of a map, all of them or those with these names.

    Raises ConfigurationError when it cannot be read, with a sentence that begins with ``shown``.
    """
    try:
        return read_matlab(path, names)
    except NotImplementedError as error:
        raise ConfigurationError(f"{shown} has MATLAB's version 7.3: save it with '-v7'.") from error
    except MemoryError:
        raise
    except Exception as error:  # scipy raises many types on damaged files
        raise ConfigurationError(f"{shown} is damaged or not a MATLAB file: export it again.") from error


def read_matlab(path: Path, names: Sequence[str] | None = None, limit: int | None = None) -> Mapping[str, Any]:
    """Return the variables of a file of MATLAB's version 5 to 7, all of them or those with these names.

    scipy's reader dies of some damaged files (SIGSEGV), so another process reads the file first, and not for ever.

    Raises ValueError when it is too large (see :func:`check_unpacked_size`), or nothing that scipy can read; or another
    type that scipy raises.
    """
    from scipy.io import loadmat  # noqa: PLC0415  # takes a quarter of a second, and only these files need it

    check_unpacked_size(path, limit)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [get_executable(), "-c", _TRIAL, str(path.absolute())]
    try:
        tried = subprocess.run(command, env=environment, capture_output=True, check=False, timeout=_LONGEST_TRIAL)
    except subprocess.TimeoutExpired:
        raise ValueError("it is damaged: scipy's reader comes to no end") from None
    if tried.returncode < 0:
        raise ValueError("it is damaged: scipy's reader dies of it")
    content: Mapping[str, Any] = loadmat(path, squeeze_me=True, struct_as_record=False, variable_names=names)
    return content


def check_unpacked_size(path: Path, limit: int | None = None) -> None:
    """Check what a file of MATLAB's version 5 to 7 unpacks to, before scipy takes an object for each of its matrices.

    Raises ValueError when it has more than ``limit`` bytes, packed or not; default: those of a map.
    """
    data = read_input(path, limit or _LARGEST)
    order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER])
    if order is None:
        return  # another version, which holds no struct, or which scipy refuses
    most, at = limit or unpacked_limit(len(data), _LARGEST), _HEADER
    left = most
    while at + _TAG <= len(data):
        kind, count = struct.unpack_from(f"{order}II", data, at)
        body = data[at + _TAG : at + _TAG + count]
        if kind == _COMPRESSED:
            body = zlib.decompressobj().decompress(body, left + 1)
            left -= len(body)
            if left < 0:
                raise ValueError(f"it unpacks to more than {shown_size(most)}, too much for its size")
        _matrices(memoryview(body), order, kind == _MATRIX, 0)
        at += _TAG + count


def _matrices(body: memoryview, order: str, inside: bool, depth: int) -> int:
    """Return the number of matrices in an element, cells and fields of structs included."""
    at, found = 0, int(inside)
    while at + _TAG <= len(body):
        kind, count = struct.unpack_from(f"{order}II", body, at)
        if kind >> 16:  # a small element, in its own tag
            at += _TAG
            continue
        if kind == _MATRIX:
            if depth > _DEEPEST:
                raise ValueError("it is nested too deeply")
            found += _matrices(body[at + _TAG : at + _TAG + count], order, True, depth + 1)
        if found > _MOST_MATRICES:
            raise ValueError("it holds too many matrices")
        at += _TAG + -(-count // 8) * 8
    return found
