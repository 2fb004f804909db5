"""Threads: several pieces of work at once, and one thread of BLAS for each."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_THREADS = 4  # however many cores there are: a fit shares the computer with the nodes


def usable_cores() -> int:
    """Return the cores that this process may use: of its affinity, and at most ``OMP_NUM_THREADS``, as BLAS takes."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    told = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    return max(1, min(cores, int(told))) if told.isdecimal() else cores


class _Background(threading.local):
    check: Callable[[], None] | None = None
    alone: bool = False


_background = _Background()


@contextmanager
def interruptible(check: Callable[[], None], *, alone: bool = False) -> Iterator[None]:
    """Call ``check`` often in what this thread computes in the body, in any of its threads; it may raise to end it.

    ``alone``: what the body computes stays in this thread.
    """
    before = _background.check, _background.alone
    _background.check, _background.alone = check, alone
    try:
        yield
    finally:
        _background.check, _background.alone = before


def in_threads(work: Callable[[Item], Result], items: Sequence[Item], most: int = MOST_THREADS) -> list[Result]:
    """Return ``work(item)`` of each item in order, computed in up to ``most`` threads; see :func:`interruptible`."""
    check = _background.check

    def checked(item: Item) -> Result:
        if check is not None:
            check()
        return work(item)

    threads = 1 if _background.alone else min(most, usable_cores(), len(items))
    if threads < 2:
        return [checked(item) for item in items]
    with ThreadPoolExecutor(threads, "fit") as pool:
        return list(pool.map(checked, items))


def begun(work: Callable[[], None]) -> Future[None]:
    """Begin ``work`` in a thread of its own; where :func:`in_threads` takes no other one, do it."""
    pool = ThreadPoolExecutor(1, "fit")
    future = pool.submit(work)
    if _background.alone or usable_cores() < 2:
        future.result()
    pool.shutdown(wait=False)
    return future


_limit = threading.Lock()  # held by whoever limits BLAS: only the thread that set a limit can restore it


@cache
def _controller() -> ThreadpoolController:
    """Return the BLAS libraries of numpy and of scipy, which the first kernel loads anyway; the search takes ms."""
    import scipy.linalg  # noqa: F401, PLC0415  # not before a fit

    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread: our matrices are small, more threads only wait, and results depend on their number.

    The limit holds for the process. Inside another such body, of this thread or another one, nothing is changed.
    """
    if not _limit.acquire(blocking=False):
        yield
        return
    try:
        with _controller().limit(limits=1, user_api="blas"):
            yield
    finally:
        _limit.release()
