"""The checks of :mod:`~drive_id.core.checks.samples` for samples that arrive in pieces, in bounded memory."""

from __future__ import annotations

import copy

import numpy as np

from drive_id.core import frames
from drive_id.core.checks import samples as checks
from drive_id.types import FloatArray, IntArray, Samples

_BINS_PER_OCTAVE = 32
_OCTAVES = 128


class Plausibility:
    """Gathers what the checks of rotation and trajectory need.

    The amplitude that all but a few samples stay below is known within 2 %; everything else is exact.
    """

    def __init__(self) -> None:
        self._angle: FloatArray = np.zeros(2)  # turned by now, by the speed and by the resolver's angle, rad
        self._least: FloatArray = np.full(2, np.inf)
        self._most: FloatArray = np.full(2, -np.inf)
        self._window: FloatArray = np.zeros(2)
        self._filled = 0
        self._square = self._product = 0.0
        self._low: FloatArray = np.full(2, np.inf)
        self._high: FloatArray = np.full(2, -np.inf)
        self._step_square: FloatArray = np.zeros(2)
        self._steps = 0
        self._largest = 0.0
        self._amplitudes: IntArray = np.zeros(_BINS_PER_OCTAVE * _OCTAVES, np.int64)

    def copy(self) -> Plausibility:
        """Return one that goes its own way; all arrays are replaced, never changed."""
        return copy.copy(self)

    def add(self, samples: Samples, *, continues: bool = False) -> None:
        """Gather from further samples; those that continue a piece begin with the last sample of that one."""
        turns = [np.stack(checks.advances(samples, run)) for run in samples.runs()]
        self._turn(np.concatenate(turns, axis=1))
        i_dq = frames.to_dq(samples.i_abc, samples.angle)
        steps = np.concatenate([np.diff(i_dq[run], axis=0) for run in samples.runs()])
        with np.errstate(over="ignore"):  # absurd currents are named by the judge
            self._step_square = self._step_square + np.sum(steps**2, axis=0)
        self._steps += len(steps)
        self._low, self._high = np.minimum(self._low, i_dq.min(axis=0)), np.maximum(self._high, i_dq.max(axis=0))
        amplitude = np.hypot(*i_dq[int(continues) :].T)
        self._largest = max(self._largest, float(amplitude.max(initial=0.0)))
        with np.errstate(divide="ignore"):
            bins = np.clip(_BINS_PER_OCTAVE * (np.log2(amplitude) + _OCTAVES // 2), 0, len(self._amplitudes) - 1)
        self._amplitudes = self._amplitudes + np.bincount(bins.astype(np.int64), minlength=len(self._amplitudes))

    def check(self) -> None:
        """Judge all samples so far.

        Raises
        ------
        StandstillError, DataError, CoverageError
            See ``check_rotation`` and ``check_trajectory``.
        """
        turned = float(np.max(self._most - self._least)) if np.isfinite(self._most).all() else 0.0
        expected, advance = self._window
        checks.judge_rotation(turned, self._square + expected**2, self._product + expected * advance)
        step = np.sqrt(self._step_square / max(self._steps, 1))
        checks.judge_trajectory(self._low, self._high, step, self._largest, self._usual())

    def _turn(self, advance: FloatArray) -> None:
        """Follow the rotor over further samples: turns (2, N) by the speed and by the angle, rad."""
        if not advance.shape[1]:
            return
        angle = self._angle[:, None] + np.cumsum(advance, axis=1)
        self._angle = angle[:, -1]
        self._least, self._most = np.minimum(self._least, angle.min(axis=1)), np.maximum(self._most, angle.max(axis=1))
        room = checks.WINDOW - self._filled
        starts = np.concatenate(([0], np.arange(room, advance.shape[1], checks.WINDOW)))
        sums = np.add.reduceat(advance, starts, axis=1)
        sums[:, 0] += self._window
        self._filled = (self._filled + advance.shape[1]) % checks.WINDOW
        self._window = sums[:, -1] if self._filled else np.zeros(2)
        full = sums[:, :-1] if self._filled else sums
        self._square += float(full[0] @ full[0])
        self._product += float(full[0] @ full[1])

    def _usual(self) -> float:
        """Return the amplitude that all but a few samples stay below, A."""
        below = np.cumsum(self._amplitudes)
        first = int(np.searchsorted(below, checks.USUAL_QUANTILE * below[-1]))
        return float(2.0 ** ((first + 1) / _BINS_PER_OCTAVE - _OCTAVES // 2))
