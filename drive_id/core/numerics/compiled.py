"""Kernels: functions that numba compiles, all with the same caching and flags.

Importing a module with kernels costs nothing: numba is loaded, and a kernel compiled or read from the cache, at its
first call. ``docs/adr/0006-few-kernels-one-signature.md`` says why.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., object])

KERNELS: list[Kernel] = []
"""All kernels of the modules imported so far."""


class Kernel:
    """A function that numba compiles, or loads from its cache, when it is first called.

    Parameters
    ----------
    signature : str, optional
        Types of the arguments as numba writes them, with ``const`` before contiguous arrays that may be read-only.
        Default: those of the first call, for kernels that take tuples and records.
    """

    def __init__(self, function: Callable[..., object], signature: str | None) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self.signature = signature
        self._dispatcher: Any = None
        KERNELS.append(self)

    def __call__(self, *args: Any) -> Any:
        """Call the compiled function."""
        return (self._dispatcher or self.dispatcher(args))(*args)

    def dispatcher(self, args: tuple[Any, ...] = ()) -> Any:
        """Return numba's function, compiled if the signature is given; else for these arguments, if there are any."""
        if self._dispatcher is None:
            from drive_id.core.numerics import compilation  # noqa: PLC0415  # numba takes 0.3 s

            with compilation.interrupts_held():
                self._dispatcher = compilation.dispatcher(self.function, self.signature, args)
        return self._dispatcher

    @property
    def _numba_type_(self) -> Any:
        """Type that numba gives the kernel when another kernel calls it."""
        return self.dispatcher()._numba_type_  # numba's protocol


def compiled(signature: str | None = None) -> Callable[[Function], Function]:
    """Return the decorator that makes a function a :class:`Kernel`; the GIL is released while it runs.

    Fast-math is off, so that results do not depend on the compiler's order of summation.
    """

    def made(function: Function) -> Function:
        return cast(Function, Kernel(function, signature))

    return made
