"""Penalized normal equations: change of unknowns, Cholesky factors, solutions for one penalty or several."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy import linalg, sparse

from drive_id.core.numerics.compiled import compiled
from drive_id.types import BoolArray, FloatArray, IntArray

_JITTER = 1e-13  # added to the unit diagonal, so that rounding leaves the matrix positive definite
_TILE = 256  # rows and columns at a time, which stay in the cache


def congruent(t: sparse.csr_array, matrix: FloatArray) -> FloatArray:
    """Return T' A T of a symmetric A."""
    transposed = sparse.csr_array(t.T)
    out = np.empty((t.shape[1], t.shape[1]))
    for start in range(0, t.shape[1], _TILE):  # in parts: the matrices are large
        part = slice(start, start + _TILE)
        out[:, part] = transposed @ np.ascontiguousarray((transposed[part] @ matrix).T)
    return out


def triangle_of(matrix: FloatArray) -> FloatArray:
    """Return the lower triangle of a matrix (K, K) as one vector, row by row."""
    return np.asarray(matrix[np.tril_indices(len(matrix))])


def unpacked(triangle: FloatArray, size: int) -> FloatArray:
    """Return the symmetric matrix (size, size) of a lower triangle, see :func:`triangle_of`."""
    matrix = np.empty((size, size))
    start = 0
    for row in range(size):
        matrix[row, : row + 1] = triangle[start : start + row + 1]
        start += row + 1
    edges = [*range(0, size, _TILE), size]
    for k, (start, end) in enumerate(pairwise(edges)):  # tile by tile to stay in the cache
        corner = np.tril(matrix[start:end, start:end])
        matrix[start:end, start:end] = corner + np.tril(corner, -1).T
        for left, right in pairwise(edges[: k + 1]):
            matrix[left:right, start:end] = matrix[start:end, left:right].T
    return matrix


@compiled("const f8[:, ::1], const i8[::1], f8[::1]")
def add_triangle(block: FloatArray, columns: IntArray, triangle: FloatArray) -> None:
    """Add a symmetric matrix (K, K) to rows and columns ``columns`` (K,), increasing, of a matrix's lower triangle."""
    for k in range(len(columns)):
        start = columns[k] * (columns[k] + 1) // 2
        for other in range(k + 1):
            triangle[start + columns[other]] += block[k, other]


def times(matrix: FloatArray, voltage: FloatArray) -> FloatArray:
    """Return A v for a v with few non-zero entries."""
    entries = np.flatnonzero(voltage)
    return np.asarray(matrix[:, entries] @ voltage[entries])


def penalized(
    normal: FloatArray, moment: FloatArray, penalties: Sequence[sparse.csr_array], in_map: BoolArray
) -> list[FloatArray]:
    """Solve ``(normal + penalty) x = moment`` for penalties (M, M) that differ only in the unknowns of the map.

    The unknowns of the map are adjacent. ``normal`` is overwritten.
    """
    outer, (first, last) = np.flatnonzero(~in_map), np.flatnonzero(in_map)[[0, -1]]
    inner = slice(first, last + 1)
    factor, scale = factorize(increased(normal[np.ix_(outer, outer)], penalties[0][outer][:, outer]))

    def halved(right: FloatArray) -> FloatArray:
        return np.asarray(linalg.solve_triangular(factor, (right.T / scale).T, lower=True, check_finite=False))

    across, known = halved(normal[outer, inner]), halved(moment[outer])
    schur, reduced = normal[inner, inner], moment[inner] - across.T @ known
    schur -= across.T @ across
    estimates = []
    for number, penalty in enumerate(penalties, start=1):
        penalized_schur = schur.copy() if number < len(penalties) else schur
        inner_factor, inner_scale = factorize(increased(penalized_schur, penalty[inner][:, inner]))
        x = np.empty(len(moment))
        x[inner] = linalg.cho_solve((inner_factor, True), reduced / inner_scale, check_finite=False) / inner_scale
        rest = known - across @ x[inner]
        x[outer] = linalg.solve_triangular(factor, rest, lower=True, trans="T", check_finite=False) / scale
        estimates.append(x)
    return estimates


def increased(matrix: FloatArray, by: sparse.csr_array) -> FloatArray:
    """Add a sparse matrix to a dense one, in place."""
    entries = by.tocoo()
    entries.sum_duplicates()
    matrix[entries.coords] += entries.data
    return matrix


def solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution (K,) of symmetric positive definite equations (K, K)."""
    factor, scale = factorize(normal)
    return np.asarray(linalg.cho_solve((factor, True), right / scale, check_finite=False) / scale)


def factorize(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lower Cholesky factor of the symmetric matrix scaled to a unit diagonal, and the scale."""
    diagonal = np.diag(normal)
    scale = np.sqrt(np.maximum(diagonal, 1e-24 * diagonal.max()))
    jitter = _JITTER
    while True:
        scaled = normal / scale[:, None]
        scaled /= scale
        scaled[np.diag_indices_from(scaled)] += jitter
        try:  # the transpose is in the order of LAPACK, so that nothing is copied
            return np.asarray(linalg.cholesky(scaled.T, lower=True, overwrite_a=True, check_finite=False)), scale
        except linalg.LinAlgError:
            if jitter > 1e-6:
                raise
            jitter *= 100.0
