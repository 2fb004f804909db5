"""Whether random drives on free shafts keep below the trips of speed and current, and what a swing gone wrong does.

The drives are those of the population, with the swings planned from rough data. Each runs under the supervision of
the trajectory publisher, without processes: messages of the drive are up to 50 ms late, friction is up to 5 % of the
largest torque, and the acceleration that the publisher knows is up to 10 % wrong. The drives tell no current limit of
their own, at 1.1 times which the publisher trips as well: i_max is taken to be low enough.
"""

from __future__ import annotations

import argparse
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from population_drives import drive, on_free_shaft

from drive_id.bench.bench import MessageBlock, SimulatedBench
from drive_id.bench.drive import build_machine
from drive_id.bench.effects import largest_torque
from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.core.experiment.feedback import SampleBlock
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.state_machine import ExperimentState
from drive_id.core.experiment.supervision import Report, SupervisedExperiment
from drive_id.types import MachineMap

TICK = 10_000_000
"""Time between two blocks of the drive, ns."""
TRIP = 1.2
_SETTLING = 40
"""Ticks before the start, in which the publisher hears the drive."""
_RPM = 2 * math.pi / 60


class Cell:
    """A supervised experiment and a simulated drive, tick by tick, without processes.

    Parameters
    ----------
    machine_map : MachineMap
    drive : SimulationSettings
    settings : ExperimentSettings
    late : int
        Ticks by which messages of the drive arrive late.
    """

    def __init__(
        self, machine_map: MachineMap, drive: SimulationSettings, settings: ExperimentSettings, late: int = 0
    ) -> None:
        self.bench = SimulatedBench(machine_map, drive, BenchSettings())
        self.experiment = SupervisedExperiment(settings)
        self.now = 1_000_000_000
        self.current = self.speed = 0.0
        """Largest measured ones so far, A and rad/s."""
        self._said: deque[list[MessageBlock]] = deque([[] for _ in range(late)])

    def tick(self) -> Report:
        """Let both sides run on for a tick, and return the state."""
        steady, experiment = self.now * 1e-9, self.experiment
        blocks = self.bench.advance(self.now)
        for block in blocks:
            self.current = max(self.current, *(float(np.abs(phase).max()) for phase in block.currents))
            self.speed = max(self.speed, float(np.abs(block.resolver[1]).max()))
        self._said.append(blocks)
        for block in self._said.popleft():
            head = (block.stamp, block.first_sample, block.sample_period)
            experiment.currents(self.now, steady, SampleBlock(*head, block.currents))
            experiment.resolver(self.now, steady, SampleBlock(*head, block.resolver))
        status = self.bench.status()
        if status is not None:
            experiment.status(self.now, steady, replace(status, current_limit=math.nan))
        for made in experiment.advance(self.now, steady):
            d, q = made.i_dq.T
            session: dict[str, Any] = {"session": made.session, "count": made.count, "safe": made.safe}
            self.bench.references.add(made.stamp, made.sample_period, d, q, stator_frame=False, **session)
        self.now += TICK
        return experiment.report(self.now, steady)

    def run(self) -> Report:
        """Run one experiment to its end, and return the last state."""
        for _ in range(_SETTLING):
            self.tick()
        answer = self.experiment.start(self.now, self.now * 1e-9)
        assert answer.success, answer.message
        self.current = self.speed = 0.0
        while (report := self.tick()).state not in {ExperimentState.IDLE, ExperimentState.TRIPPED}:
            pass
        return report


@dataclass(frozen=True)
class Outcome:
    """How one drive fared: its largest speed and current, relative to those planned, and why it tripped, if it did."""

    name: str
    speed: float
    current: float
    reason: str

    @property
    def good(self) -> bool:
        """Whether nothing exceeded a trip."""
        return self.speed < TRIP and self.current < TRIP


def outcome(seed: int, number: int, seconds: float) -> Outcome | None:
    """Run one random drive; None where the plan refuses a free shaft."""
    rng = np.random.default_rng([seed, number, 2])
    one = on_free_shaft(drive(seed, number))
    if one.swing is None:
        return None
    own, swing, machine_map = one.settings[0], one.swing, one.machine.to_map("")
    machine = build_machine(machine_map, replace(own, i_max=one.i_max))
    torque = largest_torque(machine)
    inertia = own.inertia
    assert inertia is not None
    own = replace(
        own, seed=number, log_decimation=1, stamp_jitter=0.0, log_zero_sequence=False,
        current_gain=(1.0, 1.0, 1.0), coulomb_friction=torque * float(rng.uniform(0.0, 0.05)),
    )  # fmt: skip
    electrical = _RPM * machine.pole_pairs
    settings = ExperimentSettings(
        trajectory="free_shaft", i_max=one.i_max, duration=seconds, sample_period=own.sample_period,
        slew_rate=1e6 * one.i_max, speed_max=1e5, shaft_speed_max=swing.speed_max * electrical,
        shaft_acceleration=torque * machine.pole_pairs / inertia * float(rng.uniform(0.9, 1.1)),
        mean_speed=swing.mean_speed * electrical, swing_frequency=swing.frequency, amplitude=swing.amplitude,
    )  # fmt: skip
    cell = Cell(machine_map, own, settings, int(rng.integers(0, 6)))
    report = cell.run()
    reason = report.reason if report.state is ExperimentState.TRIPPED else ""
    name = f"drive {number} ({one.family})"
    return Outcome(name, cell.speed / (swing.speed_max * electrical), cell.current / one.i_max, reason)


def outcomes(seed: int, count: int, seconds: float) -> Iterator[Outcome | None]:
    """Run the first drives of the population."""
    for number in range(count):
        yield outcome(seed, number, seconds)


def main() -> None:
    """Run the drives and print those that reached a trip, and the largest speed and current of all."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each swing")
    options = parser.parse_args()
    found = []
    for one in outcomes(options.seed, options.count, options.seconds):
        if one is None:
            continue
        found.append(one)
        if one.reason or not one.good:
            said = f"{one.name}: speed {one.speed:.2f}, current {one.current:.2f} of the planned ones. {one.reason}"
            print(said, flush=True)
    good, ended = sum(one.good for one in found), sum(not one.reason for one in found)
    print(
        f"{good} of {len(found)} drives never exceeded a trip of speed or current, and {ended} ran to their end; the "
        f"largest speed was {max(x.speed for x in found):.2f} and the largest phase current "
        f"{max(x.current for x in found):.2f} of those planned. {options.count - len(found)} were refused by the plan."
    )
    raise SystemExit(good < len(found))


if __name__ == "__main__":
    main()
