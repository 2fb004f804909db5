"""Refuse to read a log as a whole that does not fit into the memory of this machine."""

from __future__ import annotations

from pathlib import Path

from drive_id.errors import ConfigurationError

BYTES_PER_SAMPLE = 480
"""Largest memory that reading and joining a log at once takes at a time, by sample of the currents."""
_FIRST = 1 << 16
"""Samples after which the need is estimated first; then at every doubling."""
_SHARE = 0.9
_GIGA = 1e-9
_CACHES = ("inactive_file ", "active_file ")
"""Memory of a container that holds read files and is given back when it is needed."""


class MemoryGuard:
    """Estimates while a log is read how much memory all of it needs.

    Parameters
    ----------
    path : Path
        Of the log, for the message.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._samples = 0
        self._next = _FIRST

    def add(self, samples: int, progress: float) -> None:
        """Note further samples of the currents, when a share ``progress`` of the log has been read.

        Raises
        ------
        ConfigurationError
            When the whole log needs more than is left.
        """
        self._samples += samples
        if self._samples < self._next or not 0.0 < progress <= 1.0:
            return
        self._next *= 2
        available = available_memory()
        total = self._samples / progress * BYTES_PER_SAMPLE
        if available is not None and total > _SHARE * available:
            raise ConfigurationError(
                f"{self._path} is read as a whole, which takes about {total * _GIGA:.2g} GB, and "
                f"{available * _GIGA:.2g} GB of memory are free: divide the log, or fit it by a signals file that "
                "allows reading in parts (sample_period in every section and the speed beside the angle; no smoothing, "
                "interpolate, equally_spaced or decimation)."
            )


def available_memory() -> int | None:
    """Return the memory that may still be used, bytes, by the limits of machine and container; None if unknown."""
    system = _lines(Path("/proc/meminfo"))
    found = [1024 * int(line.split()[1]) for line in system if line.startswith("MemAvailable:")]
    group = Path("/sys/fs/cgroup")
    limit, used = (_lines(group / name) for name in ("memory.max", "memory.current"))
    if limit and used and limit[0].isdigit():
        cached = [line.split()[1] for line in _lines(group / "memory.stat") if line.startswith(_CACHES)]
        found.append(max(int(limit[0]) - int(used[0]) + sum(map(int, cached)), 0))
    return min(found, default=None)


def _lines(path: Path) -> list[str]:
    """Return the lines of a file of the system; none where it does not exist."""
    try:
        return path.read_text(encoding="ascii").splitlines()
    except OSError:
        return []
