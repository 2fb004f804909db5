"""One simulated experiment for all tests that need a recording: made once, and short."""

from __future__ import annotations

import os

import hypothesis
import pytest
from drive_bags import TRAJECTORY

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.files.write.writer import write_recording
from drive_id.fitting.simulated import run_experiment
from drive_id.fitting.workflows import fit_bags

# Tests are not timed: the machine may be busy. The examples are the same each time, so that a push is judged by what it
# changed; to look for others: DRIVE_ID_EXPLORE=1 make test ARGS="-m hypothesis"
hypothesis.settings.register_profile("drive_id", deadline=None, derandomize="DRIVE_ID_EXPLORE" not in os.environ)
hypothesis.settings.load_profile("drive_id")


@pytest.fixture(scope="session")
def simulation():
    """The ipm machine for 2 s at 10 kHz and 500 rpm, with harmonics, noise and an uncompensated inverter."""
    return run_experiment(machine_map("ipm"), SimulationSettings(current_noise=1e-3), TRAJECTORY, seconds=2.0)


@pytest.fixture(scope="session")
def bag(simulation, tmp_path_factory):
    """Its recording; read only."""
    path = tmp_path_factory.mktemp("recorded") / "bag"
    write_recording(path, simulation.samples, simulation.truth)
    return path


@pytest.fixture(scope="session")
def fitted(bag):
    """Its fit, nothing written."""
    return fit_bags([bag], None, FitSettings(method="joint"))
