"""Writes files and folders so that content and names survive a power cut."""

from __future__ import annotations

import ctypes
import errno
import os
from pathlib import Path

_HERE = -100  # AT_FDCWD of Linux
_EXCHANGE = 2  # RENAME_EXCHANGE of Linux
_CANNOT = frozenset({errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES, errno.EPERM})
"""Errors of file systems and platforms that cannot sync a folder, and of folders that may not be read."""


def make_folder(path: Path, *, exist_ok: bool = False) -> set[Path]:
    """Create a folder and those above it that are missing; raises OSError as :meth:`pathlib.Path.mkdir` does.

    Returns the folders with a new entry: pass each to :func:`sync_folder`.
    """
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    path.mkdir(parents=True, exist_ok=exist_ok)
    return {folder.parent for folder in missing}


def write_synced(path: Path, content: bytes) -> None:
    """Write a file, and wait until its content is on the disk; OSError when the disk refuses."""
    with path.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, where that is possible; OSError when the disk refuses."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError as error:
        if error.errno in _CANNOT:
            return
        raise
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _CANNOT:
            raise
    finally:
        os.close(descriptor)


def exchanged(one: Path, other: Path) -> bool:
    """Exchange the names of two folders in one step; tell whether the system can."""
    rename = getattr(ctypes.CDLL(None), "renameat2", None) if os.name == "posix" else None
    return rename is not None and rename(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _EXCHANGE) == 0
