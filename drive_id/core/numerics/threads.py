"""Threads: several pieces of work at once, and one thread of BLAS for each."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
Result = TypeVar("Result")

_MOST = 4


def in_threads(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Return ``work(item)`` of each item in order, computed in up to four threads."""
    threads = min(_MOST, os.cpu_count() or 1, len(items))
    if threads < 2:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads, "fit") as pool:
        return list(pool.map(work, items))


class _Limits:
    """BLAS limits in force; the first body that needs one sets it, the last one restores what was before."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._bodies = 0
        self._in_force: dict[bool, Any] = {}

    def enter(self, *, with_scipy: bool) -> None:
        with self._lock:
            self._bodies += 1
            if with_scipy not in self._in_force:
                self._in_force[with_scipy] = _controller(with_scipy).limit(limits=1, user_api="blas")

    def leave(self) -> None:
        with self._lock:
            self._bodies -= 1
            while not self._bodies and self._in_force:
                self._in_force.popitem()[1].restore_original_limits()


_limits = _Limits()


@cache
def _controller(with_scipy: bool) -> ThreadpoolController:
    """Return the BLAS libraries of numpy, and of scipy if wanted; the search takes milliseconds."""
    if with_scipy:
        import scipy.linalg  # noqa: F401, PLC0415  # loads a BLAS of its own, slowly
    return ThreadpoolController()


@contextmanager
def one_blas_thread(*, with_scipy: bool) -> Iterator[None]:
    """Limit BLAS to one thread: our matrices are small, more threads only wait, and results depend on their number.

    May be nested, and entered by several threads at once.

    Parameters
    ----------
    with_scipy : bool
        Whether the body calls scipy.linalg.
    """
    _limits.enter(with_scipy=with_scipy)
    try:
        yield
    finally:
        _limits.leave()
