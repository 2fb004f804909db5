"""What a drive tells its supervisor, and what was told to the drive."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drive_id.core.experiment.state_machine import ReferenceBlock
from drive_id.types import NANOSECONDS, FloatArray, IntArray

_KEPT = NANOSECONDS  # age of references that feedback may still belong to, ns: twice what a drive is ever late


@dataclass(frozen=True, eq=False)
class SampleBlock:
    """A block of measured samples."""

    stamp: int  # of the first sample, ns, by the clock of the drive
    first_sample: int  # running count
    sample_period: float  # s
    values: tuple[NDArray[np.float32], ...]
    """(N,) each: phase currents, A; or angle, rad, and electrical speed, rad/s; or an optional signal."""

    def __len__(self) -> int:
        return len(self.values[0])

    @property
    def end(self) -> int:
        """Time when the block was complete, ns."""
        return self.stamp + round(len(self) * self.sample_period * NANOSECONDS)


@dataclass(frozen=True)
class DriveStatus:
    """What a drive says of itself; the fields of the message ``DriveStatus``, NaN where the drive does not know."""

    stamp: int  # ns, by the clock of the drive
    count: int
    enabled: bool = True
    fault: str = ""
    session: int = 0
    applied: int = 0
    i_d: float = 0.0  # reference in force, A
    i_q: float = 0.0
    speed: float = np.nan  # electrical, rad/s
    dc_link_voltage: float = np.nan  # V
    winding_temperature: float = np.nan  # degC
    magnet_temperature: float = np.nan
    current_limit: float = np.nan  # A
    speed_limit: float = np.nan  # rad/s
    dc_link_voltage_limit: float = np.nan  # V
    winding_temperature_limit: float = np.nan  # degC


class PublishedReferences:
    """The references of the last second and of the time ahead, to compare with what the drive measures."""

    def __init__(self) -> None:
        self.session = 0
        self._due: IntArray = np.zeros(0, np.int64)
        self._values: FloatArray = np.zeros((0, 2))
        self._last = 0
        self.hold = True
        """False from a safe block on: the drive is then somewhere between the references and zero."""
        self.stator_frame = False

    def add(self, blocks: Iterable[ReferenceBlock], now: int) -> None:
        """Add blocks that are published at ``now``, ns."""
        for block in blocks:
            self.session, self.hold, self.stator_frame = block.session, not block.safe, block.stator_frame
            self._last = round(2 * block.sample_period * NANOSECONDS)
            old, kept = np.searchsorted(self._due, (now - _KEPT, block.stamp))
            self._due = np.concatenate((self._due[old : max(kept, old)], block.due))
            self._values = np.concatenate((self._values[old : max(kept, old)], block.i_dq.astype(np.float64)))

    def at(self, stamps: IntArray) -> tuple[FloatArray, bool]:
        """Return the references (N, 2), A, at times (N,), ns, and whether set-points are due at all of them."""
        index = np.searchsorted(self._due, stamps, side="right") - 1
        known = index >= 0
        known[known] = stamps[known] - self._due[index[known]] <= self._last
        values = np.zeros((len(stamps), 2))
        values[known] = self._values[index[known]]
        return values, bool(known.all())
