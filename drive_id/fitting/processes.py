"""Work on further processes of this machine, its results in the order of the work."""

from __future__ import annotations

import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import TypeVar

from drive_id.errors import WorkerError

Item = TypeVar("Item")
Result = TypeVar("Result")

_AHEAD = 2
"""Pieces of work per process that are under way or wait to be taken: results of tens of MB must not pile up."""


def in_processes(work: Callable[[Item], Result], items: Iterable[Item], count: int) -> Generator[Result]:
    """Yield ``work(item)`` of each item in order, computed by ``count`` processes, or by this one if that is 1.

    The processes end with the iteration, also when it is left early or interrupted.

    Raises WorkerError when a process dies, as without memory.
    """
    if count == 1:
        yield from map(work, items)
        return
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"))  # a fork would copy locks of other threads
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            with _uninterrupted():
                waiting.append(pool.submit(work, item))
            if len(waiting) == _AHEAD * count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    except BrokenProcessPool as error:
        raise WorkerError(
            "A process that reads recordings has died, probably for lack of memory: use fewer --workers."
        ) from error
    finally:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()  # a recording under way must not delay the end
        pool.shutdown(cancel_futures=True)  # its thread waits for the processes: two that wait miss one another's


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Start processes that never receive Ctrl-C: they would each print a traceback. They are ended with the work."""
    resource_tracker.ensure_running()  # would unblock it later
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
