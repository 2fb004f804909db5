"""What a fit must know of a recording before its samples are accumulated: checks, range and radius, in one pass."""

from __future__ import annotations

import math

import numpy as np

from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks import samples as checks
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.bspline import Axis
from drive_id.core.numerics.compiled import compiled
from drive_id.core.numerics.largest import KEPT, Largest
from drive_id.core.numerics.scans import all_finite
from drive_id.core.signals.signal import finite_rows
from drive_id.types import FloatArray, Samples

SPIKE_FACTOR = 1.2
"""Amplitudes beyond so many times the usual one are faults: a single faulty sample must not stretch the axes."""
_TINY = 1e-160
_LEAST, _MOST = 1e-100, 1e100


class Survey:
    """Gathers what the checks and the preparation of a fit need, in bounded memory.

    All of it is exact; the usual values (quantiles) as long as there are not more than ``1000 kept`` samples.

    Parameters
    ----------
    kept : int
        Largest amplitudes and largest jumps to keep.
    """

    def __init__(self, kept: int = KEPT) -> None:
        self.samples = 0
        self._turns: FloatArray = np.zeros((2, 4))  # see _survey_run; by the speed, and by the angle
        self._turns[:, 1], self._turns[:, 2] = np.inf, -np.inf
        self._products: FloatArray = np.zeros(3)  # by speed squared, by speed times angle, advances in the open window
        self._extremes: FloatArray = np.array([[np.inf, np.inf], [-np.inf, -np.inf]])
        self._step_square: FloatArray = np.zeros((2, 2))
        self._steps = 0
        self._amplitudes = Largest(2, kept)
        self._jumps = Largest(1, kept)
        self._begin: int | None = None
        self._references = _References()

    def add(self, samples: Samples, *, continues: bool = False) -> None:
        """Take further samples; those that continue a piece begin with the last sample of that one."""
        if self._begin is None:
            self._begin = int(samples.stamp[0])
        new = slice(int(continues), None)
        self.samples += len(samples) - continues
        i_dq = frames.to_dq(samples.i_abc, samples.angle)
        rows, jumps = np.empty((len(samples), 3)), np.zeros((len(samples), 2))
        jumps[:, 1] = (samples.stamp - self._begin) * 1e-9
        for run in samples.runs():
            _survey_run(
                samples.angle[run], samples.speed[run], samples.sample_period, self._turns, self._products, jumps[run]
            )
            _survey_currents(i_dq[run], rows[run], self._extremes, self._step_square)
            self._steps += run.stop - run.start - 1
        self._amplitudes.add(rows[new])
        self._jumps.add(jumps[new])
        self._references.add(samples.i_dq_reference, new, len(samples) - continues)

    def check(self) -> None:
        """Judge all samples so far.

        Raises
        ------
        StandstillError, DataError, CoverageError
            See ``check_rotation`` and ``check_trajectory``.
        """
        self._check_jumps()
        with np.errstate(invalid="ignore"):
            turned = max(float((self._turns[:, 2] - self._turns[:, 1]).max()), 0.0)
        expected, advance = self._turns[:, 3]
        square, product = self._products[:2]
        checks.judge_rotation(turned, float(square + expected**2), float(product + expected * advance))
        self._references.check()
        finite = bool(np.isfinite(self._step_square[0]).all())
        step = np.sqrt(self._step_square[0 if finite else 1] / max(self._steps, 1)) / (1.0 if finite else _TINY)
        usual = self._amplitudes.quantile(checks.USUAL_QUANTILE)
        low, high = self._extremes
        largest = float(self._amplitudes.rows()[:, 0].max())
        checks.judge_trajectory(low, high, step, largest, usual)

    def prepare(self, settings: FitSettings) -> Evidence:
        """Return empty evidence of the range and radius of the samples, or of the radius in the settings."""
        if settings.i_max is not None:
            return Evidence.within(settings, settings.i_max)
        usual = self._amplitudes.quantile(checks.USUAL_QUANTILE)
        rows = self._amplitudes.rows()
        trusted = rows[rows[:, 0] <= SPIKE_FACTOR * usual, 1:]
        low = np.minimum(self._amplitudes.low, trusted.min(axis=0, initial=np.inf))
        high = np.maximum(self._amplitudes.high, trusted.max(axis=0, initial=-np.inf))
        d, q = Axis(low[0], high[0], settings.splines_d), Axis(low[1], high[1], settings.splines_q)
        wanted = self._references.largest
        return Evidence(settings, d, q, min(wanted, usual) if SPIKE_FACTOR * wanted >= usual else usual)

    def _check_jumps(self) -> None:
        jumps = self._jumps.rows()
        limit = checks.jump_limit(self._jumps.quantile(checks.USUAL_QUANTILE))
        found = jumps[jumps[:, 0] > limit]
        if len(found):
            first = found[found[:, 1].argmin()]
            raise checks.jump_error(len(found), float(first[1]), float(first[0]))


