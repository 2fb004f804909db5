"""Work on further processes, of this machine or of any executor, its results in the order of the work."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from traceback import format_exc
from typing import Any, NoReturn, ParamSpec, TypeVar

from drive_id.errors import WorkerError

Item = TypeVar("Item")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

_AHEAD = 2
"""Pieces of work per process that are under way or wait to be taken: results of tens of MB must not pile up."""
_AHEAD_ANYWHERE = 32
"""Likewise for all workers of an executor that does not tell their number: sums of 92 MB (``full``) are 3 GB."""
_GRACE = 2.0
"""Time for a process to remove its temporary files, s; it takes milliseconds, longer only amid compiled code."""


def in_processes(
    work: Callable[[Item], Result], items: Iterable[Item], count: int, executor: Executor | None = None
) -> Generator[Result]:
    """Yield ``work(item)`` of each item in order, computed by ``count`` processes, or by this one if that is 1.

    The processes end with the iteration. Who may leave it early, as by Ctrl-C, closes it (:func:`contextlib.closing`):
    what the garbage collector closes can raise no further interrupt.

    With ``executor``, it computes instead, and goes on after the iteration; it has ``count`` workers, or an unknown
    number of them if that is 1.

    Raises WorkerError when a process dies, as without memory.
    """
    if executor is not None:
        try:
            yield from in_order(work, items, executor, _AHEAD * count if count > 1 else _AHEAD_ANYWHERE)
        except BrokenExecutor as error:
            raise WorkerError(
                "A process of the executor has died, probably for lack of memory: give it fewer workers."
            ) from error
        return
    if count == 1:
        yield from map(work, items)
        return
    with processes(count) as ours:
        yield from in_order(work, items, ours, _AHEAD * count)


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], executor: Executor, ahead: int
) -> Generator[Result]:
    """Yield ``work(item)`` of each item in order, computed by any executor, given ``ahead`` items at a time."""
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(executor.submit(work, item))
            if len(waiting) == ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Give an executor of so many processes, which end with the block within seconds, whatever is under way."""
    executor = _Processes(count)
    try:
        yield executor
    finally:
        executor.end()


class _Processes(ThreadPoolExecutor):
    """Processes with a pipe each, at which a thread of this process waits: any of them may die at any time.

    Those of :mod:`concurrent.futures` and loky write into one pipe, whose other end this process holds as well. When
    one of them dies amid a result, the rest is awaited for ever. Here, the end of a process is the end of its pipe.
    """

    def __init__(self, count: int) -> None:
        super().__init__(count)
        self._of_thread = threading.local()
        self._started: list[BaseProcess] = []
        self._starting = threading.Lock()
        self._ended = False

    def submit(
        self, work: Callable[Arguments, Result], /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Future[Result]:
        """Let an idle process compute ``work(*args, **kwargs)``."""
        return super().submit(self._computed, work, args, kwargs)

    def end(self) -> None:
        """End all processes: asked to, they remove their temporary files; then they are killed."""
        try:
            with self._starting:
                self._ended = True
            self.shutdown(wait=False, cancel_futures=True)
            for process in self._started:
                process.terminate()
            due = time.monotonic() + _GRACE
            alive: set[Any] = {process.sentinel for process in self._started}
            while alive and (left := due - time.monotonic()) > 0:
                alive -= {*wait(alive, left)}
        finally:  # also when interrupted once more
            for process in self._started:
                process.kill()
            self.shutdown()
            for process in self._started:
                process.join()

    def _computed(self, work: Callable[..., Result], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Result:
        """Return ``work(*args, **kwargs)``, or raise what it raises, from the process of this thread."""
        if not hasattr(self._of_thread, "process"):
            self._start()
        pipe: Connection = self._of_thread.pipe
        asked = pickle.dumps((work, args, kwargs))
        try:
            pipe.send_bytes(asked)
            answer = pipe.recv_bytes()
        except (EOFError, OSError):
            self._tell_death()
        result: Result
        result, error, told = pickle.loads(answer)
        if error is not None:
            raise error from RuntimeError(f"In a process of its own:\n{told}")
        return result

    def _start(self) -> None:
        """Start the process of this thread; never amid an interrupt, which only the main thread receives."""
        context = multiprocessing.get_context("spawn")  # a fork would copy locks of other threads
        with self._starting:
            if self._ended:
                raise WorkerError("The work was ended: start it again.")
            self._of_thread.pipe, its = context.Pipe()
            process = context.Process(target=_serve, args=(its,), daemon=True)
            resource_tracker.ensure_running()  # would unblock the signal later
            # They never receive Ctrl-C: each would print a traceback. They are ended with the work.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                process.start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
                its.close()
            self._of_thread.process = process
            self._started.append(process)

    def _tell_death(self) -> NoReturn:
        process: BaseProcess = self._of_thread.process
        process.join(_GRACE)
        if process.exitcode == -signal.SIGKILL:
            why = "has died, probably for lack of memory: use fewer --workers"
        elif process.exitcode == 1:
            why = 'has failed, as printed above: in a script, ask for workers only below `if __name__ == "__main__":`'
        else:
            why = f"has died (exit code {process.exitcode}): use one worker, and report it if that fails as well"
        raise WorkerError(f"A process that reads recordings {why}.")


def _serve(pipe: Connection) -> None:
    """Compute what comes through the pipe, until the other end is closed or the process is asked to end."""
    signal.signal(signal.SIGTERM, _end)
    with suppress(EOFError, ConnectionError):
        while True:
            pipe.send_bytes(_answer(pipe.recv_bytes()))


def _answer(asked: bytes) -> bytes:
    try:
        work, args, kwargs = pickle.loads(asked)
        return pickle.dumps((work(*args, **kwargs), None, ""))
    except Exception as error:  # noqa: BLE001  # raised again where the work was asked for
        return pickle.dumps((None, error, format_exc()))


def _end(*_signal: object) -> NoReturn:
    sys.unraisablehook = lambda _: None  # where Python cannot end, amid a callback, it would print a traceback
    raise SystemExit
