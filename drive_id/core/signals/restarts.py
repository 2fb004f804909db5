"""Times that start again, as in a file of several captures: each is put behind the one before, with a gap."""

from __future__ import annotations

import numpy as np

from drive_id.types import IntArray

_GAP = 10
"""Steps of time between a capture and the next: more than the 1.5 from which on a new run begins."""
_LATER = 16
"""Rows behind a step back that must stay behind it: fewer are late rows, which belong before it."""
_DAY, _MIDNIGHT = 86_400_000_000_000, 60_000_000_000
"""A day, and the longest pause, ns, around which a step back by less than a day is a time of day past midnight."""
_MOST = 0.01
"""Share of the rows with a step back, from which on the times are in disorder, and no captures."""


class Restarts:
    """Joins the times of consecutive captures, part by part.

    Attributes
    ----------
    places : int
        Where the time started again.
    first : int
        Row of the first such place.
    """

    def __init__(self) -> None:
        self.places = 0
        self.first = 0
        self._rows = 0
        self._shift = 0
        self._last: tuple[int, int] | None = None  # as recorded, and the largest so far as returned, ns
        self._step = 0

    def continued(self, stamp: IntArray) -> IntArray:
        """Return further times (N,), ns, moved so that each capture lies behind the one before."""
        if not len(stamp):
            return stamp
        before = stamp[0] if self._last is None else self._last[0]
        steps = np.diff(stamp, prepend=before)
        forward = steps[steps > 0]
        self._step = int(np.median(forward)) if len(forward) else self._step
        back = np.flatnonzero(steps < -self._step)
        moved = stamp + self._shift
        if self._step and len(back) and len(back) <= max(_MOST * len(stamp), 1):
            for k in back:
                if 0 <= steps[k] + _DAY <= _MIDNIGHT:
                    moved[k:] += _DAY
                    self._shift += _DAY
                    continue
                largest = max(int(moved[:k].max(initial=moved[0])), self._last[1] if self._last else int(moved[0]))
                if int(moved[k : k + _LATER].max()) > largest:
                    continue  # late rows
                self.first = self.first if self.places else self._rows + int(k)
                self.places += 1
                ahead = largest + _GAP * self._step - int(moved[k])
                moved[k:] += ahead
                self._shift += ahead
        largest = int(moved.max())
        self._last = int(stamp[-1]), largest if self._last is None else max(largest, self._last[1])
        self._rows += len(stamp)
        return moved
