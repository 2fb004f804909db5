"""Simulates power cuts: logs file operations and builds disk states that may remain.

:func:`logged` logs every change below a folder while the program runs on a real disk. :meth:`DiskLog.crash_state` then
takes the first operations of the log and keeps what POSIX guarantees:

- of a file, what was written before an ``fsync`` of it that had returned. Later writes are lost, kept, truncated at a
  block, or kept for a random subset of blocks, where a missing block reads as zeros or as old data of the disk.
- of a folder, the names made, renamed and removed before an ``fsync`` of it. Of later changes any may be lost; each by
  itself is atomic. The ``fsync`` of a file does not keep its name.

The model is that of Pillai et al., "All file systems are not created equal", OSDI 2014.
"""

from __future__ import annotations

import builtins
import io
import os
import pathlib
import random
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

BLOCKS = (512, 4096)
"""Bytes that a disk writes as a whole."""
FATES = ("lost", "kept", "torn", "zeros", "stale")
_WRITING = frozenset("wxa+")
_ROOT = 0


@dataclass(frozen=True)
class Name:
    """A name in a folder now leads to a file or folder; ``node`` None: to nothing. A rename is two of them at once."""

    changes: tuple[tuple[int, str, int | None], ...]


@dataclass(frozen=True)
class Write:
    """Bytes at an offset of a file; ``data`` None: the file ends at the offset."""

    node: int
    offset: int
    data: bytes | None


@dataclass(frozen=True)
class Sync:
    """A file or folder is on the disk as of operation ``known``."""

    node: int
    known: int


