"""A thread that runs one long job at a time and can cancel it, and what its process does with the memory of fits."""

from __future__ import annotations

import ctypes
import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from drive_id.core.numerics.threads import interruptible
from drive_id.types import Progress

Result = TypeVar("Result")
_M_ARENA_MAX = -8
"""Parameter of mallopt, as malloc.h of glibc has it."""
_ARENAS = 2
"""Of malloc: the main one, and one for all other threads."""


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


def step_of(what: str) -> str:
    """Return the name of a step; a comma and how fast it goes may follow it."""
    return what.partition(",")[0]


class Cancelled(BaseException):  # like KeyboardInterrupt, no handler of errors may catch it
    """The job was cancelled."""


class Worker(Generic[Result]):
    """Runs jobs that report their progress; where they do, they can be cancelled.

    The thread is a daemon: the end of the process does not wait for compiled code.
    """

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self.progress: tuple[str, float | None] = ("", None)
        """Name of the present step and its completed share, 0 to 1; None where the share is unknown."""
        self.begun: deque[tuple[str, float | None]] = deque()
        """First progress of each step, for another thread to take: a step may be over before that looks."""
        self.steps = 0
        """Number of places that the job has passed at which it can be cancelled."""
        self.left: Result | None = None
        """What a job returned that was cancelled and cleaned up after itself."""

    @property
    def busy(self) -> bool:
        """Whether a job is running."""
        return self._thread is not None and self._thread.is_alive()

    def start(self, job: Callable[[Progress], Result], done: Callable[[Result], None]) -> None:
        """Run a job.

        Parameters
        ----------
        job : callable
            Called with the function that takes its progress; must not raise.
        done : callable
            Called with the result, in the worker's thread, unless the job was cancelled.
        """
        waiting = [job]  # so that nothing holds the job, and its samples, when it is done
        stopping = self._stopping = threading.Event()

        def check() -> None:
            self.steps += 1
            if stopping.is_set():
                raise Cancelled

        def tell(what: str, share: float | None) -> None:
            check()
            if step_of(what) != step_of(self.progress[0]):
                self.begun.append((what, share))
            self.progress = (what, share)

        def run() -> None:
            try:
                with interruptible(check):
                    result = waiting.pop()(tell)
                if stopping.is_set():
                    self.left = result
                    return
            except Cancelled:
                return
            finally:
                return_free_memory()
            done(result)

        self._thread = threading.Thread(target=run, name="worker", daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        """Have the job end at the next place where it can be cancelled: fits pass several a second."""
        self._stopping.set()

    def stop(self, patience: float) -> None:
        """Cancel the job, and wait ``patience``, s, for its end."""
        self.cancel()
        if self._thread is not None:
            self._thread.join(patience)
