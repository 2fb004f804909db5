"""A free shaft in the simulation without ROS: the figure of ``free_shaft`` with its slow feedback of the mean speed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drive_id.bench.drive import Drive, SimulatedBlock, Simulation, build_machine
from drive_id.bench.effects import largest_torque, shaft_of
from drive_id.bench.settings import SimulationSettings
from drive_id.common.settings import Checked, setting
from drive_id.core.experiment.free_shaft import FASTEST_SWING, FreeShaft, SpeedFeedback, swing_frequency
from drive_id.errors import ConfigurationError
from drive_id.types import MachineMap, Samples

_TICK = 0.01  # s, at which the feedback acts
_LATENCY = 2  # ticks from a measurement to its effect
_RPM = 2 * np.pi / 60  # rad/s


@dataclass(frozen=True)
class Swing(Checked):
    """What a free shaft does in a simulation."""

    speed_max: float = setting(1500.0, "Highest mechanical speed planned, either way", unit="rpm", minimum=1.0)
    mean_speed: float = setting(0.0, "Mean mechanical speed", unit="rpm")
    frequency: float | None = setting(
        None, "Of i_q; default: so that the swing takes 85 % of the speeds", unit="Hz", minimum=0.1, maximum=1e3
    )
    amplitude: float = setting(0.95, "Relative to i_max", minimum=1e-3, maximum=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if abs(self.mean_speed) >= self.speed_max:
            raise ConfigurationError(
                f"mean_speed is {self.mean_speed:g} rpm: it must be below speed_max, {self.speed_max:g} rpm."
            )


def simulate_swing(machine_map: MachineMap, settings: SimulationSettings, swing: Swing, seconds: float) -> Simulation:
    """Let a simulated drive with ``free_shaft`` swing its shaft for whole periods, together at least ``seconds``.

    Raises ConfigurationError when machine and settings do not make an experiment.
    """
    machine = build_machine(machine_map, settings)
    acceleration = swing.amplitude * largest_torque(machine) * machine.pole_pairs / shaft_of(machine, settings).inertia
    electrical = _RPM * machine.pole_pairs
    mean_speed = swing.mean_speed * electrical
    wanted = swing.frequency or swing_frequency(acceleration, swing.speed_max * electrical, mean_speed)
    frequency = swing.frequency or min(wanted, FASTEST_SWING)
    reduced = min(1.0, frequency / wanted)  # a light rotor swings at the highest frequency with less current
    figure = FreeShaft(reduced * swing.amplitude * machine.i_max, frequency, seconds)
    feedback = SpeedFeedback(frequency, reduced * acceleration, mean_speed, _LATENCY * _TICK)
    drive = Drive(machine, settings)
    period = settings.sample_period
    size, count = max(1, round(_TICK / period)), round(figure.duration / period)
    biases = [0.0] * (_LATENCY + 1)
    blocks: list[SimulatedBlock] = []
    logged = 0
    for first in range(0, count, size):
        length = min(size, count - first)
        t = period * np.arange(first, first + length, dtype=np.float64)
        bias = np.linspace(biases[-_LATENCY - 1], biases[-_LATENCY], length, endpoint=False)
        block = drive.step_block(figure(t, bias))
        active = figure.ramp_time < t[0] < figure.duration - figure.ramp_time
        feedback.add(logged, block.samples.sample_period, block.samples.angle, active=active)
        logged += len(block.samples)
        biases.append(feedback.bias)
        blocks.append(block)
    samples = replace(Samples.joined([block.samples for block in blocks]), run_starts=np.zeros(1, np.int64))
    i_dq, angle = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("i_dq_true", "angle_true"))
    courses = [block.course for block in blocks if block.course is not None]
    course = np.concatenate(courses).view(np.recarray)
    return Simulation(
        samples=samples, i_dq_true=i_dq, angle_true=angle, course=course, truth=drive.truth(), machine=machine
    )
