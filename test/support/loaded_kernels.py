"""Which kernels a process has compiled, or loaded from numba's cache."""

from __future__ import annotations

from drive_id.core.numerics.compiled import KERNELS


def loaded():
    """Return every loaded kernel, as "file.function", with every tuple of argument types that it is loaded for."""
    kernels = [kernel for kernel in KERNELS if kernel._dispatcher is not None]
    return {
        (f"{kernel.__module__.rpartition('.')[2]}.{kernel.__name__}", str(types))
        for kernel in kernels
        for types in kernel.dispatcher().signatures
    }
