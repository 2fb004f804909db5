"""Operating points for displays: currents in the rotor frame and speed, at a low rate, without any part in a fit."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from drive_id.core import frames
from drive_id.core.signals.signal import Signal
from drive_id.types import NANOSECONDS, FloatArray, IntArray

_SET_BACK = 1e9
"""ns behind the last point at which a clock was set back, or samples are played again."""
_MOST_BLOCKS = 400
"""Blocks of each signal that are kept: those of one look, however small they are."""
_MOST_POINTS = 50
"""Points of one look: after a silence, only the latest are of use."""


@dataclass(frozen=True)
class Point:
    """An operating point: stamp, ns; currents, A; electrical speed, rad/s."""

    stamp: int
    i_d: float
    i_q: float
    speed: float


class PointDecimator:
    """Decimates currents and resolver to at most ``rate`` points per second of their time. Not for several threads."""

    def __init__(self, rate: float) -> None:
        self._spacing = math.inf if rate <= 0 else NANOSECONDS / rate
        self._currents: deque[Signal] = deque(maxlen=_MOST_BLOCKS)
        self._resolver: deque[Signal] = deque(maxlen=_MOST_BLOCKS)
        self._last = -math.inf  # stamp of the last point, ns

    def add(self, section: int, piece: Signal) -> None:
        """Take a block of currents (0) or resolver (2); others are ignored."""
        if math.isinf(self._spacing) or not len(piece.stamp) or section not in (0, 2):
            return
        if piece.stamp[-1] < self._last - _SET_BACK:
            self.clear()
            self._last = -math.inf
        (self._resolver if section else self._currents).append(piece)

    def clear(self) -> None:
        """Forget what has arrived: nobody wants it."""
        self._currents.clear()
        self._resolver.clear()

    def take(self) -> list[Point]:
        """Return the points since the last call: for each, the resolver is taken at the stamp of the currents."""
        if not self._currents or not self._resolver:
            return []
        stamp, i_abc = _joined(self._currents)
        known, position = _joined(self._resolver)
        order = np.argsort(known, kind="stable")
        known, position = known[order], position[order]
        usable = (stamp > self._last) & (stamp <= known[-1]) & (stamp >= known[0]) & np.isfinite(i_abc).all(axis=1)
        chosen = self._spaced(stamp, np.flatnonzero(usable))[-_MOST_POINTS:]
        if not len(chosen):
            return []
        nearest = np.clip(np.searchsorted(known, stamp[chosen], side="right") - 1, 0, len(known) - 1)
        angle, speed = position[nearest].T
        angle = angle + speed * (stamp[chosen] - known[nearest]) / NANOSECONDS
        i_dq = frames.to_dq(i_abc[chosen], angle)
        self._last = float(stamp[chosen[-1]])
        self._forget()
        found = zip(stamp[chosen], i_dq, speed, strict=True)
        return [Point(int(t), float(i[0]), float(i[1]), float(w)) for t, i, w in found if math.isfinite(w)]

    def _spaced(self, stamp: IntArray, usable: IntArray) -> IntArray:
        """Return the indices of the first samples in each interval that has not had a point."""
        interval = np.floor(stamp[usable] / self._spacing)
        _, first = np.unique(interval, return_index=True)
        fresh = interval[first] > math.floor(self._last / self._spacing) if math.isfinite(self._last) else first >= 0
        return usable[first[fresh]]

    def _forget(self) -> None:
        """Forget blocks that end before the last point."""
        for blocks in (self._currents, self._resolver):
            while len(blocks) > 1 and blocks[0].stamp[-1] < self._last:
                blocks.popleft()


def _joined(blocks: deque[Signal]) -> tuple[IntArray, FloatArray]:
    return np.concatenate([block.stamp for block in blocks]), np.concatenate([block.values for block in blocks])
