"""Estimate of the delay by which the voltages act later than recorded, corrected for noise in the currents."""

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
"""Uncertainty of a delay, in units of its change with ten times the penalty: on a ring the penalty decides it."""
_PHYSICAL = 0.05
"""Distance from a half or a whole period within which a delay is one that drives have, samples."""


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
        """Tell whether it differs from zero by more than noise, and turns the voltages by an angle that matters.

        Parameters
        ----------
        turn : float
            Electrical angle per sample, rad.
        """
        return abs(self.value) > _SIGNIFICANCE * self.sigma and abs(self.value) * turn > _LEAST_ANGLE

    @property
    def physical(self) -> bool:
        """Whether it is a half or a whole number of periods, as the timing of a drive causes."""
        if np.isnan(self.value):
            return False
        halves = 2 * self.value
        allowed = max(_PHYSICAL, _SIGNIFICANCE * self.sigma)
        return round(halves) != 0 and abs(halves - round(halves)) < 2 * allowed


def estimate_delay(solver: Solver, solution: FullSolution, noise: CurrentNoise) -> Delay:
    """Estimate the delay of the voltages, corrected for noise in the currents.

    A controller answers noise with voltage, later. The standard error includes the correction, what may be left of the
    bias where the data hardly determine a delay, and the effect of smoothing. A delay of more samples than usual must
    explain a good part of the residuals to count.
    """
    found, sigma, squares = solver.delay(solution)
    smoother = solver.delay(solver.solve(replace(solution.spec, penalty=PENALTIES[-1])))[0]
    products = noise_products(solver, solution, noise, squares)
    by_noise = solver.delay(solver.solve(solution.spec, products))[0] - found
    left = _NOISE_SHARE * sigma**2 * solution.rows
    bounds = [sigma, _BIAS, _SMOOTHING_BOUND * (smoother - found), by_noise, left]
    if abs(found) > _USUAL and squares > _MOST_LEFT * solution.sum_of_squares:
        bounds.append(MOST_DELAY)
    return Delay(float(np.clip(found - by_noise, -MOST_DELAY, MOST_DELAY)), float(np.linalg.norm(bounds)))
