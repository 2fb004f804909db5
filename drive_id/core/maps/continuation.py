"""Continuation of a map beyond its data, for a machine that is to be simulated."""

from __future__ import annotations

import math
from dataclasses import dataclass

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
    values : (D, Q) or (K, D, Q) float
        One array or several; only the values that are known count.
    known : (D, Q) bool
        At least one.
    axes : ((D,), (Q,)) of float
    slopes : (float, float)
        Along both axes.

    Returns
    -------
    (D, Q) or (K, D, Q) float
        The known values, and around them those whose distances r from a plane of the given slopes minimize the sum of
        squared second differences of r plus its squared first differences over the square of :data:`REACH`.
    """
    plane = slopes[0] * axes[0][:, None] + slopes[1] * axes[1]
    operators = []
    for order, weight in ((1, 1 / REACH), (2, 1.0)):
        for axis, count in enumerate(known.shape):
            along = sparse.csr_array(weight * np.diff(np.eye(count), order, axis=0))
            other = sparse.eye_array(known.shape[1 - axis])
            operators.append(sparse.kron(along, other) if axis == 0 else sparse.kron(other, along))
    stacked = sparse.csc_array(sparse.vstack(operators))
    several = values.reshape(-1, *known.shape)
    free, residual = ~known.ravel(), np.where(known, several - plane, 0.0).reshape(len(several), -1).T
    if free.any():
        unknown = stacked[:, free]
        solved = spsolve(sparse.csc_array(unknown.T @ unknown), -(unknown.T @ (stacked @ residual)))
        residual[free] = solved.reshape(-1, len(several))
    return np.where(known, values, plane + residual.T.reshape(values.shape))


@dataclass(frozen=True, eq=False)
class LongerGrid:
    """A grid that contains that of a map and reaches farther."""

    i_d: FloatArray  # (D,), A
    i_q: FloatArray  # (Q,), A
    known: BoolArray  # (D, Q), where the map has data
    places: tuple[slice, slice]  # where its own grid lies

    @classmethod
    def around(cls, i_d: FloatArray, i_q: FloatArray, inside: BoolArray, reach: float) -> LongerGrid:
        """Add points of the same mean step until both axes cover -reach to reach, A."""
        longer = [_reaching(axis, reach) for axis in (i_d, i_q)]
        starts = [int(np.searchsorted(axis, own[0])) for axis, own in zip(longer, (i_d, i_q), strict=True)]
        places = (slice(starts[0], starts[0] + len(i_d)), slice(starts[1], starts[1] + len(i_q)))
        known = np.zeros((len(longer[0]), len(longer[1])), np.bool_)
        known[places] = inside
        return cls(longer[0], longer[1], known, places)

    def whole(self, values: FloatArray, slopes: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """Return values (..., d, q) on the own grid, continued to this one (..., D, Q), see :func:`continued`."""
        placed = np.zeros((*values.shape[:-2], *self.known.shape))
        placed[..., self.places[0], self.places[1]] = values
        return continued(placed, self.known, (self.i_d, self.i_q), slopes)

    def flux(self, psi: FloatArray, axis: int) -> FloatArray:
        """Return psi_d (axis 0) or psi_q (axis 1) likewise, Wb, with its typical slope along its own current."""
        current = (self.i_d, self.i_q)[axis][self.places[axis]]
        slope = _typical_slope(psi, current, self.known[self.places], axis)
        return self.whole(psi, (0.0, slope) if axis else (slope, 0.0))


def _typical_slope(psi: FloatArray, current: FloatArray, inside: BoolArray, axis: int) -> float:
    """Return the median slope of a flux (D, Q), Wb, along an axis with currents, A, where there are data, H."""
    both = np.take(inside, range(1, len(current)), axis) & np.take(inside, range(len(current) - 1), axis)
    steps = np.diff(current)[:, None] if axis == 0 else np.diff(current)
    return float(np.median((np.diff(psi, axis=axis) / steps)[both]))


def _reaching(axis: FloatArray, reach: float) -> FloatArray:
    step = (axis[-1] - axis[0]) / (len(axis) - 1)
    before, after = (max(0, math.ceil((reach - end) / step)) for end in (-axis[0], axis[-1]))
    return np.concatenate([axis[0] - step * np.arange(before, 0, -1), axis, axis[-1] + step * np.arange(1, after + 1)])
