"""The one place that meets numba, so that typing, caching and flags are the same for every kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(kernel: Kernel) -> Kernel:
    """Compile ``kernel`` at its first call, keep the machine code on disk, and release the GIL while it runs.

    No fast-math: results must not depend on the order in which a compiler likes to sum.
    """
    return cast(Kernel, numba.njit(cache=True, nogil=True, error_model="numpy")(kernel))


def inlined(kernel: Kernel) -> Kernel:
    """Compile ``kernel`` as a part of each kernel that calls it, so that calling it costs nothing."""
    return cast(Kernel, numba.njit(inline="always", nogil=True, error_model="numpy")(kernel))
