"""Continuation of a map beyond its data, for a machine that is to be simulated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import spsolve

from drive_id.core.maps.flux_map import FluxMap, HarmonicMap
from drive_id.types import BoolArray, FloatArray

REACH = 6.0
"""Grid cells within which the slopes of a continued map fall back to the given ones."""


def continued(
    values: FloatArray, known: BoolArray, axes: tuple[FloatArray, FloatArray], slopes: ArrayLike
) -> FloatArray:
    """Continue values on a grid where they are not known: smoothly, with slopes that soon tend to given ones.

    Parameters
    ----------
    values : (D, Q) or (K, D, Q) float
        One array or several; only the values that are known count.
    known : (D, Q) bool
        At least one.
    axes : ((D,), (Q,)) of float
    slopes : (2,) or (K, 2) float
        Along both axes, for all arrays or for each.

    Returns
    -------
    (D, Q) or (K, D, Q) float
        The known values, and around them those whose distances r from a plane of the given slopes minimize the sum of
        squared second differences of r plus its squared first differences over the square of :data:`REACH`.
    """
    along_both = np.asarray(slopes)[..., None, None]
    plane = along_both[..., 0, :, :] * axes[0][:, None] + along_both[..., 1, :, :] * axes[1]
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

    found: FluxMap
    i_d: FloatArray  # (D,), A
    i_q: FloatArray  # (Q,), A
    known: BoolArray  # (D, Q), where the map has data
    places: tuple[slice, slice]  # where its own grid lies

    @classmethod
    def around(cls, found: FluxMap, reach: float = 0.0) -> LongerGrid:
        """Add points of the same mean step until both axes of a map cover -reach to reach, A."""
        own = found.i_d, found.i_q
        longer = [_reaching(axis, reach) for axis in own]
        starts = [int(np.searchsorted(axis, part[0])) for axis, part in zip(longer, own, strict=True)]
        places = slice(starts[0], starts[0] + len(own[0])), slice(starts[1], starts[1] + len(own[1]))
        known = np.zeros((len(longer[0]), len(longer[1])), np.bool_)
        known[places] = found.inside
        return cls(found, longer[0], longer[1], known, places)

    def whole(self, values: FloatArray, slopes: ArrayLike = (0.0, 0.0)) -> FloatArray:
        """Return values (..., d, q) on the own grid, continued to this one (..., D, Q), see :func:`continued`."""
        placed = np.zeros((*values.shape[:-2], *self.known.shape))
        placed[..., self.places[0], self.places[1]] = values
        return continued(placed, self.known, (self.i_d, self.i_q), slopes)

    def flux_map(self) -> FluxMap:
        """Return the map likewise, each flux with its typical slope along its own current; further errors are NaN."""
        found = self.found
        sigma = np.full((*self.known.shape, 2), np.nan)
        sigma[self.places] = found.sigmas
        waves = [x for h in found.harmonics for x in (h.psi_d_cos, h.psi_d_sin, h.psi_q_cos, h.psi_q_sin)]
        slopes = np.zeros((2 + len(waves), 2))
        slopes[:2] = np.diag(found.typical_inductances)
        psi_d, psi_q, *waves = self.whole(np.stack([found.psi_d, found.psi_q, *waves]), slopes)
        parts = iter(waves)
        harmonics = tuple(HarmonicMap(h.order, *islice(parts, 4)) for h in found.harmonics)
        psi = np.stack([psi_d, psi_q], axis=-1)
        return replace(FluxMap.of(self.i_d, self.i_q, psi, sigma, self.known, harmonics), inner=found)


def _reaching(axis: FloatArray, reach: float) -> FloatArray:
    step = (axis[-1] - axis[0]) / (len(axis) - 1)
    before, after = (max(0, math.ceil((reach - end) / step)) for end in (-axis[0], axis[-1]))
    return np.concatenate([axis[0] - step * np.arange(before, 0, -1), axis, axis[-1] + step * np.arange(1, after + 1)])
