"""Compile all kernels in advance, on all cores: ``python -m drive_id.fitting.kernels``, called by ``make setup``.

Kernels in the cache are not compiled again. Without this step, each kernel is compiled at its first call.
"""

from __future__ import annotations

import os

import numpy as np

from drive_id.bench.drive import simulate
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.methods.full import FullMethod  # noqa: F401  # registers its kernels
from drive_id.core.numerics.compiled import KERNELS
from drive_id.fitting.fit import fit_bags  # noqa: F401  # likewise
from drive_id.fitting.processes import processes

_FIRST = ("drive_id.core.paper", "drive_id.core.numerics", "drive_id.core.maps", "drive_id.core.full")
"""Modules whose kernels take about half of the compile time of a fit."""


def compile_part(name: str) -> None:
    """Compile one part: the simulated drive, by running it, or one half of the kernels of a fit."""
    if name == "drive":
        simulate(machine_map("ipm"), SimulationSettings(), np.zeros((10, 2)))  # its kernels take tuples and records
    else:
        for kernel in KERNELS:
            if kernel.signature is not None and kernel.__module__.startswith(_FIRST) == (name == "first half"):
                kernel.dispatcher()


def main() -> None:
    """Compile all parts, the longest ones first."""
    with processes(os.cpu_count() or 1) as executor:
        list(executor.map(compile_part, ("drive", "first half", "second half")))


if __name__ == "__main__":
    main()
