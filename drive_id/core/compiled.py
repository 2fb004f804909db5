"""The one place that meets numba, so that typing, caching and flags are the same for every kernel.

Without numba the kernels run all the same, with the same numbers: as the Python that they are, or, where that would
take minutes, by a vectorized twin of the same signature.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

try:
    import numba
except ImportError:  # no wheel for this machine or Python yet
    numba = None  # type: ignore[assignment]

Kernel = TypeVar("Kernel", bound=Callable[..., object])

COMPILING: bool = numba is not None
"""Whether kernels are compiled."""


def compiled(kernel: Kernel) -> Kernel:
    """Compile ``kernel`` at its first call, keep the machine code on disk, and release the GIL while it runs.

    No fast-math: results must not depend on the order in which a compiler likes to sum.
    """
    if numba is None:
        return kernel
    return cast(Kernel, numba.njit(cache=True, nogil=True, error_model="numpy")(kernel))


def inlined(kernel: Kernel) -> Kernel:
    """Compile ``kernel`` as a part of each kernel that calls it, so that calling it costs nothing."""
    if numba is None:
        return kernel
    return cast(Kernel, numba.njit(inline="always", nogil=True, error_model="numpy")(kernel))


def compiled_or(twin: Kernel) -> Callable[[Kernel], Kernel]:
    """Compile a kernel, or put ``twin`` in its place where there is no numba."""
    return compiled if COMPILING else lambda _: twin
