"""Compilation by numba, with the same typing, caching and flags for every kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(kernel: Kernel) -> Kernel:
    """Compile ``kernel`` at its first call, cache the machine code on disk, and release the GIL while it runs.

    Without fast-math, so that results do not depend on the compiler's order of summation.
    """
    return cast(Kernel, numba.njit(cache=True, nogil=True, error_model="numpy")(kernel))


def inlined(kernel: Kernel) -> Kernel:
    """Inline ``kernel`` into each kernel that calls it."""
    return cast(Kernel, numba.njit(inline="always", nogil=True, error_model="numpy")(kernel))
