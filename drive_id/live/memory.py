"""Return memory to the system after a fit, in processes that fit occasionally."""

from __future__ import annotations

import ctypes

_M_ARENA_MAX = -8
_ARENAS = 2


def share_arenas() -> None:
    """Limit this process to two malloc arenas of glibc; call it before any thread is started.

    By default, threads get arenas of their own, each of which keeps its peak memory after a fit. Without glibc, this
    does nothing.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, _ARENAS)


def return_free_memory() -> None:
    """Return free memory to the system: some 10 ms after a fit. Without glibc, this does nothing."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
