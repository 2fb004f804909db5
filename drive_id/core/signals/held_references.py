"""Current references at the instants of the samples: each is held until the next one."""

from __future__ import annotations

import numpy as np

from drive_id.core.numerics.scans import all_finite, rising
from drive_id.core.signals.signal import Signal, finite_rows
from drive_id.types import FloatArray, IntArray


class HeldReferences:
    """References as they arrive, ahead of time or late, without those that are past.

    Each is held for at most 1.5 times their period, s; None: that of the samples.
    """

    def __init__(self, period: float | None) -> None:
        self._period = period
        self._stamp: IntArray = np.zeros(0, np.int64)
        self._values: FloatArray = np.zeros((0, 2))

    def add(self, piece: Signal) -> None:
        """Take further references; they replace those due at or after their first stamp."""
        stamp, values = piece.stamp, piece.values
        if not all_finite(values):
            known = finite_rows(values)
            stamp, values = stamp[known], values[known]
        if not len(stamp):
            return
        if not rising(stamp):
            stands = np.append(stamp[:-1] < np.minimum.accumulate(stamp[::-1])[::-1][1:], True)
            stamp, values = stamp[stands], values[stands]
        kept = int(np.searchsorted(self._stamp, stamp[0]))
        self._stamp = np.concatenate([self._stamp[:kept], stamp])
        self._values = np.concatenate([self._values[:kept], values])

    def at(self, stamp: IntArray, period: float) -> FloatArray | None:
        """Return the references (N, 2), A, valid at increasing stamps (N,), ns, and forget those before the last stamp.

        A reference may come late by a tenth of the period of the samples, s. NaN where there are none; None as long as
        there were none at all.
        """
        if not len(self._stamp):
            return None
        late = int(0.1e9 * period)
        index = np.searchsorted(self._stamp, stamp + late, side="right") - 1
        first = np.maximum(index, 0)
        valid = (index >= 0) & (stamp - self._stamp[first] <= 1.5e9 * (self._period or period))
        values = self._values[first]
        values[~valid] = np.nan
        past = int(first[-1])
        self._stamp, self._values = self._stamp[past:], self._values[past:]
        return values
