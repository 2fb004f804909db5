"""Estimate of the voltage delay (voltages act later than recorded), corrected for current noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.frames import ComplexArray
from drive_id.core.full.between_samples import decay
from drive_id.core.full.model import PENALTIES
from drive_id.core.full.solver import CurrentNoise, FullSolution, Solver, noise_products
from drive_id.core.full.window_sums import SEGMENT
from drive_id.core.full.windows import DECIMATED, EARLIEST, MOST_DELAY, Windows
from drive_id.types import TINY, FloatArray

_SPEEDS_APART = 0.1
"""Relative difference from which on speeds are several."""
_SIGNIFICANCE = 2.0
"""Standard errors by which a delay must differ from zero, about 95 %."""
_LEAST_ANGLE = 2e-3
"""Angle turned in a delay below which it matters to nobody, rad."""
_BIAS = 0.01
"""Samples; largest bias of an estimated delay seen in simulations."""
_NOISE_SHARE = 0.02
"""Contribution of noise to the product of voltage shifts and residuals seen in simulations, over the sum of squares."""
_USUAL, _MOST_LEFT, _MORE_THAN_NOISE = 2.0, 0.7, 1.1
"""Samples: a delay of more is believed only where it leaves at most this share of the squared residuals, and without it
they are more than so many times those that the noise of the currents explains: at 2 % of noise, the answer of the
controller to it feigned four samples.
"""
_SMOOTHING_BOUND = 2.0
"""Uncertainty of a delay, in units of its change with the largest penalty, which determines it on a ring."""
_PHYSICAL = 0.05
"""Largest distance of a delay from that which its cause has, such as a half or a whole sample, samples."""
_CERTAIN, HALF = 4.0, 0.5
"""Standard errors within which another timing of a drive must not lie, and its distance, samples."""
_EXACT = 0.02
"""The same of a delay as decimated logs have: by five, one of -0.4 samples was estimated as -0.456."""
_BY_DECAY = 1.5
"""Uncertainty, samples, of a delay as decimated logs have, over the squared share R T / L of a current that decays
within a sample: the steps of the voltage between samples are unknown. By five, it was off by 0.5 to 1.1 of that."""
_LEAST_JUMP, _LEAST_SHARE = 0.2, 0.1
"""Jump of a delay in what the fit left of it, samples: of one sample, the fit takes half and more; and the share of the
squared residuals that a jump must explain: without one, it was below 0.002."""


def several_speeds(speeds: FloatArray) -> bool:
    """Tell whether the 5 % of the data at either end have clearly different speeds."""
    low, high = np.quantile(speeds, [0.05, 0.95])
    return bool(high - low > _SPEEDS_APART * max(abs(low), abs(high)))


@dataclass(frozen=True)
class Delay:
    """Estimated delay of the voltages."""

    value: float = np.nan  # samples; NaN when not estimated
    sigma: float = np.nan
    off: float = 0.0  # by which the estimate differs from the value, which may be the nearest half or whole number

    def significant(self, turn: float) -> bool:
        """Tell whether it differs significantly from zero and rotates the voltages by a relevant angle.

        Parameters
        ----------
        turn : float
            Electrical angle per sample, rad.
        """
        return abs(self.value) > _SIGNIFICANCE * self.sigma and abs(self.value) * turn > _LEAST_ANGLE

    @property
    def nearest(self) -> float:
        """The nearest half or whole number of samples."""
        return round(2 * self.value) / 2

    @property
    def between(self) -> tuple[float, ...]:
        """The half or whole numbers of samples on both sides, 0 excluded."""
        halves = math.floor(2 * self.value), math.ceil(2 * self.value)
        return tuple(each / 2 for each in halves if each)

    @property
    def decimation(self) -> float:
        """The n of a log with every n-th sample only, which gives a delay of -(n - 1) / 2n; 0 for other delays."""
        return 1 / (1 + 2 * self.value) if DECIMATED < self.value < -1 / 4 + _PHYSICAL else 0.0

    @property
    def tolerance(self) -> float:
        """Samples within which it is one of half or whole samples, unless a decimated log has such a delay."""
        return _EXACT if self.decimation else math.hypot(_PHYSICAL, _SIGNIFICANCE * self.sigma)

    @property
    def certain(self) -> bool:
        """Whether no other half or whole number of samples is as likely."""
        return _CERTAIN * self.sigma < HALF - abs(self.off)

    @property
    def physical(self) -> bool:
        """Whether it is a half or a whole number of samples, as the timing of a drive causes.

        More than two samples are unusual, so they must not seem so by chance.
        """
        if np.isnan(self.value):
            return False
        halves, allowed = 2 * self.value, self.tolerance
        told = allowed < 0.25 or abs(self.value) <= _USUAL  # no value is farther from a half or a whole sample
        return told and round(halves) != 0 and abs(halves - round(halves)) < 2 * allowed


@dataclass(frozen=True)
class DelayJump:
    """Where the delay of the voltages changes within a recording."""

    recording: int  # number, from 0
    time: float  # since the start of that recording, gaps not counted, s
    later: bool  # whether the voltages come later from then on
    drift: float  # by which they come ever later, s/s, if that explains more; NaN otherwise


def delay_jump(windows: Windows, residuals: FloatArray) -> DelayJump | None:
    """Return the jump of the delay that explains a substantial part of the residuals (N, 2), Vs, if there is one.

    Or the drift that looks like one, as where clocks differ. A delay by d samples of the period T adds ``-d T [u_s]``
    to the balance of a window, [] being the difference between its ends.
    """
    error = residuals[:, 0] + 1j * residuals[:, 1]
    column = -windows.period * (windows.held[:, 1] - windows.held[:, 0]) * np.sqrt(windows.weights)
    speed, found = windows.speed.mean(axis=1), []
    for number in np.unique(windows.recording):
        own = np.flatnonzero(windows.recording == number)
        first = windows.time[own].min()
        segment = ((windows.time[own] - first) / SEGMENT).astype(np.int64)
        facts = (np.real(column[own].conj() * error[own]), np.abs(column[own]) ** 2, speed[own], np.ones(len(own)))
        before = np.cumsum([np.bincount(segment, weights=fact) for fact in facts], axis=1)
        after = before[:, -1:] - before
        (moment, weight, *_), before, after = before[:, -1], before[:, :-1], after[:, :-1]
        if not before.size:
            continue
        low, high = (np.maximum(part[1:], TINY) for part in (before, after))
        delays = before[0] / low[0], after[0] / high[0]
        saved = before[0] * delays[0] + after[0] * delays[1] - moment**2 / max(weight, TINY)
        speeds = before[2] / low[2], after[2] / high[2]
        alike = np.abs(speeds[1] - speeds[0]) < _SPEEDS_APART * np.abs(speeds[0])
        share = np.where(alike, saved, 0.0) / max(float(np.sum(np.abs(error[own]) ** 2)), TINY)
        best = int(np.argmax(share))
        jump = float(delays[1][best] - delays[0][best])
        if share[best] > _LEAST_SHARE and abs(jump) > _LEAST_JUMP:
            drift, saved_by_drift = _drift(windows.time[own] - first, column[own], error[own])
            steady = drift * float(windows.period[own[0]]) if saved_by_drift > saved[best] else np.nan
            found.append((share[best], DelayJump(int(number), SEGMENT * (best + 1), jump < 0, steady)))
    return max(found, key=lambda each: each[0])[1] if found else None


def _drift(time: FloatArray, column: ComplexArray, error: ComplexArray) -> tuple[float, float]:
    """Return by how much the voltages come ever later, samples per s, and what that saves beside a constant delay."""
    columns = column * np.stack([np.ones_like(time), time - time.mean()])
    normal, right = np.real(columns.conj() @ columns.T), np.real(columns.conj() @ error)
    found = np.linalg.lstsq(normal, right, rcond=None)[0]
    return -float(found[1]), float(found @ right - right[0] ** 2 / max(normal[0, 0], TINY))


def estimate_delay(solver: Solver, solution: FullSolution, noise: CurrentNoise) -> Delay:
    """Estimate the voltage delay, corrected for current noise.

    The controller responds to noise with voltage, later, which biases the estimate. The standard error includes the
    correction, the bias that may remain where the data hardly determine a delay, the effect of smoothing, the error
    of an interpolated angle, which resembles a delay, and what a decimated log does not show. A delay of more than two
    samples is accepted only if it explains a substantial part of residuals that are more than noise.
    """
    found, sigma, squares = solver.delay(solution)
    smoother = solver.delay(solver.solve(replace(solution.spec, penalty=PENALTIES[-1])))[0]
    products = noise_products(solver, solution, noise, squares)
    by_noise = solver.delay(solver.solve(solution.spec, products))[0] - found
    left = _NOISE_SHARE * sigma**2 * solution.rows
    bounds = [sigma, _BIAS, _SMOOTHING_BOUND * (smoother - found), by_noise, left]
    if EARLIEST < found < -1 / 4 + _PHYSICAL:
        bounds.append(_BY_DECAY * min(decay(solver.model, solution.estimate, noise.windows), 1.0) ** 2)
    if noise.interpolation_variance:
        resembled = np.sqrt(noise.interpolation_variance) / noise.turn  # the delay that turns the angle as far
        bounds.append(resembled)
    if abs(found) > _USUAL:
        of_noise = _MORE_THAN_NOISE * solution.rows * noise.explained(solver.model, solution)
        if squares > _MOST_LEFT * solution.sum_of_squares or solution.sum_of_squares < of_noise:
            bounds.append(MOST_DELAY)
    return Delay(float(np.clip(found - by_noise, -MOST_DELAY, MOST_DELAY)), float(np.linalg.norm(bounds)))
