"""The paper's two measures of an identified model."""

from __future__ import annotations

import numpy as np

from drive_id.core.maps.surfaces import Surfaces
from drive_id.types import FloatArray, GroundTruth


def mean_absolute_deviation(simulated: FloatArray, measured: FloatArray) -> tuple[float, float]:
    """Return the MAD of i_d and of i_q, A, of simulated from measured currents, both (N, 2); NaN if any is NaN."""
    mad = np.abs(simulated - measured).mean(axis=0)
    return float(mad[0]), float(mad[1])


def true_flux(truth: GroundTruth, i_dq: FloatArray) -> FloatArray:
    """Interpolate the true flux linkages, Wb, cubically at currents (..., 2), A; NaN beyond the true map."""
    low, high = np.array([truth.i_d[0], truth.i_q[0]]), np.array([truth.i_d[-1], truth.i_q[-1]])
    known = ((i_dq >= low) & (i_dq <= high)).all(axis=-1)
    psi = np.full(i_dq.shape, np.nan)
    psi[known] = Surfaces.over(truth.i_d, truth.i_q, truth.psi_d, truth.psi_q).values(*i_dq[known].T)
    return psi


def nrmse(psi_dq: FloatArray, true_psi_dq: FloatArray) -> tuple[float, float]:
    """Return the NRMSE of psi_d and psi_q.

    Parameters
    ----------
    psi_dq, true_psi_dq : (N, 2) float
        Identified and true flux linkages at the same currents, Wb.

    Returns
    -------
    float, float
        Root mean square error of each flux over the largest absolute true value of that flux, dimensionless; NaN
        where there is nothing to compare.
    """
    largest = np.abs(true_psi_dq).max(axis=0, initial=0.0)
    if not largest.all():
        return float("nan"), float("nan")
    error = np.sqrt(np.mean((psi_dq - true_psi_dq) ** 2, axis=0)) / largest
    return float(error[0]), float(error[1])
