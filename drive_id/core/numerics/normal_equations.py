"""Penalized normal equations: change of unknowns, Cholesky factors, solutions for one penalty or several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg, sparse

from drive_id.types import BoolArray, FloatArray

_JITTER = 1e-13


def congruent(t: sparse.csr_array, matrix: FloatArray) -> FloatArray:
    """Return T' A T of a symmetric A."""
    transposed = sparse.csr_array(t.T)
    return np.asarray(transposed @ np.ascontiguousarray((transposed @ matrix).T))


def times(matrix: FloatArray, voltage: FloatArray) -> FloatArray:
    """Return A v for a v with few non-zero entries."""
    entries = np.flatnonzero(voltage)
    return np.asarray(matrix[:, entries] @ voltage[entries])


def penalized(
    normal: FloatArray, moment: FloatArray, penalties: Sequence[FloatArray], in_map: BoolArray
) -> list[FloatArray]:
    """Solve ``(normal + penalty) x = moment`` for penalties (M, M) that differ only in the unknowns of the map."""
    inner, outer = np.flatnonzero(in_map), np.flatnonzero(~in_map)
    factor, scale = factorize((normal + penalties[0])[np.ix_(outer, outer)])

    def halved(right: FloatArray) -> FloatArray:
        return np.asarray(linalg.solve_triangular(factor, (right.T / scale).T, lower=True, check_finite=False))

    across, known = halved(normal[np.ix_(outer, inner)]), halved(moment[outer])
    schur, reduced = normal[np.ix_(inner, inner)] - across.T @ across, moment[inner] - across.T @ known
    estimates = []
    for penalty in penalties:
        inner_factor, inner_scale = factorize(schur + penalty[np.ix_(inner, inner)])
        x = np.empty(len(moment))
        x[inner] = linalg.cho_solve((inner_factor, True), reduced / inner_scale) / inner_scale
        rest = known - across @ x[inner]
        x[outer] = linalg.solve_triangular(factor, rest, lower=True, trans="T", check_finite=False) / scale
        estimates.append(x)
    return estimates


def factorize(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lower Cholesky factor of the matrix scaled to a unit diagonal, and the scale."""
    diagonal = np.diag(normal)
    scale = np.sqrt(np.maximum(diagonal, 1e-24 * diagonal.max()))
    scaled = normal / scale[:, None]
    scaled /= scale
    jitter = _JITTER
    while True:
        scaled[np.diag_indices_from(scaled)] += jitter
        try:
            return np.asarray(linalg.cholesky(scaled, lower=True, check_finite=False)), scale
        except linalg.LinAlgError:
            if jitter > 1e-6:
                raise
            jitter *= 100.0
