"""A supervised experiment and a simulated drive, tick by tick, without processes."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from drive_id.bench.bench import MessageBlock, SimulatedBench
from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.core.experiment.feedback import SampleBlock
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.state_machine import ExperimentState
from drive_id.core.experiment.supervision import Report, SupervisedExperiment
from drive_id.types import MachineMap

_SETTLING = 400_000_000  # ns before the start, in which the publisher hears the drive


class Cell:
    """The two, and the largest currents and speeds, mean speeds and references of each block.

    Messages of the drive arrive ``late`` ticks of ``tick`` ns late; without ``limited``, it tells no current limit.
    """

    def __init__(
        self, machine_map: MachineMap, drive: SimulationSettings, settings: ExperimentSettings, *,
        tick: int = 20_000_000, late: int = 0, limited: bool = True,
    ):  # fmt: skip
        self.bench = SimulatedBench(machine_map, drive, BenchSettings())
        self.settings, self.experiment = settings, SupervisedExperiment(settings)
        self.now, self._tick, self._limited = 1_000_000_000, tick, limited
        self.peaks, self.speeds, self.means, self.wanted = [], [], [], []
        self._said: deque[list[MessageBlock]] = deque([[] for _ in range(late)])

    def tick(self) -> Report:
        steady, experiment = self.now * 1e-9, self.experiment
        blocks = self.bench.advance(self.now)
        for block in blocks:
            self.peaks.append(max(np.abs(phase).max() for phase in block.currents))
            self.speeds.append(np.abs(block.resolver[1]).max())
        self._said.append(blocks)
        for block in self._said.popleft():
            head = (block.stamp, block.first_sample, block.sample_period)
            experiment.currents(self.now, steady, SampleBlock(*head, block.currents))
            experiment.resolver(self.now, steady, SampleBlock(*head, block.resolver))
        status = self.bench.status()
        if status is not None:
            experiment.status(self.now, steady, status if self._limited else replace(status, current_limit=math.nan))
        for made in experiment.advance(self.now, steady):
            d, q = made.i_dq.T
            self.wanted.append(made.i_dq)
            self.bench.references.add(
                made.stamp, made.sample_period, d, q,
                session=made.session, count=made.count, safe=made.safe, stator_frame=made.stator_frame,
            )  # fmt: skip
        report = experiment.report(self.now, steady)
        self.means.append(report.mean_speed)
        self.now += self._tick
        return report

    def run(self) -> Report:
        """Run one experiment to its end, and return the last state."""
        for _ in range(_SETTLING // self._tick):
            self.tick()
        answer = self.experiment.start(self.now, self.now * 1e-9)
        assert answer.success, answer.message
        self.peaks, self.speeds, self.means = [], [], []
        while (report := self.tick()).state not in {ExperimentState.IDLE, ExperimentState.TRIPPED}:
            pass
        return report
