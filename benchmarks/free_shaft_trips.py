"""Whether random drives on free shafts keep below the trips of speed and current, and what a swing gone wrong does.

The drives are those of the population, with the swings planned from rough data. Each runs under the supervision of
the trajectory publisher, without processes: messages of the drive are up to 50 ms late, friction is up to 5 % of the
largest torque, and the acceleration that the publisher knows is up to 10 % wrong. The drives tell no current limit of
their own, at 1.1 times which the publisher trips as well: i_max is taken to be low enough.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np
from population_drives import drive, on_free_shaft

from drive_id.bench.drive import build_machine
from drive_id.bench.effects import largest_torque
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.state_machine import ExperimentState

_TICK = 10_000_000
"""Time between two blocks of the drive, ns."""
TRIP = 1.2
sys.path.insert(0, str(Path(__file__).parent.parent / "test" / "support"))  # the cell that tests use as well
_RPM = 2 * math.pi / 60


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
    late = int(rng.integers(0, 6))
    cell = import_module("supervised_cell").Cell(machine_map, own, settings, tick=_TICK, late=late, limited=False)
    report = cell.run()
    reason = report.reason if report.state is ExperimentState.TRIPPED else ""
    name = f"drive {number} ({one.family})"
    return Outcome(
        name, float(max(cell.speeds)) / (swing.speed_max * electrical), float(max(cell.peaks)) / one.i_max, reason
    )


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
