"""Opens input files: regular files only, and no more of them than the reader asks for.

A FIFO would block for ever, and a device has no end. Both are refused before they are opened, like folders. Every error
is an :class:`OSError` whose ``strerror`` says what is wrong, so that each reader words its own sentence around it.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

_KINDS = (
    (stat.S_ISFIFO, "it is a FIFO"),
    (stat.S_ISSOCK, "it is a socket"),
    (stat.S_ISCHR, "it is a device"),
    (stat.S_ISBLK, "it is a device"),
)
_NEVER_BLOCK = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
_CLOSED = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


class NotAFileError(OSError):
    """The path leads to a FIFO, a socket or a device."""


def check_input(path: Path, most: int | None = None) -> int:
    """Return the size of a regular file, bytes; links are followed.

    Raises OSError when there is none, it is something else than a file, or it is larger than ``most`` bytes.
    """
    return _checked(path.stat(), path, most)


def open_input(path: Path, most: int | None = None, *, buffering: int = -1) -> BinaryIO:
    """Open a regular file for reading; raises OSError, see :func:`check_input`."""
    check_input(path, most)
    descriptor = os.open(path, os.O_RDONLY | _NEVER_BLOCK | _CLOSED)
    try:
        _checked(os.fstat(descriptor), path, most)  # it may have been replaced meanwhile
        return os.fdopen(descriptor, "rb", buffering=buffering)
    except BaseException:
        os.close(descriptor)
        raise


def read_input(path: Path, most: int) -> bytes:
    """Return the content of a regular file of at most ``most`` bytes; see :func:`check_input`."""
    with open_input(path, most) as stream:
        data = stream.read(most + 1)
    if len(data) > most:  # it grew
        raise _too_large(path, len(data), most)
    return data


def read_text_input(path: Path, most: int) -> str:
    """Return a text in UTF-8; ValueError when it is none, otherwise as :func:`read_input`."""
    return read_input(path, most).decode("utf-8")


def read_json_input(path: Path, most: int) -> dict[str, Any]:
    """Return the object in a JSON file of at most ``most`` bytes; empty where it holds none or cannot be read."""
    try:
        tree = json.loads(read_text_input(path, most))
    except (OSError, ValueError, RecursionError):
        return {}
    return tree if isinstance(tree, dict) else {}


def reason(error: OSError) -> str:
    """Return the system's reason in words, without error number and path."""
    return error.strerror or type(error).__name__


def shown_size(size: float) -> str:
    """Write a number of bytes for a sentence: ``3.2 GB``."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            break
        size /= 1000
    return f"{size:.3g} {unit}"


def _checked(state: os.stat_result, path: Path, most: int | None) -> int:
    if not stat.S_ISREG(state.st_mode):
        if stat.S_ISDIR(state.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        kind = next((words for test, words in _KINDS if test(state.st_mode)), "it is something else")
        raise NotAFileError(errno.EINVAL, f"{kind}, not a file", str(path))
    if most is not None and state.st_size > most:
        raise _too_large(path, state.st_size, most)
    return state.st_size


def _too_large(path: Path, size: int, most: int) -> OSError:
    words = f"it is too large, {shown_size(size)} where {shown_size(most)} is the most"
    return OSError(errno.EFBIG, words, str(path))
