"""Recordings and fits that several tests look at, each made once: for all workers, and for later runs of these sources.

They lie below pytest's cache, so that a fresh clone begins without any. Their key is a digest of everything that makes
them: the function, its arguments, the sources that it imports from here and from drive_id, and numpy's version.
"""

from __future__ import annotations

import ast
import fcntl
import hashlib
import inspect
import pickle
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np

import drive_id

_KEPT = 7 * 86400.0
"""s after its last use, when an entry goes: sources change by the hour, and an entry holds up to 20 MB."""
_ROOTS = {"drive_id": Path(drive_id.__file__).parent.parent, "": Path(__file__).parent}

folder = Path(tempfile.gettempdir())  # as pytest configures it, see conftest.py


def open_store(path):
    """Keep entries in this folder, those that somebody still uses."""
    global folder  # noqa: PLW0603 - one store per process, and functions of test modules use it without a fixture
    folder = path
    oldest = time.time() - _KEPT
    for entry in path.iterdir():
        if entry.stat().st_mtime < oldest:
            entry.unlink(missing_ok=True)


def stored(make, *arguments, **named):
    """Return ``make(*arguments, **named)``, from the store if it was made before.

    ``make`` depends on its arguments and on sources only, and its result can be pickled. Results are read only.
    """
    key = hashlib.sha256(f"{sys.version} {np.__version__} {make.__module__}.{make.__qualname__}".encode())
    key.update(pickle.dumps((arguments, sorted(named.items()))))
    key.update(_sources(make.__module__))
    entry = folder / key.hexdigest()
    with entry.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # another worker may be making it
        if entry.exists():
            entry.touch()
            return pickle.loads(entry.read_bytes())
        result = make(*arguments, **named)
        draft = entry.with_suffix(".new")
        draft.write_bytes(pickle.dumps(result, protocol=pickle.HIGHEST_PROTOCOL))
        draft.replace(entry)
        return result


@cache
def _sources(module):
    """Return a digest of the source of a module and of those that it imports."""
    every = hashlib.sha256()
    for path in sorted(imported_files(Path(inspect.getfile(sys.modules[module])))):
        every.update(path.read_bytes())
    return every.digest()


def imported_files(path):
    """Return a file and all files of ours that it imports, directly or not."""
    waiting, seen = {path}, set()
    while waiting:
        path = waiting.pop()
        seen.add(path)
        waiting |= _imported(path) - seen
    return seen


@cache
def _imported(source):
    """Return the files of ours that a file imports, wherever it does."""
    found = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            place = _ROOTS.get(name.split(".")[0], _ROOTS[""]) / name.replace(".", "/")
            found |= {path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()}
    return found
