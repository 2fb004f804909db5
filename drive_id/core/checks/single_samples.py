"""Single samples that stand out from their neighbours: flipped bits, lost digits, disturbed readings.

A current in the rotor frame and the angle hardly bend from sample to sample. One wrong sample bends them three times in
a row: by -e/2, e and -e/2 where it is off by e. Neither noise nor a step of the references does that, so the pattern
tells errors far smaller than the signal. Two wrong samples in a row show it among every second sample. It matters for
the paper's methods: one of 100 000 samples moves a map by several percent, and the jackknife takes it for noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.numerics.compiled import compiled
from drive_id.core.numerics.largest import Largest
from drive_id.types import FloatArray, Samples

_KEPT = 1 << 14  # largest bends: the quantile is exact up to 16 million samples
_FACTOR = 4.0  # of the usual bend, above which a sample stands out
_LEAST_CURRENT = 0.005  # least error that is reported, by the usual amplitude: less does not distort a map
_LEAST_ANGLE = 0.01  # rad, likewise
_ALIKE = 0.25  # largest deviation from the pattern of one wrong sample, by its bend: noise around it has room
_STRIDES = (1, 2)  # every sample, and every second one: two wrong ones in a row
_BEFORE = 4 * max(_STRIDES)
"""Samples that are kept for the next piece: the pattern needs four around one."""


class SingleSamples:
    """Finds single samples of currents and angle that stand out, in bounded memory."""

    def __init__(self) -> None:
        self._currents = [Largest(3, _KEPT) for _ in _STRIDES]  # bend, with the pattern, time, s, and phase
        self._angles = [Largest(2, _KEPT) for _ in _STRIDES]
        self._last: tuple[FloatArray, ...] | None = None

    def copy(self) -> SingleSamples:
        """Return an independent copy."""
        other = SingleSamples()
        other._currents = [kept.copy() for kept in self._currents]  # of its own class
        other._angles = [kept.copy() for kept in self._angles]
        other._last = self._last
        return other

    def add(self, samples: Samples, i_dq: FloatArray, time: FloatArray, *, continues: bool) -> None:
        """Scan further samples.

        Parameters
        ----------
        i_dq : (N, 2) float
            Their currents in the rotor frame, A.
        time : (N,) float
            s.
        continues : bool
            The samples continue the previous piece and begin with its last sample.
        """
        for number, run in enumerate(samples.runs()):
            parts: tuple[FloatArray, ...] = (i_dq[run], samples.i_abc[run], samples.angle[run], time[run])
            if continues and number == 0 and self._last is not None:
                before = self._last
                parts = tuple(np.concatenate([old, new[1:]]) for old, new in zip(before, parts, strict=True))
            for stride, currents, angles in zip(_STRIDES, self._currents, self._angles, strict=True):
                for first in range(stride):
                    _scan([part[first::stride] for part in parts], currents, angles)
            self._last = tuple(part[-_BEFORE:].copy() for part in parts)

    def findings(self, usual: float) -> Iterator[Message]:
        """Yield a finding for the currents and one for the angle, if samples of theirs stand out.

        Parameters
        ----------
        usual : float
            Usual amplitude of the currents, A.
        """
        of_angle = _at_any_stride(self._angles, _LEAST_ANGLE)
        found = _at_any_stride(self._currents, _LEAST_CURRENT * usual)
        found = found[~np.isin(found[:, 2], of_angle[:, 2])]  # a wrong angle turns the currents of its sample
        if len(found):
            size, _, at, phase = found[found[:, 0].argmax()]
            yield _finding("current", len(found), at, size, phase)
        if len(of_angle):
            size, _, at, *_ = of_angle[of_angle[:, 0].argmax()]
            yield _finding("angle", len(of_angle), at, size)


def _scan(run: Sequence[FloatArray], currents: Largest, angles: Largest) -> None:
    """Add the bends of a run of i_dq, i_abc, angle and time."""
    i_dq, i_abc, angle, time = run
    at, steps = time[2:-2], frames.wrapped(np.diff(angle))
    if not len(at):
        return
    phases, turns = np.abs(_off_middle(i_abc)[1:-1]), 0.5 * (steps[:-1] - steps[1:])[:, None]
    for off, kept, beside in ((_off_middle(i_dq), currents, (at, phases.argmax(axis=1))), (turns, angles, (at,))):
        rows = np.empty((len(at), 2 + len(beside)))
        for number, companion in enumerate(beside, 2):
            rows[:, number] = companion
        _bends(np.ascontiguousarray(off), rows)
        kept.add(rows)


def _off_middle(x: FloatArray) -> FloatArray:
    """Return how far signals (N, C) are off the middle of their neighbours, (N - 2, C)."""
    return np.asarray(x[1:-1] - 0.5 * (x[:-2] + x[2:]))


@compiled("const f8[:, ::1], f8[:, ::1]")
def _bends(off: FloatArray, rows: FloatArray) -> None:
    """Write how far signals are off (N - 2, C), and whether as single samples are, in front of rows (N - 4, ...).

    Their pattern is that of the same sample in the neighbours: half as far to the other side.
    """
    for k in range(len(rows)):
        square, before, after = 0.0, 0.0, 0.0
        for c in range(off.shape[1]):
            half = 0.5 * off[k + 1, c]
            square += off[k + 1, c] ** 2
            before += (off[k, c] + half) ** 2
            after += (off[k + 2, c] + half) ** 2
        rows[k, 0] = math.sqrt(square)
        rows[k, 1] = max(before, after) < _ALIKE**2 * square


def _standing_out(bends: Largest, least: float) -> FloatArray:
    """Return the rows of single samples: those that are many, as by ripple or noise, are the usual ones.

    Of less than some 3000 samples, a wrong one and its neighbours are so many.
    """
    rows = bends.rows()
    if not len(rows):
        return rows
    return rows[(rows[:, 1] > 0) & (rows[:, 0] > max(least, _FACTOR * bends.quantile()))]


def _at_any_stride(kept: Sequence[Largest], least: float) -> FloatArray:
    """Return the rows of samples that stand out, one for each, with its largest bend."""
    found = np.concatenate([_standing_out(bends, least) for bends in kept])
    found = found[np.argsort(-found[:, 0], kind="stable")]
    return found[np.unique(found[:, 2], return_index=True)[1]]


def _finding(signal: str, samples: int, time: float, size: float, phase: float | None = None) -> Message:
    several = samples > 1
    return Message(f"single_sample.{signal}", samples=samples, several=several, time=time, size=size, phase=phase)
