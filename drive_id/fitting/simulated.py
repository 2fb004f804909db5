"""Experiments on simulated machines: driven in memory, or recorded as a bag."""

from __future__ import annotations

import os
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from drive_id.bench.drive import Simulation, simulate
from drive_id.bench.machine import default_amplitude
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.planning.settings import PlanSettings, RoughMachine
from drive_id.errors import ConfigurationError
from drive_id.files.machines.maps import read_machine
from drive_id.files.results.folder import check_absent
from drive_id.files.write.writer import write_recording
from drive_id.types import MachineMap

_MOST_SAMPLES = 2e7


def load_machine(name_or_file: str) -> MachineMap:
    """Return a shipped machine by name or read one from a ``.npz`` or ``.mat`` file.

    Raises
    ------
    ConfigurationError
        When there is none, or the file is not a machine.
    """
    path = Path(name_or_file)
    is_file = path.suffix in (".npz", ".mat") or os.path.exists(path)  # noqa: PTH110  # never raises, whatever the name
    return read_machine(path) if is_file else machine_map(name_or_file)


def rough_settings(name_or_file: str) -> PlanSettings:
    """Return settings of a plan with the rough data of a machine, see :func:`load_machine`."""
    machine_map = load_machine(name_or_file)
    return PlanSettings(**asdict(RoughMachine.from_map(machine_map, default_amplitude(machine_map))))


def run_experiment(
    machine: MachineMap, settings: SimulationSettings, trajectory: Lissajous | None = None, seconds: float = 10.0
) -> Simulation:
    """Drive a simulated machine along a trajectory.

    Parameters
    ----------
    machine : MachineMap
    settings : SimulationSettings
    trajectory : Lissajous, optional
        Its radius gives way to that of the settings or of the machine.
    seconds : float
        Duration, s.

    Raises
    ------
    ConfigurationError
        When machine, settings and duration do not make an experiment.
    """
    samples = seconds / settings.sample_period
    if not 2 <= samples <= _MOST_SAMPLES:
        raise ConfigurationError(
            f"{seconds:g} s at a period of {settings.sample_period:g} s make {samples:.3g} samples: choose a duration "
            f"that makes between 2 and {_MOST_SAMPLES:.0e}."
        )
    count = round(samples)
    i_max = settings.i_max or default_amplitude(machine)
    trajectory = replace(trajectory or Lissajous(), i_max=i_max)
    reference = trajectory(settings.sample_period * np.arange(count, dtype=np.float64))
    return simulate(machine, settings, reference)


def simulate_bag(
    machine: MachineMap, settings: SimulationSettings, output: Path, trajectory: Lissajous, seconds: float
) -> Simulation:
    """Drive a simulated machine along a trajectory and write the recording, its ground truth attached.

    Raises
    ------
    OutputError
        When the output exists or cannot be written.
    ConfigurationError
        When machine, settings and trajectory do not fit together.
    """
    check_absent(output)
    simulation = run_experiment(machine, settings, trajectory, seconds)
    write_recording(output, simulation.samples, simulation.truth)
    return simulation
