"""How kernels become machine code: with numba, once on a computer, and not silently.

numba keeps the machine code beside the package or, where that is read-only, in the user's cache directory. It compiles
anew after a change of a kernel's file, and for another CPU.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from typing import Any, cast

import numba
from numba.core import event, sigutils

_CONSTANT = re.compile(r"const (\w+)\[([^]]*)\]")


def dispatcher(function: Callable[..., object], signature: str | None) -> Any:
    """Return numba's version of a function, see :class:`~drive_id.core.numerics.compiled.Kernel`."""
    made = numba.njit(nogil=True, error_model="numpy")(function)
    try:
        made.enable_caching()
    except RuntimeError:  # no folder for it can be written
        _announcement.kept = False
    if signature is not None:
        made.compile(argument_types(signature))
        made.disable_compile()
    return made


def argument_types(signature: str) -> tuple[Any, ...]:
    """Return numba's types of the arguments that a signature lists."""

    def constant(found: re.Match[str]) -> str:
        return f"Array({found[1]}, {found[2].count(',') + 1}, 'C', readonly=True)"

    types, _ = sigutils.normalize_signature(f"({_CONSTANT.sub(constant, signature)},)")
    return cast(tuple[Any, ...], types)


class _Announcement(event.Listener):
    """Tells once why the process is slow; numba reports what it compiles, not what it loads from its cache."""

    kept = True
    """Whether the machine code can be kept."""

    def on_start(self, event_: event.Event) -> None:
        if event_.data["dispatcher"].py_func.__module__.startswith("drive_id."):  # not a kernel of the user's
            event.unregister("numba:compile", self)
            often = "once" if self.kept else "at each start (set NUMBA_CACHE_DIR to a folder that can be written)"
            logging.getLogger("drive_id").warning("drive_id: compiling for this computer, %s: about 10 s.", often)

    def on_end(self, event_: event.Event) -> None:
        """Do nothing; numba asks for this method."""


_announcement = _Announcement()
event.register("numba:compile", _announcement)
