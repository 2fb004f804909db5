"""Sane values for a spline map beyond its data: what a simulation meets when the current leaves the disc for a moment.

Functions that only the noise at the rim saw have coefficients of many times the flux. Within the data they hardly act
and are left as the regression gives them; outside of the data their place takes a continuation of typical slope.
"""

from __future__ import annotations

import numpy as np

from drive_id.core.maps.flux_models import TensorSpline
from drive_id.types import BoolArray, FloatArray


def extend(model: TensorSpline, gamma: FloatArray, weak: BoolArray, inductances: tuple[float, float]) -> FloatArray:
    """Replace weak coefficients by a continuation with given slopes.

    Parameters
    ----------
    model : TensorSpline
    gamma : (P,) float
        Coefficients, Wb.
    weak : (P,) bool
        Which of them the data do not determine.
    inductances : (float, float)
        Slopes of psi_d over i_d and of psi_q over i_q, H; the cross slopes are zero.

    Returns
    -------
    (P,) float
        Coefficients whose steps from one function to the next differ least, in squares, from those of the slopes, Wb.
    """
    steps_d = np.kron(_differences(model.d.count), np.eye(model.q.count))
    steps_q = np.kron(np.eye(model.d.count), _differences(model.q.count))
    steps = np.concatenate([steps_d, steps_q])
    slope_d, slope_q = inductances[0] * model.d.width, inductances[1] * model.q.width
    wanted_d = np.repeat([slope_d, 0.0], [len(steps_d), len(steps_q)])
    wanted_q = np.repeat([0.0, slope_q], [len(steps_d), len(steps_q)])
    out: FloatArray = gamma.copy()
    for flux, wanted in zip(np.split(np.arange(len(gamma)), 2), (wanted_d, wanted_q), strict=True):
        free, fixed = weak[flux], ~weak[flux]
        if free.any() and fixed.any():
            target = wanted - steps[:, fixed] @ gamma[flux[fixed]]
            out[flux[free]] = np.linalg.lstsq(steps[:, free], target, rcond=None)[0]
    return out


def _differences(count: int) -> FloatArray:
    return np.eye(count)[1:] - np.eye(count)[:-1]
