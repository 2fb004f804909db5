"""The drive's buffer of current references: holds, replaces and limits them, and goes to zero when they run out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drive_id.core.experiment.limits import approach
from drive_id.core.signals.signal import finite_rows
from drive_id.types import BoolArray, FloatArray, IntArray

NANOSECONDS = 1_000_000_000
_LARGEST = 5_000_000  # set-points in the buffer
_EARLY = 0.1  # sample periods by which a set-point may come due after the sample that takes it
_HOLD = 1.5  # periods for which the last set-point is held before the current goes to zero


@dataclass
class ReferenceCounts:
    """Set-points that arrived too late, were rejected, or were limited to the disc."""

    late: int = 0
    unusable: int = 0
    limited: int = 0


class ReferenceBuffer:
    """Set-points until they come due.

    Parameters
    ----------
    i_max : float
        Largest amplitude that the drive follows, A.
    slew_rate : float
        |di/dt| to zero current when set-points run out, A/s.
    """

    def __init__(self, i_max: float, slew_rate: float) -> None:
        self.counts = ReferenceCounts()
        self.dry = True
        self._i_max = i_max
        self._slew_rate = slew_rate
        self._due: IntArray = np.zeros(0, np.int64)
        self._hold: IntArray = np.zeros(0, np.int64)
        self._values: FloatArray = np.zeros((0, 2))
        self._last = np.zeros(2)
        self._taken: int | None = None

    def __len__(self) -> int:
        return len(self._due)

    def add(self, stamp: int, sample_period: float, d: NDArray[np.float32], q: NDArray[np.float32]) -> None:
        """Add a block of set-points, which replaces all due at or after its stamp.

        Parameters
        ----------
        stamp : int
            Due time of the first, ns.
        sample_period : float
            s.
        d, q : (N,) float32
            A. Malformed blocks are counted and rejected.
        """
        if len(d) != len(q) or not 1e-9 <= sample_period <= 1e3 or len(d) + len(self) > _LARGEST:
            self.counts.unusable += max(len(d), len(q), 1)
            return
        values = np.stack((d, q), axis=-1).astype(np.float64)
        if not finite_rows(values).all():
            self.counts.unusable += len(values)
            return
        due = stamp + np.round(np.arange(len(values)) * (sample_period * NANOSECONDS)).astype(np.int64)
        if self._taken is not None:
            self.counts.late += int(np.searchsorted(due, self._taken, side="right"))
        kept = int(np.searchsorted(self._due, stamp))
        hold = np.full(len(due), round(_HOLD * sample_period * NANOSECONDS), np.int64)
        self._due = np.concatenate((self._due[:kept], due))
        self._hold = np.concatenate((self._hold[:kept], hold))
        self._values = np.concatenate((self._values[:kept], self._limited(values)))

    def take(self, stamps: IntArray, sample_period: float) -> FloatArray:
        """Return the references (N, 2), A, at the next samples (N,), ns, ``sample_period``, s, apart."""
        out = np.zeros((len(stamps), 2))
        step = self._slew_rate * sample_period
        index = np.searchsorted(self._due, stamps + round(_EARLY * sample_period * NANOSECONDS), side="right") - 1
        known = index >= 0
        known[known] = stamps[known] - self._due[index[known]] <= self._hold[index[known]]
        for start, end in _runs(known):
            if known[start]:
                out[start:end] = self._values[index[start:end]]
            else:
                ramp = approach(self._last, np.zeros(2), step, end - start)
                out[start : start + len(ramp)] = ramp
            self._last = out[end - 1].copy()
        self.dry = not bool(known[-1])
        self._taken = int(stamps[-1])
        done = max(int(index[-1]), 0)
        self._due, self._hold, self._values = self._due[done:], self._hold[done:], self._values[done:]
        return out

    def _limited(self, values: FloatArray) -> FloatArray:
        amplitude = np.hypot(values[:, 0], values[:, 1])
        beyond = amplitude > self._i_max * (1 + 1e-6)
        if beyond.any():
            self.counts.limited += int(beyond.sum())
            values[beyond] *= (self._i_max / amplitude[beyond])[:, None]
        return values


def _runs(known: BoolArray) -> list[tuple[int, int]]:
    """Return begin and end of each run of equal values."""
    edges = np.flatnonzero(np.diff(known)) + 1
    return list(zip([0, *edges.tolist()], [*edges.tolist(), len(known)], strict=True))
