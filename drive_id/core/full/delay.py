"""Estimate of the voltage delay (voltages act later than recorded), corrected for current noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.full.model import PENALTIES
from drive_id.core.full.solver import CurrentNoise, FullSolution, Solver, noise_products
from drive_id.core.full.windows import MOST_DELAY

_SIGNIFICANCE = 2.0
_LEAST_ANGLE = 2e-3  # rad
_BIAS = 0.01
"""Samples; largest bias of an estimated delay seen in simulations."""
_NOISE_SHARE = 0.02
"""Contribution of noise to the product of voltage shifts and residuals seen in simulations, over the sum of squares."""
_USUAL, _MOST_LEFT = 2.0, 0.7
_SMOOTHING_BOUND = 2.0
"""Uncertainty of a delay, in units of its change with the largest penalty, which determines it on a ring."""
_PHYSICAL = 0.05
"""Largest distance of a physical delay from a half or a whole sample, samples."""


@dataclass(frozen=True)
class Delay:
    """Estimated delay of the voltages.

    Parameters
    ----------
    value, sigma : float
        Samples.
    """

    value: float
    sigma: float

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
    def physical(self) -> bool:
        """Whether it is a half or a whole number of samples, as the timing of a drive causes."""
        if np.isnan(self.value):
            return False
        halves = 2 * self.value
        allowed = max(_PHYSICAL, _SIGNIFICANCE * self.sigma)
        return round(halves) != 0 and abs(halves - round(halves)) < 2 * allowed


def estimate_delay(solver: Solver, solution: FullSolution, noise: CurrentNoise) -> Delay:
    """Estimate the voltage delay, corrected for current noise.

    The controller responds to noise with voltage, later, which biases the estimate. The standard error includes the
    correction, the bias that may remain where the data hardly determine a delay, the effect of smoothing, and the error
    of an interpolated angle, which resembles a delay. A delay of more than two samples is accepted only if it explains
    a substantial part of the residuals.
    """
    found, sigma, squares = solver.delay(solution)
    smoother = solver.delay(solver.solve(replace(solution.spec, penalty=PENALTIES[-1])))[0]
    products = noise_products(solver, solution, noise, squares)
    by_noise = solver.delay(solver.solve(solution.spec, products))[0] - found
    left = _NOISE_SHARE * sigma**2 * solution.rows
    bounds = [sigma, _BIAS, _SMOOTHING_BOUND * (smoother - found), by_noise, left]
    if noise.angle_variance:
        bounds.append(np.sqrt(noise.angle_variance) / noise.turn)  # the angle turned by a delay that it resembles
    if abs(found) > _USUAL and squares > _MOST_LEFT * solution.sum_of_squares:
        bounds.append(MOST_DELAY)
    return Delay(float(np.clip(found - by_noise, -MOST_DELAY, MOST_DELAY)), float(np.linalg.norm(bounds)))
