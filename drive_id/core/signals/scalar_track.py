"""One optional signal as it arrives, of any rate, interpolated onto the samples of the currents."""

from __future__ import annotations

import copy

import numpy as np

from drive_id.core.signals.signal import Signal
from drive_id.types import FloatArray, IntArray

SHORTEST_REACH = 2.0
"""Least time for which a value is held where the signal begins, ends or has a gap, s."""
_REACH_PERIODS = 3  # of the signal for which a value is held


class ScalarTrack:
    """The recent past of an optional signal, and what has arrived ahead of the currents.

    Between two samples of the signal that are at most :attr:`reach` apart, it is interpolated linearly; elsewhere, the
    nearest one is held for up to that time. Beyond, the signal is unknown. A period that is not declared is the time
    between the first two samples.

    Parameters
    ----------
    name : str
        Topic, for messages.
    capacity : int
        Most samples to keep that lie ahead of the currents.

    Attributes
    ----------
    late : bool
        Samples arrived that would have changed values that were given out before.
    unknown : int
        Samples for which the signal is unknown; counted by its user.
    """

    def __init__(self, name: str, capacity: int) -> None:
        self.name = name
        self.late = False
        self.unknown = 0
        self._capacity = capacity
        self._period: float | None = None
        self._stamp: IntArray = np.zeros(0, np.int64)
        self._values: FloatArray = np.zeros(0)
        self._latest: int | None = None
        self._firsts: tuple[int, ...] = ()  # stamps from which a period that is not declared is taken
        self._given_up: int | None = None  # last stamp answered without waiting for the next sample of the signal

    @property
    def reach(self) -> int:
        """Time for which a value is held, ns: three periods of the signal, at least 2 s."""
        return round(1e9 * max(_REACH_PERIODS * (self._period or 0.0), SHORTEST_REACH))

    def copy(self) -> ScalarTrack:
        """Return an independent copy."""
        return copy.copy(self)  # the arrays are replaced, never changed

    def add(self, piece: Signal) -> None:
        """Take what arrived; samples that are not finite or out of order are dropped."""
        if self._period is None:
            self._period = piece.sample_period
        stamp, values = piece.stamp, piece.values[:, 0]
        if len(stamp):
            before = np.maximum.accumulate(np.append(stamp[0] - 1 if self._latest is None else self._latest, stamp))
            kept = (stamp > before[:-1]) & np.isfinite(values)
            stamp, values = stamp[kept], values[kept]
        if not len(stamp):
            return
        if self._period is None:
            firsts = [*self._firsts, *stamp[:2].tolist()][:2]
            self._firsts = tuple(firsts)
            self._period = (firsts[1] - firsts[0]) * 1e-9 if len(firsts) > 1 else None
        if self._given_up is not None and int(stamp[0]) <= self._given_up + self.reach:
            self.late = True
        self._latest = int(stamp[-1])
        stamp, values = np.append(self._stamp, stamp), np.append(self._values, values)
        self.late |= len(stamp) > self._capacity
        self._stamp, self._values = stamp[-self._capacity :], values[-self._capacity :]

    def decided(self, newest: int) -> int:
        """Return the stamp, ns, up to which nothing that may still arrive can change the signal.

        What is older than the newest sample of the currents, ns, by twice the reach has waited long enough.
        """
        overdue = newest - 2 * self.reach
        return overdue if self._latest is None or self._period is None else max(self._latest, overdue)

    def at(self, stamp: IntArray) -> FloatArray:
        """Return the signal (N,) at increasing stamps (N,), ns, NaN where unknown, and forget what is past."""
        if self._latest is None or self._period is None or int(stamp[-1]) > self._latest:
            self._given_up = int(stamp[-1])
        begin = int(np.searchsorted(self._stamp, stamp[0]))
        if np.array_equal(self._stamp[begin : begin + len(stamp)], stamp):  # sampled with the currents
            found: FloatArray = self._values[begin : begin + len(stamp)].copy()
            past = begin + len(stamp) - 1
            self._stamp, self._values = self._stamp[past:], self._values[past:]
            return found
        found = np.full(len(stamp), np.nan)
        if len(self._stamp):
            after = np.searchsorted(self._stamp, stamp, side="right")
            left, right = np.maximum(after - 1, 0), np.minimum(after, len(self._stamp) - 1)
            since, until = stamp - self._stamp[left], self._stamp[right] - stamp
            nearest = np.where(np.abs(since) <= np.abs(until), left, right)
            held = np.abs(stamp - self._stamp[nearest]) <= self.reach
            found[held] = self._values[nearest[held]]
            span = self._stamp[right] - self._stamp[left]
            between = (span > 0) & (span <= self.reach)
            left, right = left[between], right[between]
            rise = self._values[right] - self._values[left]
            found[between] = self._values[left] + rise * (since[between] / span[between])
            past = max(int(after[-1]) - 1, 0)
            self._stamp, self._values = self._stamp[past:], self._values[past:]
        return found
