"""Continuation of a map beyond its data, for a machine that is to be simulated."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from drive_id.types import BoolArray, FloatArray

REACH = 6.0
"""Grid cells within which the slopes of a continued map fall back to the given ones."""


def continued(
    values: FloatArray, known: BoolArray, axes: tuple[FloatArray, FloatArray], slopes: tuple[float, float]
) -> FloatArray:
    """Continue values on a grid where they are not known: smoothly, with slopes that soon tend to given ones.

    Parameters
    ----------
    values : (D, Q) float
        Only those that are known count.
    known : (D, Q) bool
        At least one.
    axes : ((D,), (Q,)) of float
    slopes : (float, float)
        Along both axes.

    Returns
    -------
    (D, Q) float
        The known values, and around them those whose distances r from a plane of the given slopes minimize the sum of
        squared second differences of r plus its squared first differences over the square of :data:`REACH`.
    """
    plane = slopes[0] * axes[0][:, None] + slopes[1] * axes[1]
    operators = []
    for order, weight in ((1, 1 / REACH), (2, 1.0)):
        for axis, count in enumerate(values.shape):
            along = sparse.csr_array(weight * np.diff(np.eye(count), order, axis=0))
            other = sparse.eye_array(values.shape[1 - axis])
            operators.append(sparse.kron(along, other) if axis == 0 else sparse.kron(other, along))
    stacked = sparse.csc_array(sparse.vstack(operators))
    free, residual = ~known.ravel(), np.where(known, values - plane, 0.0).ravel()
    if free.any():
        unknown = stacked[:, free]
        residual[free] = spsolve(sparse.csc_array(unknown.T @ unknown), -(unknown.T @ (stacked @ residual)))
    return np.where(known, values, plane + residual.reshape(values.shape))