@dataclass
class DiskLog:
    """Everything done to the files below a folder, in order."""

    root: Path
    operations: list[Name | Write | Sync] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._names: dict[int, dict[str, int]] = {_ROOT: {}}
        self._open: dict[int, int] = {}
        self._lock = threading.Lock()
        self._nodes = 1

    # -- logging -------------------------------------------------------------------------------------------------------

    def note(self, operation: Name | Write | Sync) -> None:
        """Add an operation that is over."""
        with self._lock:
            self.operations.append(operation)

    def covers(self, path: Path) -> bool:
        """Return whether a path lies below the folder."""
        return self.root in path.parents

    def place(self, path: Path) -> tuple[int, str]:
        """Return the folder of a path, and its name in there."""
        node = _ROOT
        for part in path.parent.relative_to(self.root).parts:
            node = self._names[node][part]
        return node, path.name

    def node(self, path: Path) -> int:
        """Return the file or folder of a path."""
        if path == self.root:
            return _ROOT
        folder, name = self.place(path)
        return self._names[folder][name]

    def made(self, path: Path, *, is_folder: bool = False) -> int:
        """Note a new file or folder and return it."""
        folder, name = self.place(path)
        self._nodes += 1
        if is_folder:
            self._names[self._nodes] = {}
        self._names[folder][name] = self._nodes
        self.note(Name(((folder, name, self._nodes),)))
        return self._nodes

    def removed(self, path: Path) -> None:
        """Note that a name is gone."""
        folder, name = self.place(path)
        del self._names[folder][name]
        self.note(Name(((folder, name, None),)))

    def renamed(self, old: Path, new: Path) -> None:
        """Note a rename, which happens as a whole or not at all."""
        (folder, name), (new_folder, new_name) = self.place(old), self.place(new)
        node = self._names[folder].pop(name)
        self._names[new_folder][new_name] = node
        self.note(Name(((folder, name, None), (new_folder, new_name, node))))

    def opened(self, descriptor: int, node: int) -> None:
        """Remember the file of a descriptor."""
        self._open[descriptor] = node

    def closed(self, descriptor: int) -> None:
        """Forget a descriptor."""
        self._open.pop(descriptor, None)

    def sync(self, descriptor: int, fsync: Callable[[int], None]) -> None:
        """Sync a file or folder, and note what had happened before."""
        known = len(self.operations)
        fsync(descriptor)
        if descriptor in self._open:
            self.note(Sync(self._open[descriptor], known))

    # -- what is left of it --------------------------------------------------------------------------------------------

    def crash_state(self, count: int, rng: random.Random, target: Path) -> str:
        """Write what a power cut behind the first ``count`` operations may leave.

        Parameters
        ----------
        count : int
        rng : random.Random
            Decides about everything that was not synced.
        target : Path
            New folder, in place of the logged one.

        Returns
        -------
        str
            What became of the unsynced changes.
        """
        block, in_order = rng.choice(BLOCKS), rng.random() < 0.5
        names, lost = self._kept_names(count, rng, in_order=in_order)
        said = [f"{count} operations, blocks of {block}, {lost} names lost {'in' if in_order else 'out of'} order"]

        def write(node: int, path: Path) -> None:
            if node in self._names:
                path.mkdir()
                for name, inner in names.get(node, {}).items():
                    write(inner, path / name)
                return
            fate = rng.choice(FATES)
            said.append(f"{path.name} {fate}")
            path.write_bytes(self._content(node, count, rng, fate, block))

        write(_ROOT, target)
        return ", ".join(said)

    def final_state(self, target: Path) -> None:
        """Replay all operations: the result equals the folder unless an operation escaped the log."""
        everything = DiskLog(self.root, [*self.operations])
        everything._names = self._names
        nodes = [_ROOT, *range(2, self._nodes + 1)]
        everything.operations += [Sync(node, len(self.operations)) for node in nodes]
        everything.crash_state(len(everything.operations), random.Random(0), target)

    def _synced(self, count: int) -> dict[int, int]:
        """Return for each file and folder the number of operations that are certainly on the disk."""
        known: dict[int, int] = {}
        for each in self.operations[:count]:
            if isinstance(each, Sync):
                known[each.node] = max(known.get(each.node, 0), each.known)
        return known

    def _kept_names(self, count: int, rng: random.Random, *, in_order: bool) -> tuple[dict[int, dict[str, int]], int]:
        """Return the files that the names refer to, and the number of lost changes of names."""
        known = self._synced(count)
        changes = [(k, each) for k, each in enumerate(self.operations[:count]) if isinstance(each, Name)]
        certain = {k for k, each in changes if any(k < known.get(folder, 0) for folder, _, _ in each.changes)}
        share = rng.choice((0.0, 0.5, 0.9))
        if in_order:
            last = max(certain, default=-1)
            later = [k for k, _ in changes if k > last]
            kept = {k for k, _ in changes if k <= last} | set(later[: rng.randint(0, len(later))])
        else:
            kept = certain | {k for k, _ in changes if rng.random() < share}
        names: dict[int, dict[str, int]] = {}
        for k, each in changes:
            for folder, name, node in each.changes if k in kept else ():
                if node is None:
                    names.setdefault(folder, {}).pop(name, None)
                else:
                    names.setdefault(folder, {})[name] = node
        return names, len(changes) - len(kept)

    def _content(self, node: int, count: int, rng: random.Random, fate: str, block: int) -> bytes:
        """Return the content of a file."""
        known = self._synced(count).get(node, 0)
        writes = [(k, w) for k, w in enumerate(self.operations[:count]) if isinstance(w, Write) and w.node == node]
        safe, pending = bytearray(), [write for k, write in writes if k >= known]
        for k, write in writes:
            if k < known:
                _apply(safe, write)
        if fate == "lost" or not pending:
            return bytes(safe)
        if fate == "torn":
            whole = rng.randrange(len(pending))
            for write in pending[:whole]:
                _apply(safe, write)
            last = pending[whole]
            if last.data is not None:
                ends = range(block - last.offset % block, len(last.data), block)
                _apply(safe, Write(node, last.offset, last.data[: rng.choice((0, *ends))]))
            return bytes(safe)
        full = bytearray(safe)
        for write in pending:
            _apply(full, write)
        if fate == "kept":
            return bytes(full)
        share = rng.choice((0.2, 0.5, 0.9))
        old = self._old_data(rng)
        for begin in range(0, len(full), block):
            end = min(begin + block, len(full))
            if full[begin:end] != safe[begin:end] and rng.random() > share:
                missing = bytes(block) if fate == "zeros" else old(block)
                full[begin:end] = (bytes(safe[begin:end]) + missing[len(safe[begin:end]) :])[: end - begin]
        return bytes(full)

    def _old_data(self, rng: random.Random) -> Callable[[int], bytes]:
        """Return a function that yields blocks of old data, written elsewhere before."""
        written = [each.data for each in self.operations if isinstance(each, Write) and each.data]

        def old(size: int) -> bytes:
            data = rng.choice(written)
            start = rng.randrange(len(data))
            return data[start : start + size].ljust(size, b"\0")

        return old


def _apply(content: bytearray, write: Write) -> None:
    if write.data is None:
        del content[write.offset :]
        content.extend(bytes(write.offset - len(content)))
        return
    content.extend(bytes(max(0, write.offset - len(content))))
    content[write.offset : write.offset + len(write.data)] = write.data


