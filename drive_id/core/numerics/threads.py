"""Threads: several pieces of work at once, and one thread of BLAS for each."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
Result = TypeVar("Result")

_MOST = 4


class _Background(threading.local):
    check: Callable[[], None] | None = None


_background = _Background()


@contextmanager
def in_background(check: Callable[[], None]) -> Iterator[None]:
    """Keep what this thread computes in the body to this thread, and call ``check`` often; it may raise to end it."""
    _background.check = check
    try:
        yield
    finally:
        _background.check = None


def in_threads(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Return ``work(item)`` of each item in order, computed in up to four threads; see :func:`in_background`."""
    if (check := _background.check) is not None:
        return [(check(), work(item))[1] for item in items]
    threads = min(_MOST, os.cpu_count() or 1, len(items))
    if threads < 2:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads, "fit") as pool:
        return list(pool.map(work, items))


_limit = threading.Lock()  # held by whoever limits BLAS: only the thread that set a limit can restore it


@cache
def _controller(with_scipy: bool) -> ThreadpoolController:
    """Return the BLAS libraries of numpy, and of scipy if wanted; the search takes milliseconds."""
    if with_scipy:
        import scipy.linalg  # noqa: F401, PLC0415  # loads a BLAS of its own, slowly
    return ThreadpoolController()


@contextmanager
def one_blas_thread(*, with_scipy: bool) -> Iterator[None]:
    """Limit BLAS to one thread: our matrices are small, more threads only wait, and results depend on their number.

    The limit holds for the process. Inside another such body, of this thread or another one, nothing is changed.

    Parameters
    ----------
    with_scipy : bool
        Whether the body calls scipy.linalg.
    """
    if not _limit.acquire(blocking=False):
        yield
        return
    try:
        with _controller(with_scipy).limit(limits=1, user_api="blas"):
            yield
    finally:
        _limit.release()
