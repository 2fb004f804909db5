"""Ctrl-C in a program that writes: never between an output and its name, never lost, and what was complete by then."""

from __future__ import annotations

import signal
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

_MOST = 8  # outputs of one command that are told
_AGAIN = 0.01
"""After which an interrupt that was lost is repeated, s: the callback that swallowed it has ended by then."""


class _Interrupts:
    """What SIGINT does while :func:`taken` holds: KeyboardInterrupt at once, after a held section, or never again."""

    def __init__(self) -> None:
        self.holding = 0  # sections, one within the other
        self.waiting = self.over = self.swallowing = self.missed = False
        self.complete: deque[Path] = deque(maxlen=_MOST)
        self.timer: threading.Timer | None = None

    def handle(self, _number: int, _frame: FrameType | None) -> None:
        if self.holding:
            self.waiting = True
        elif self.swallowing:  # on a busy machine, the repetition comes before the hook has ended
            self.missed = True
        elif not self.over:
            raise KeyboardInterrupt

    def swallowed(self, lost: sys.UnraisableHookArgs) -> None:
        """Repeat an interrupt that came in a callback or a finalizer, from which Python raises nothing."""
        if lost.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(lost)
            return
        main = threading.main_thread().ident or 0  # to the thread itself, which may wait for the system
        self.swallowing = self.missed = True
        while self.missed:
            self.missed = False
            self.timer = threading.Timer(_AGAIN, signal.pthread_kill, [main, signal.SIGINT])
            self.timer.daemon = True
            self.timer.start()
        self.swallowing = False


_interrupts = _Interrupts()
"""One per process, as its signals are."""


@contextmanager
def taken() -> Iterator[None]:
    """Take SIGINT for a program, so that :func:`held` holds it back; in other threads than the main one, do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _interrupts.over = _interrupts.waiting = False
    _interrupts.complete.clear()
    handler, hook = signal.signal(signal.SIGINT, _interrupts.handle), sys.unraisablehook
    sys.unraisablehook = _interrupts.swallowed
    try:
        yield
    finally:
        if _interrupts.timer is not None:
            _interrupts.timer.cancel()
        sys.unraisablehook = hook
        # After the last word, there is nothing left to interrupt: the end of Python's threads would print a traceback.
        signal.signal(signal.SIGINT, signal.SIG_IGN if _interrupts.over else handler)


@contextmanager
def held() -> Iterator[None]:
    """Hold an interrupt back until the body ends; where nobody has called :func:`taken`, signals are left alone."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _interrupts.holding += 1
    try:
        yield
    finally:
        _interrupts.holding -= 1
    if _interrupts.waiting and not _interrupts.holding:
        _interrupts.waiting = False
        raise KeyboardInterrupt


def note_complete(path: Path) -> None:
    """Note, in the held section that puts an output in its place, that it is complete."""
    if path not in _interrupts.complete:
        _interrupts.complete.append(path)


def last_word() -> str:
    """Return what is to be said of an interrupt, as a sentence without a subject; further ones do nothing."""
    _interrupts.over = True
    if not _interrupts.complete:
        return "interrupted; no output was left behind."
    *others, last = map(str, _interrupts.complete)
    names = f"{', '.join(others)} and {last}" if others else last
    return f"interrupted; {names} {'are' if others else 'is'} complete."
