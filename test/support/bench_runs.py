"""Short simulations of the bench along a figure that fills the disc."""

from __future__ import annotations

import numpy as np

from drive_id.bench.drive import Simulation, build_machine, simulate
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.types import MachineMap

T = 1e-4
PHASES = 2 * np.pi / 3 * np.arange(3)
IPM = machine_map("ipm")


def lissajous(i_max: float, count: int) -> np.ndarray:
    t = np.arange(count) * T
    q, d = 2 * np.pi * 3.65 * t, 2 * np.pi * 1.7 * t
    return i_max * np.stack((np.cos(q) * np.sin(d), np.sin(q)), axis=-1)


def run(count: int = 2000, source: MachineMap = IPM, **settings: object) -> Simulation:
    chosen = SimulationSettings(**settings)  # type: ignore[arg-type]
    return simulate(source, chosen, lissajous(build_machine(source, chosen).i_max, count))
