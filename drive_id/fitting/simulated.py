"""Experiments on simulated machines, in memory or recorded as a bag."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drive_id.bench import drive
from drive_id.bench.drive import Simulation
from drive_id.bench.machine import default_amplitude
from drive_id.bench.machines import machine_map
from drive_id.bench.scalars import scalar_strides
from drive_id.bench.settings import SimulationSettings
from drive_id.bench.swing import Swing, simulate_swing
from drive_id.common.arguments import expect, path_of
from drive_id.common.settings import from_mapping
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.planning.settings import PlanSettings, RoughMachine
from drive_id.errors import ConfigurationError
from drive_id.files.machines.maps import read_machine
from drive_id.files.results.folder import check_absent
from drive_id.files.write.writer import write_recording
from drive_id.fitting.result import Identification, load
from drive_id.types import MachineMap, Samples

_MOST_SAMPLES = 2e7  # they are held in memory, some hundred bytes each
Inverter = Literal["none", "tanh", "dead_time", "two_stage", "switching"]


def simulate(
    machine: str | os.PathLike[str] | MachineMap | Identification = "ipm",
    seconds: float = 10.0,
    *,
    speed: float | Sequence[float] | None = None,
    inverter: Inverter | None = None,
    noise: float | None = None,
    seed: int | None = None,
    i_max: float | None = None,
    trajectory: Lissajous | Swing | None = None,
    settings: SimulationSettings | None = None,
) -> Samples:
    """Drive a simulated machine along a Lissajous trajectory, as ``drive-id simulate`` does.

    Parameters
    ----------
    machine : str, path, MachineMap or Identification
        ``ipm``, ``spm`` or ``pmsyrm``; a machine file (``.npz``, SyR-e ``.mat``); a result folder; or one in memory.
    seconds : float
        Duration, s.
    speed : float or sequence of float, optional
        Mechanical speed, rpm, or several one after the other. Default: 500.
    inverter : {"none", "tanh", "dead_time", "two_stage", "switching"}, optional
        Law of the inverter's voltage error. Default: dead_time.
    noise : float, optional
        Standard deviation of the current noise as a fraction of i_max. Default: 0.
    seed : int, optional
        Of all noise.
    i_max : float, optional
        Radius of the trajectory, A. Default: that of the machine.
    trajectory : Lissajous or Swing, optional
        A swing lets the shaft turn freely; it is the default for settings with ``free_shaft``.
    settings : SimulationSettings, optional
        All else that can be chosen.

    Returns
    -------
    Samples
        With ``truth``.

    Raises
    ------
    ConfigurationError
        When there is no such machine, or machine, settings and duration do not fit together.
    """
    options = {
        "speeds": None if speed is None else tuple(float(value) for value in np.atleast_1d(speed)),
        "inverter": inverter,
        "current_noise": noise,
        "seed": seed,
        "i_max": i_max,
    }
    given = {name: value for name, value in options.items() if value is not None}
    settings = SimulationSettings() if settings is None else settings
    expect(settings, SimulationSettings, "settings", "give drive_id.SimulationSettings(speeds=..., ...)")
    chosen = from_mapping(SimulationSettings, asdict(settings) | given, "the arguments")
    if isinstance(machine, Identification):
        found = machine.to_machine()
    elif isinstance(machine, MachineMap):
        found = machine
    else:
        found = load_machine(str(path_of(machine, "machine")))
    simulation = run_experiment(found, chosen, trajectory, seconds)
    return replace(simulation.samples, truth=simulation.truth)


def load_machine(name_or_path: str, *, pole_pairs: int | None = None, u_dc: float | None = None) -> MachineMap:
    """Return a shipped machine by name, or the one in a ``.npz`` or ``.mat`` file or in the result folder of a fit.

    Pole pairs and DC-link voltage, V, replace those of the file or result.

    Raises ConfigurationError when there is none, the file is not a machine, or the pole pairs are unknown, and
    ResultError when the result cannot be read.
    """
    path = Path(name_or_path)
    if os.path.isdir(name_or_path):  # noqa: PTH112  # never raises, whatever the name
        return load(path).to_machine(pole_pairs=pole_pairs, u_dc=u_dc)
    if path.suffix in (".npz", ".mat") or os.path.exists(path):  # noqa: PTH110
        return read_machine(path, pole_pairs=pole_pairs, u_dc=u_dc)
    known: dict[str, Any] = {"pole_pairs": pole_pairs, "u_dc": u_dc}
    return replace(machine_map(name_or_path), **{name: value for name, value in known.items() if value is not None})


def rough_settings(name_or_file: str) -> PlanSettings:
    """Return planner settings with the rough data of a machine, see :func:`load_machine`."""
    machine_map = load_machine(name_or_file)
    return PlanSettings(**asdict(RoughMachine.from_map(machine_map, default_amplitude(machine_map))))


def run_experiment(
    machine: MachineMap,
    settings: SimulationSettings,
    trajectory: Lissajous | Swing | None = None,
    seconds: float = 10.0,
) -> Simulation:
    """Drive a simulated machine along a trajectory for some seconds.

    The radius of a Lissajous figure is replaced by that of the settings or of the machine.

    Raises ConfigurationError when machine, settings and duration do not fit together.
    """
    samples = seconds / settings.sample_period
    if not 2 <= samples <= _MOST_SAMPLES:
        raise ConfigurationError(
            f"{seconds:g} s at a period of {settings.sample_period:g} s are {samples:.3g} samples: choose a duration "
            f"of between 2 and {_MOST_SAMPLES:.0e} samples."
        )
    if isinstance(trajectory, Swing) or (trajectory is None and settings.free_shaft):
        return simulate_swing(machine, replace(settings, free_shaft=True), trajectory or Swing(), seconds)
    if settings.free_shaft:
        raise ConfigurationError("A Lissajous figure would run a free shaft away: use trajectory Swing.")
    count = round(samples)
    i_max = settings.i_max or default_amplitude(machine)
    trajectory = replace(trajectory or Lissajous(), i_max=i_max)
    reference = trajectory(settings.sample_period * np.arange(count, dtype=np.float64))
    return drive.simulate(machine, settings, reference)


def simulate_bag(
    machine: MachineMap, settings: SimulationSettings, output: Path, trajectory: Lissajous | Swing, seconds: float
) -> Simulation:
    """Drive a simulated machine along a trajectory and write the recording, its ground truth attached.

    Raises OutputError when the output exists or cannot be written, and what :func:`run_experiment` raises.
    """
    check_absent(output)
    simulation = run_experiment(machine, settings, trajectory, seconds)
    samples = simulation.samples
    strides = scalar_strides(settings, samples.sample_period)
    periods = {name: stride * samples.sample_period for name, stride in strides.items()}
    write_recording(output, samples, simulation.truth, scalar_periods=periods)
    return simulation
