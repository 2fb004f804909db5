"""Compile the kernels and leave them in numba's cache: simulate, write, read and fit a recording by each method."""

from __future__ import annotations

import tempfile
from pathlib import Path

from drive_bags import TRAJECTORY

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.simulated import run_experiment
from drive_id.fitting.sources import Sources


def main():
    simulation = run_experiment(machine_map("ipm"), SimulationSettings(current_noise=1e-3), TRAJECTORY, seconds=1.0)
    run_experiment(machine_map("ipm"), SimulationSettings(flux_lag=0.01), TRAJECTORY, seconds=0.01)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        write_recording(bag, simulation.samples, simulation.truth)
        for method in ("psm", "joint", "full"):
            fit_bags(Sources([bag]), None, FitSettings(method=method))


if __name__ == "__main__":
    main()