class _References:
    """What is to be known of the current references, NaN where there are none."""

    def __init__(self) -> None:
        self.largest = 0.0
        self._low: FloatArray = np.full(2, np.inf)
        self._high: FloatArray = np.full(2, -np.inf)
        self._known = self._samples = 0

    def add(self, i_dq: FloatArray | None, new: slice, samples: int) -> None:
        self._samples += samples
        if i_dq is None:
            return
        i_dq = i_dq[new]
        known = i_dq if all_finite(i_dq) else i_dq[finite_rows(i_dq)]
        self._known += len(known)
        self.largest = max(self.largest, float(np.hypot(*known.T).max(initial=0.0)))
        self._low = np.minimum(self._low, [axis.min(initial=np.inf) for axis in known.T])
        self._high = np.maximum(self._high, [axis.max(initial=-np.inf) for axis in known.T])

    def check(self) -> None:
        if self._known == self._samples and (self._low == self._high).all():
            raise checks.held_error(*self._low)


@compiled
def _survey_run(
    angle: FloatArray, speed: FloatArray, period: float, turns: FloatArray, products: FloatArray, jumps: FloatArray
) -> None:
    """Follow the rotor over one run.

    Parameters
    ----------
    angle, speed : (N,) float
        rad and rad/s.
    period : float
        s.
    turns : (2, 4) float
        By the speed and by the angle: turned by now, the least and the most of it, and since the last window, rad.
    products : (3,) float
        Over all full windows, the squared turns by the speed and their products with those by the angle, rad^2; and
        the number of advances since the last one.
    jumps : (N, C) float
        The first column becomes the distance of the angle from where the speed takes it, rad.
    """
    for k in range(1, len(angle)):
        expected = speed[k - 1] * period
        advance = _wrapped(angle[k] - angle[k - 1])
        jumps[k, 0] = abs(_wrapped(advance - expected))
        for way, step in ((0, expected), (1, advance)):
            turns[way, 0] += step
            turns[way, 1] = min(turns[way, 1], turns[way, 0])
            turns[way, 2] = max(turns[way, 2], turns[way, 0])
            turns[way, 3] += step
        products[2] += 1
        if products[2] == checks.WINDOW:
            products[0] += turns[0, 3] * turns[0, 3]
            products[1] += turns[0, 3] * turns[1, 3]
            turns[0, 3] = turns[1, 3] = products[2] = 0.0


@compiled
def _wrapped(angle: float) -> float:
    """Return the angle, rad, between -pi and pi."""
    wrapped: float = angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))
    return wrapped


@compiled
def _survey_currents(i_dq: FloatArray, rows: FloatArray, extremes: FloatArray, steps: FloatArray) -> None:
    """Survey the currents (N, 2), A, of one run.

    Parameters
    ----------
    i_dq : (N, 2) float
    rows : (N, 3) float
        Become amplitude, i_d and i_q.
    extremes : (2, 2) float
        Least and largest i_d and i_q; widened.
    steps : (2, 2) float
        Sums of the squared steps of i_d and i_q, as they are and far from overflow; increased.
    """
    for k in range(len(i_dq)):
        d, q = i_dq[k, 0], i_dq[k, 1]
        larger = max(abs(d), abs(q))
        rows[k, 0] = math.sqrt(d * d + q * q) if _LEAST < larger < _MOST else math.hypot(d, q)
        rows[k, 1], rows[k, 2] = d, q
    for axis in range(2):
        low, high, before = extremes[0, axis], extremes[1, axis], i_dq[0, axis]
        total = 0.0
        for k in range(len(i_dq)):
            now = i_dq[k, axis]
            if now < low:  # noqa: PLR1730  # min and max care for NaN, and take twice as long
                low = now
            if now > high:  # noqa: PLR1730
                high = now
            total += (now - before) * (now - before)
            before = now
        tiny = total * _TINY * _TINY
        if not total < _MOST:
            tiny = 0.0
            for k in range(1, len(i_dq)):
                step = _TINY * (i_dq[k, axis] - i_dq[k - 1, axis])
                tiny += step * step
        extremes[0, axis], extremes[1, axis] = low, high
        steps[0, axis] += total
        steps[1, axis] += tiny
