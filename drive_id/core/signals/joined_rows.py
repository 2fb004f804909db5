"""Samples that have found their partners and are not handed on yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class JoinedRows:
    """Joined samples that are not handed on yet: stamps (N,), currents and voltages (N, 3), angle and speed (N, 2)."""

    stamp: IntArray
    i_abc: FloatArray
    u_abc: FloatArray
    position: FloatArray

    @classmethod
    def none(cls) -> JoinedRows:
        """Return no samples."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))

    def __len__(self) -> int:
        return len(self.stamp)

    def __getitem__(self, part: slice | IntArray) -> JoinedRows:
        return JoinedRows(self.stamp[part], self.i_abc[part], self.u_abc[part], self.position[part])

    def before(self, other: JoinedRows) -> JoinedRows:
        """Return these samples and others behind them."""
        if not len(self):
            return other
        return JoinedRows(
            np.concatenate([self.stamp, other.stamp]),
            np.concatenate([self.i_abc, other.i_abc]),
            np.concatenate([self.u_abc, other.u_abc]),
            np.concatenate([self.position, other.position]),
        )


def derived_speed(angle: FloatArray, starts: IntArray, period: float) -> FloatArray:
    """Differentiate the angle (N,) within each run by central differences, rad/s."""
    speed = np.empty_like(angle)
    with np.errstate(over="ignore", invalid="ignore"):  # absurd angles give infinite speeds, which Samples refuses
        for start, end in zip(starts, np.append(starts[1:], len(angle)), strict=True):
            speed[start:end] = np.gradient(np.unwrap(angle[start:end]), period)
    return speed
