"""The one place that meets numba, so that typing, caching and flags are the same for every kernel.

Without numba the kernels run all the same, with the same numbers: as the Python that they are, or, where that would
take minutes, by a vectorized twin of the same signature.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TypeVar, cast

try:
    import numba
except ImportError:  # no wheel for this machine or Python yet
    numba = None  # type: ignore[assignment]

Kernel = TypeVar("Kernel", bound=Callable[..., object])

_LINEAR_ALGEBRA = "scipy.linalg.cython_blas"

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


@compiled
def _nothing() -> None:
    """Do nothing, compiled."""


def start_without_linear_algebra() -> None:
    """Let numba get ready without scipy.linalg: none of our kernels needs it, and its import takes longer than a fit.

    For processes of our own alone: to numba, ``cov`` and ``corrcoef`` remain unknown in this one.
    """
    if not COMPILING or _LINEAR_ALGEBRA in sys.modules:
        return
    sys.modules[_LINEAR_ALGEBRA] = None  # type: ignore[assignment]  # so that importing it says that there is none
    try:
        _nothing()  # with the first kernel numba loads all that it knows
    finally:
        del sys.modules[_LINEAR_ALGEBRA]
