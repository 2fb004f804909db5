"""Compilation of kernels with numba, with machine code cached on disk and a message while compiling.

numba caches the machine code beside the package or, if that folder is read-only, in the user's cache directory. It
compiles again after a change of a kernel's file, and for another CPU.
"""

from __future__ import annotations

import logging
import re
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import numba
from numba.core import event, sigutils

_CONSTANT = re.compile(r"const (\w+)\[([^]]*)\]")


def dispatcher(function: Callable[..., object], signature: str | None, args: tuple[Any, ...]) -> Any:
    """Return numba's version of a function, see :class:`~drive_id.core.numerics.compiled.Kernel`."""
    made = numba.njit(nogil=True, error_model="numpy")(function)
    try:
        made.enable_caching()
    except RuntimeError:  # no folder for the cache is writable
        _announcement.kept = False
    if signature is not None:
        made.compile(argument_types(signature))
        made.disable_compile()
    elif args:
        made.compile(tuple(made.typeof_pyval(value) for value in args))
    return made


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back: KeyboardInterrupt would be lost if LLVM's callbacks into Python raised it."""
    before = signal.getsignal(signal.SIGINT)
    if before is None or threading.current_thread() is not threading.main_thread():  # others receive no signals
        yield
        return
    held: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: held.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if held:
        signal.raise_signal(signal.SIGINT)


def argument_types(signature: str) -> tuple[Any, ...]:
    """Return numba's types of the arguments that a signature lists."""

    def constant(found: re.Match[str]) -> str:
        return f"Array({found[1]}, {found[2].count(',') + 1}, 'C', readonly=True)"

    types, _ = sigutils.normalize_signature(f"({_CONSTANT.sub(constant, signature)},)")
    return cast(tuple[Any, ...], types)


class _Announcement(event.Listener):
    """Logs one message when numba first compiles a kernel; loading from the cache raises no event."""

    kept = True
    """Whether the machine code can be cached."""

    def on_start(self, event_: event.Event) -> None:
        if event_.data["dispatcher"].py_func.__module__.startswith("drive_id."):  # not the user's own numba functions
            event.unregister("numba:compile", self)
            often = "once" if self.kept else "at each start (set NUMBA_CACHE_DIR to a folder that can be written)"
            logging.getLogger("drive_id").warning("drive_id: compiling for this computer, %s: about 10 s.", often)

    def on_end(self, event_: event.Event) -> None:
        """Do nothing; numba requires this method."""


_announcement = _Announcement()
event.register("numba:compile", _announcement)