class LoggedFile(io.FileIO):
    """A file whose writes are logged."""

    def __init__(self, log: DiskLog, path: Path, mode: str) -> None:
        existed = path.exists()
        super().__init__(path, mode)
        self._log = log
        self.node = log.node(path) if existed else log.made(path)
        if existed and "w" in mode:
            log.note(Write(self.node, 0, None))
        log.opened(self.fileno(), self.node)

    def write(self, data: Any) -> int:
        """Write, and note it."""
        written = super().write(data)
        self._log.note(Write(self.node, self.tell() - written, bytes(data)[:written]))
        return written

    def truncate(self, size: int | None = None) -> int:
        """Truncate, and note it."""
        end = super().truncate(size)
        self._log.note(Write(self.node, end, None))
        return end

    def close(self) -> None:
        """Close, and free the descriptor before another file gets it."""
        if not self.closed:
            self._log.closed(self.fileno())
        super().close()


class _Substitutes:
    """Python's functions that change files, with logging."""

    def __init__(self, log: DiskLog) -> None:
        self._log = log
        self._folders: dict[int, Path] = {}
        self._real = {name: getattr(os, name) for name in ("mkdir", "replace", "unlink", "rmdir", "open", "close")}
        self._open, self._fsync = io.open, os.fsync

    def mkdir(self, path: Any, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        self._real["mkdir"](path, mode, dir_fd=dir_fd)
        if self._log.covers(found := self._where(path, dir_fd)):
            self._log.made(found, is_folder=True)

    def replace(self, old: Any, new: Any) -> None:
        self._real["replace"](old, new)
        if self._log.covers(found := self._where(old)):
            self._log.renamed(found, self._where(new))

    def unlink(self, path: Any, *, dir_fd: int | None = None) -> None:
        self._remove("unlink", path, dir_fd)

    def rmdir(self, path: Any, *, dir_fd: int | None = None) -> None:
        self._remove("rmdir", path, dir_fd)

    def open(self, path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        descriptor = int(self._real["open"](path, flags, mode, dir_fd=dir_fd))
        found = self._where(path, dir_fd)
        if found == self._log.root or self._log.covers(found):
            self._log.opened(descriptor, self._log.node(found))
            self._folders[descriptor] = found
        return descriptor

    def close(self, descriptor: int) -> None:
        self._folders.pop(descriptor, None)
        self._log.closed(descriptor)
        self._real["close"](descriptor)

    def fsync(self, descriptor: int) -> None:
        self._log.sync(descriptor, self._fsync)

    def open_file(self, file: Any, mode: str = "r", buffering: int = -1, *arguments: Any, **options: Any) -> Any:
        if isinstance(file, int) or not _WRITING & set(mode) or not self._log.covers(self._where(file)):
            return self._open(file, mode, buffering, *arguments, **options)
        raw = LoggedFile(self._log, self._where(file), mode.replace("b", "").replace("t", ""))
        if buffering == 0:
            return raw
        buffered: Any = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, *arguments, **options)

    def _remove(self, name: str, path: Any, dir_fd: int | None) -> None:
        self._real[name](path, dir_fd=dir_fd)
        if self._log.covers(found := self._where(path, dir_fd)):
            self._log.removed(found)

    def _where(self, path: Any, dir_fd: int | None = None) -> Path:
        name = Path(os.fsdecode(path))
        return self._folders[dir_fd] / name if dir_fd in self._folders else name.absolute()


@contextmanager
def logged(root: Path) -> Iterator[DiskLog]:
    """Log changes of the files below a folder by ``open``, ``pathlib``, ``os``, ``shutil`` and ``tempfile``."""
    log = DiskLog(root.absolute())
    ours = _Substitutes(log)
    functions: dict[str, Callable[..., Any]]
    functions = {"mkdir": ours.mkdir, "unlink": ours.unlink, "rmdir": ours.rmdir, "open": ours.open}
    functions |= {"rename": ours.replace, "replace": ours.replace, "remove": ours.unlink}
    functions |= {"close": ours.close, "fsync": ours.fsync}
    accessor: Any = getattr(pathlib, "_NormalAccessor", None)  # Python 3.10 keeps its own references there
    with ExitStack() as stack:
        for name, function in functions.items():
            stack.enter_context(patch.object(os, name, function))
        for module in (io, builtins):
            stack.enter_context(patch.object(module, "open", ours.open_file))
        for name, function in {**functions, "open": ours.open_file}.items():
            if hasattr(accessor, name):
                stack.enter_context(patch.object(accessor, name, staticmethod(function)))
        yield log
