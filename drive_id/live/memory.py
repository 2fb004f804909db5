"""Memory of a process that fits now and then: what a fit needed goes back to the system."""

from __future__ import annotations

import ctypes

_M_ARENA_MAX = -8
_ARENAS = 2


def share_arenas() -> None:
    """Keep the threads of this process to two heaps of the C library; call it before any thread is started.

    By default each thread gets a heap of its own, which keeps the most that a fit has needed. Without glibc, nothing is
    changed.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, _ARENAS)


def return_free_memory() -> None:
    """Return free memory to the system, which takes some 10 ms after a fit; without glibc, nothing is returned."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
