"""The largest values of a stream of any length with companion values: exact quantiles near the top."""

from __future__ import annotations

import copy

import numpy as np

from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray

KEPT = 1 << 17
"""Values kept: the usual quantile is exact for up to 1000 times as many."""
USUAL_QUANTILE = 0.999
"""Share of the samples below what is usually the largest: single disturbed samples lie above."""


class Largest:
    """Keeps the largest values of a stream with their companions, and the range of all other companions.

    Parameters
    ----------
    companions : int
        Number of companions of each value.
    """

    def __init__(self, companions: int, kept: int = KEPT) -> None:
        self.count = 0
        self.low: FloatArray = np.full(companions, np.inf)
        """Smallest companions of the values not kept."""
        self.high: FloatArray = np.full(companions, -np.inf)
        self._kept = kept
        self._rows: FloatArray = np.empty((0, 1 + companions))
        self._waiting: list[FloatArray] = []
        self._waiting_count = 0
        self._floor = -np.inf  # smaller values are not among the largest

    def add(self, rows: FloatArray) -> None:
        """Add values, (N, 1 + companions) with the value first."""
        self.count += len(rows)
        candidates = np.empty_like(rows)
        found = _divide(rows, self._floor, candidates, self.low, self.high)
        self._waiting.append(candidates[:found].copy())
        self._waiting_count += found
        if self._waiting_count > self._kept:
            self._settle()

    def rows(self) -> FloatArray:
        """Return the largest values with their companions, (K, 1 + companions), in order of arrival."""
        self._settle()
        return self._rows

    def quantile(self, share: float = USUAL_QUANTILE) -> float:
        """Return the quantile as numpy interpolates it; the least value that is kept where it lies below."""
        return top_quantile(self.rows()[:, 0], self.count, share)

    def copy(self) -> Largest:
        """Return an independent copy."""
        other = copy.copy(self)
        other.low, other.high, other._waiting = self.low.copy(), self.high.copy(), list(self._waiting)  # noqa: SLF001
        return other

    def _settle(self) -> None:
        rows = np.concatenate([self._rows, *self._waiting])
        self._waiting, self._waiting_count = [], 0
        if len(rows) > self._kept:
            self._floor = float(np.partition(rows[:, 0], len(rows) - self._kept)[len(rows) - self._kept])
            largest = rows[:, 0] > self._floor
            largest[np.flatnonzero(rows[:, 0] == self._floor)[: self._kept - largest.sum()]] = True
            out, rows = rows[~largest], rows[largest]
            self.low = np.minimum(self.low, [column.min() for column in out[:, 1:].T])
            self.high = np.maximum(self.high, [column.max() for column in out[:, 1:].T])
        self._rows = rows


def top_quantile(largest: FloatArray, count: int, share: float) -> float:
    """Return a quantile of ``count`` values of which only the largest (K,) are known, the least of these if below."""
    at = share * (count - 1) - (count - len(largest))
    if at <= 0.0:
        return float(largest.min())
    below = int(at)
    above = min(below + 1, len(largest) - 1)
    low, high = np.partition(largest, (below, above))[[below, above]]
    return float(low + (at - below) * (high - low))


@compiled("const f8[:, ::1], f8, f8[:, ::1], f8[::1], f8[::1]")
def _divide(rows: FloatArray, floor: float, candidates: FloatArray, low: FloatArray, high: FloatArray) -> int:
    """Copy the rows (N, C) whose value reaches the floor, and extend the range of the companions by the others."""
    found = 0
    for k in range(len(rows)):
        if rows[k, 0] >= floor:
            for j in range(rows.shape[1]):
                candidates[found, j] = rows[k, j]
            found += 1
        else:
            for j in range(len(low)):
                low[j] = min(low[j], rows[k, 1 + j])
                high[j] = max(high[j], rows[k, 1 + j])
    return found
