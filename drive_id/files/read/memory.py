"""Refuses logs that must be read as a whole and do not fit into memory."""

from __future__ import annotations

from pathlib import Path

from drive_id.errors import ConfigurationError

BYTES_PER_SAMPLE = 480
"""Peak memory of reading and joining a whole log, per sample of the currents."""
_FIRST = 1 << 16
"""Samples before the first estimate; repeated at every doubling."""
_SHARE = 0.9  # of the free memory that reading may take
_GIGA = 1e-9
_CACHES = ("inactive_file ", "active_file ")
"""Page cache of a container (cgroup), which the kernel frees on demand."""


class MemoryGuard:
    """Estimates the memory that a whole log needs while it is being read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._samples = 0
        self._next = _FIRST

    def add(self, samples: int, progress: float) -> None:
        """Count further samples of the currents; ``progress`` is the share of the log that has been read.

        Raises ConfigurationError when the whole log needs more memory than is available.
        """
        self._samples += samples
        if self._samples < self._next or not 0.0 < progress <= 1.0:
            return
        self._next *= 2
        available = available_memory()
        total = self._samples / progress * BYTES_PER_SAMPLE
        if available is not None and total > _SHARE * available:
            raise ConfigurationError(
                f"{self._path} must be read as a whole, which takes about {total * _GIGA:.2g} GB, but only "
                f"{available * _GIGA:.2g} GB of memory are free: split the log, or use a signals file that allows "
                "reading in parts (sample_period in every section, the speed next to the angle; no smoothing, "
                "interpolate, equally_spaced or decimation)."
            )


def available_memory() -> int | None:
    """Return the memory available within the limits of machine and container, bytes; None if unknown."""
    system = _lines(Path("/proc/meminfo"))
    found = [1024 * int(line.split()[1]) for line in system if line.startswith("MemAvailable:")]
    group = Path("/sys/fs/cgroup")
    limit, used = (_lines(group / name) for name in ("memory.max", "memory.current"))
    if limit and used and limit[0].isdigit():
        cached = [line.split()[1] for line in _lines(group / "memory.stat") if line.startswith(_CACHES)]
        found.append(max(int(limit[0]) - int(used[0]) + sum(map(int, cached)), 0))
    return min(found, default=None)


def _lines(path: Path) -> list[str]:
    """Return the lines of a system file; none if it cannot be read."""
    try:
        return path.read_text(encoding="ascii").splitlines()
    except OSError:
        return []
