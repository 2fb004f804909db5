"""Whether a process still hears what others send it by the shared memory of Fast DDS."""

from __future__ import annotations

from pathlib import Path

_FOLDER = "/dev/shm/"
_THREAD = "dds.shm."
"""Name of a thread that listens, followed by the number of its port."""


class SharedMemoryPorts:
    """The ports at which this process listens; none with other middleware, or by the network only.

    Fast DDS takes a port for dead, whose process does not answer within a second, removes it and creates another one
    (its issue 5469): who opens it then sends to the new one, and a process that was merely held up goes on listening
    at the old one. It publishes as before, but hears no request, no emergency stop, and no newcomer.
    """

    def __init__(self) -> None:
        self._doubtful = False
        self._listened = self._mapped()

    def deaf(self) -> str:
        """Return the file of a port that was replaced, as two calls in succession found; empty if there is none."""
        replaced = self._replaced()
        if replaced:  # unless this process has replaced it itself, or is about to
            self._listened = self._mapped() or self._listened
            replaced = self._replaced()
        doubtful, self._doubtful = self._doubtful, bool(replaced)
        return replaced if doubtful else ""

    def _replaced(self) -> str:
        return next((path for path, inodes in self._listened.items() if _inode(path) not in inodes), "")

    def _mapped(self) -> dict[str, set[int]]:
        """Return the files of the ports at which threads of this process listen, with the inodes that are mapped."""
        try:
            names = [(task / "comm").read_text(encoding="utf-8").strip() for task in Path("/proc/self/task").iterdir()]
            maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")
        except OSError:  # another system, or a thread that has just ended
            return {}
        ports = {name.removeprefix(_THREAD) for name in names if name.startswith(_THREAD)}
        found: dict[str, set[int]] = {}
        for line in maps.splitlines():
            if _FOLDER in line:
                inode, path = line.split()[4:6]
                if path.rpartition("_port")[2] in ports:
                    found.setdefault(path, set()).add(int(inode))
        return found


def _inode(path: str) -> int:
    """Return the inode of a file, 0 if there is none."""
    try:
        return Path(path).stat().st_ino
    except OSError:
        return 0
