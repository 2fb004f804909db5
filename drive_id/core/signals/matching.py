"""Find for each sample its partner in another signal: the same instant, up to a constant offset below half a period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.core.numerics.compiled import compiled
from drive_id.errors import DataError
from drive_id.types import BoolArray, IntArray

_LEAST_DIRECTION = 0.5  # length of the mean unit vector: 1 for a constant offset, 0 for one that wanders over a period
_LARGEST_OFFSET = 0.45  # in sample periods: at half of one, the order is a guess


def nearest(clock: IntArray, stamp: IntArray) -> IntArray:
    """Index of the entry of ``stamp`` (M,), increasing, nearest to each entry of ``clock`` (N,)."""
    right = np.clip(np.searchsorted(stamp, clock), 0, len(stamp) - 1)
    left = np.maximum(right - 1, 0)
    closer: IntArray = np.where(np.abs(stamp[left] - clock) <= np.abs(stamp[right] - clock), left, right)
    return closer


@compiled("const i8[::1], const i8[::1], i8")
def _walk(clock: IntArray, stamp: IntArray, offset: int) -> IntArray:
    """Return what :func:`nearest` does (N,), for an increasing clock (N,) that is shifted by ``offset`` ns."""
    index, right, last = np.empty(len(clock), np.int64), 0, len(stamp) - 1
    for k in range(len(clock)):
        wanted = clock[k] + offset
        while right < last and stamp[right] < wanted:
            right += 1
        left = max(right - 1, 0)
        index[k] = left if abs(stamp[left] - wanted) <= abs(stamp[right] - wanted) else right
    return index


@dataclass(frozen=True)
class Phase:
    """Circular mean of the offset of a signal's stamps from those of the clock, over one sample period."""

    total: complex = 0j  # sum of unit vectors
    count: int = 0  # pairs of samples within one period of each other

    @classmethod
    def of(cls, clock: IntArray, stamp: IntArray, step: float) -> Phase:
        """Measure the phase of ``stamp`` (M,), increasing, on ``clock`` (N,), ns, of period ``step``, ns."""
        if not len(clock) or not len(stamp):
            return cls()
        away = stamp[_walk(clock, stamp, 0)] - clock
        away = away[np.abs(away) <= step]
        same = len(away) > 1 and away.min() == away.max()
        directions = np.exp(2j * np.pi * (away[:1] if same else away) / step)
        return cls(complex(len(away) * directions[0] if same else directions.sum()), len(away))

    def __add__(self, other: Phase) -> Phase:
        return Phase(self.total + other.total, self.count + other.count)

    def offset(self, step: float, name: str, clock_name: str) -> int:
        """Return the constant offset of the stamps, ns, for a sample period ``step``, ns; the names are for messages.

        Raises DataError when the offset is not constant, or about half a period.
        """
        if not self.count:
            return 0
        direction = self.total / self.count
        names = f"the stamps of {name} and {clock_name}"
        if abs(direction) < _LEAST_DIRECTION:
            raise DataError(
                f"The offset between {names} wanders by more than a sample period: stamp both with one clock, or take "
                "another stamp source in a signals file."
            )
        offset = int(np.rint(np.angle(direction) / (2 * np.pi) * step))
        if abs(offset) > _LARGEST_OFFSET * step:
            raise DataError(
                f"Between {names} lies half a sample period ({offset * 1e-3:.1f} us), so that their order is a guess: "
                "give the true stamp_offset in a signals file."
            )
        return offset


def partners(
    clock: IntArray, stamp: IntArray, offset: int, step: float, taken: int | None = None
) -> tuple[IntArray, BoolArray]:
    """Find the partner of each sample of the clock; none serves two samples.

    Parameters
    ----------
    clock, stamp : (N,), (M,) int64
        ns, increasing.
    offset, step : int, float
        Of ``stamp`` from the clock, and sample period, ns.
    taken : int, optional
        Stamp of the last partner of an earlier part of the clock, which must not serve again.

    Returns
    -------
    (N,) int64, (N,) bool
        Index into ``stamp``, and where it is valid.
    """
    if not len(clock) or not len(stamp):
        return np.zeros(len(clock), np.int64), np.zeros(len(clock), np.bool_)
    index = _walk(clock, stamp, offset)
    found = np.abs(stamp[index] - clock - offset) <= 0.5 * step
    candidates = np.flatnonzero(found)
    found[candidates[1:][np.diff(index[candidates]) == 0]] = False
    if taken is not None and len(candidates) and int(stamp[index[candidates[0]]]) == taken:
        found[candidates[0]] = False
    return index, found
