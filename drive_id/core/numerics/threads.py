"""Work on several things at once, in threads: what numpy and the kernels do for long lets others go on meanwhile."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from threadpoolctl import threadpool_limits

Item = TypeVar("Item")
Result = TypeVar("Result")

_MOST = 4


def in_threads(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Return what ``work`` makes of each item, in their order: the same whatever the number of threads is."""
    threads = min(_MOST, os.cpu_count() or 1, len(items))
    if threads < 2:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads, "fit") as pool:
        return list(pool.map(work, items))


@contextmanager
def one_blas_thread(*, with_scipy: bool) -> Iterator[None]:
    """Keep BLAS to one thread: our matrices are small, more threads only wait, and results depend on their number.

    Parameters
    ----------
    with_scipy : bool
        Whether the body will call scipy.linalg, which brings a BLAS of its own: it must be loaded to be limited.
    """
    if with_scipy:
        import scipy.linalg  # noqa: F401, PLC0415  # slow to load
    with threadpool_limits(1, user_api="blas"):
        yield
