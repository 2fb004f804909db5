"""Penalized normal equations: change of unknowns, Cholesky factors, solutions for one penalty or several."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray, IntArray

_JITTER = 1e-13  # added to the unit diagonal, so that rounding leaves the matrix positive definite
_TILE = 256  # rows and columns at a time, which stay in the cache
_LINE = 8  # numbers in a line of the cache
_FLAT = 1e-10  # slope of the squares relative to the largest one at first, from which on an unknown stays zero
_EXCHANGES = 3  # how often each unknown may leave zero


def congruent(t: sparse.csr_array, matrix: FloatArray) -> FloatArray:
    """Return T' A T of a symmetric A.

    Columns of T with one entry only select and scale a row and a column of A, which is much faster than a product.
    """
    by_column = t.tocsc()
    by_column.sum_duplicates()
    entries, unknowns = np.diff(by_column.indptr), t.shape[1]
    others = np.flatnonzero(entries != 1)
    if 2 * len(others) > unknowns:
        return _product(t, matrix)
    first = np.minimum(by_column.indptr[:-1], by_column.nnz - 1)
    row, weight = by_column.indices[first], by_column.data[first]
    out = selected(matrix, row, row)
    if np.any(weight != 1.0):
        out *= weight[:, None]
        out *= weight
    across = t.T @ np.ascontiguousarray((t[:, others].T @ matrix).T)
    out[:, others], out[others] = across, across.T
    return np.asarray(out)


def selected(matrix: FloatArray, rows: IntArray, columns: IntArray) -> FloatArray:
    """Return the rows and columns of a matrix by their numbers, copied run by run of adjacent ones: most are."""
    out = np.empty((len(rows), len(columns)))
    of_columns = list(_runs(columns))
    for own, source in _runs(rows):
        for other, across in of_columns:
            out[own, other] = matrix[source, across]
    return out


def _runs(numbers: IntArray) -> Iterator[tuple[slice, slice]]:
    """Yield the places of each run of adjacent numbers, and the numbers."""
    edges = np.flatnonzero(np.diff(numbers, prepend=-2, append=-2) != 1).tolist()
    for start, end in pairwise(edges):
        yield slice(start, end), slice(int(numbers[start]), int(numbers[start]) + end - start)


def _product(t: sparse.csr_array, matrix: FloatArray) -> FloatArray:
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
    return _symmetric(matrix)


def columns_of(triangle: FloatArray, size: int, count: int) -> FloatArray:
    """Return the first columns (size, count) of the symmetric matrix of a lower triangle."""
    starts = np.cumsum(np.arange(count, size))[:, None] + count * (count + 1) // 2 - count
    below = triangle[starts + np.arange(count)]
    return np.concatenate([unpacked(triangle[: count * (count + 1) // 2], count), below])


def normal_of_difference(t: sparse.csr_array, matrix: FloatArray, less: FloatArray, out: FloatArray) -> None:
    """Write the upper triangle of T' (A - B) T of symmetric matrices, B being given as its lower triangle."""
    by_column = t.tocsc()
    if (
        np.all(np.diff(by_column.indptr) == 1)
        and np.all(by_column.data == 1.0)
        and np.all(np.diff(by_column.indices) > 0)
    ):
        _select_difference(matrix, less, by_column.indices.astype(np.int64), out)
    else:
        out[:] = congruent(t, matrix - unpacked(less, len(matrix)))


@compiled("const f8[:, ::1], const f8[::1], const i8[::1], f8[:, :]")
def _select_difference(matrix: FloatArray, less: FloatArray, rows: IntArray, out: FloatArray) -> None:
    """Write the upper triangle of rows and columns (M,), increasing, of the difference."""
    for left in range(0, len(rows), _LINE):
        right = min(left + _LINE, len(rows))
        for k in range(right):
            row = rows[k]
            for other in range(max(left, k), right):
                column = rows[other]
                out[k, other] = matrix[row, column] - less[column * (column + 1) // 2 + row]


def _symmetric(matrix: FloatArray) -> FloatArray:
    """Copy the lower triangle of a matrix to the upper one, in place."""
    size = len(matrix)
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


def nonnegative(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Return the least squares (K,) that are not negative, of normal equations (K, K) (Lawson and Hanson 1974)."""
    found, free = np.zeros(len(right)), np.zeros(len(right), np.bool_)
    for _ in range(_EXCHANGES * len(right)):
        slope = np.where(free, 0.0, right - normal @ found)
        if not slope.max() > _FLAT * np.abs(right).max():
            break
        free[slope.argmax()] = True
        while True:
            tried = np.zeros(len(right))
            tried[free] = np.linalg.lstsq(normal[np.ix_(free, free)], right[free])[0]
            passed = np.flatnonzero(free & (tried <= 0.0))
            if not len(passed):
                break
            shares = found[passed] / (found[passed] - tried[passed])
            found += shares.min() * (tried - found)
            found[passed[shares.argmin()]] = 0.0
            free &= found > 0.0
        found = tried
    return found


def factorize(
    normal: FloatArray, by: sparse.csr_array | None = None, scale: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the lower Cholesky factor of a symmetric matrix, scaled, by default to a unit diagonal, and the scale.

    The matrix is increased by a sparse one, if given.
    """
    scale = _scale_of(np.diag(normal) + (0.0 if by is None else by.diagonal())) if scale is None else scale
    inverse, jitter = 1.0 / scale, _JITTER
    relative = (
        None
        if by is None
        else sparse.triu(sparse.diags_array(inverse) @ by @ sparse.diags_array(inverse), format="csr")
    )
    while True:
        scaled = np.empty(normal.shape)
        _equilibrate(normal, inverse, scaled)
        if relative is not None:
            increased(scaled, relative)
        scaled[np.diag_indices_from(scaled)] += jitter
        try:  # the transpose is in the order of LAPACK, so that nothing is copied
            return np.asarray(linalg.cholesky(scaled.T, lower=True, overwrite_a=True, check_finite=False)), scale
        except linalg.LinAlgError:
            if jitter > 1e-6:
                raise
            jitter *= 100.0


def _scale_of(diagonal: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.maximum(diagonal, 1e-24 * diagonal.max(initial=0.0))))


@compiled("f8[:, :], const f8[::1], f8[:, ::1]")
def _equilibrate(matrix: FloatArray, by: FloatArray, out: FloatArray) -> None:
    """Write the upper triangle of a matrix (K, K) that is multiplied by (K,) on both sides."""
    for row in range(len(by)):
        for column in range(row, len(by)):
            out[row, column] = matrix[row, column] * by[row] * by[column]


@dataclass(frozen=True, eq=False)
class Factor:
    """Lower Cholesky factor of a symmetric matrix (M, M) with a scaled diagonal, see :func:`factorize`, in two blocks.

    Matrices with the same first block share the work for that.
    """

    first: FloatArray  # (K, K), factor of the first block
    across: FloatArray  # (K, J), first^-1 times the block beside it
    last: FloatArray  # (J, J)
    scale: FloatArray  # (M,)

    @classmethod
    def extended(
        cls, first: tuple[FloatArray, FloatArray], half: FloatArray, normal: FloatArray, by: sparse.csr_array
    ) -> Factor:
        """Append a block ``normal + by`` (J, J); ``half`` (K, J) is first^-1 times the scaled rows beside it."""
        factor, scale = first
        own = _scale_of(np.diag(normal) + by.diagonal())
        across = half / own
        last, _ = factorize(normal - half.T @ half, by, own)
        return cls(factor, across, last, np.append(scale, own))

    @property
    def diagonal(self) -> FloatArray:
        """Its diagonal (M,)."""
        return np.append(np.diag(self.first), np.diag(self.last))

    def half(self, forms: FloatArray) -> FloatArray:
        """Return ``L^-1 b`` (M, N) for b (M, N), L being the unscaled factor."""
        split, scaled = len(self.first), forms / self.scale[:, None]
        top = linalg.solve_triangular(self.first, scaled[:split], lower=True, check_finite=False)
        return self.joined(top, forms[split:])

    def joined(self, top: FloatArray, forms: FloatArray) -> FloatArray:
        """Return ``L^-1 b`` (M, N) from the first rows of it (K, N), and the last ones of b (J, N)."""
        rest = forms / self.scale[len(top) :, None] - self.across.T @ top
        return np.append(top, linalg.solve_triangular(self.last, rest, lower=True, check_finite=False), axis=0)

    def back(self, half: FloatArray) -> FloatArray:
        """Return ``L'^-1 b`` (M, ...) for b (M, ...)."""
        split = len(self.first)
        bottom = linalg.solve_triangular(self.last, half[split:], lower=True, trans="T", check_finite=False)
        rest = half[:split] - self.across @ bottom
        top = linalg.solve_triangular(self.first, rest, lower=True, trans="T", check_finite=False)
        return np.asarray((np.append(top, bottom, axis=0).T / self.scale).T)

    def inverse(self) -> FloatArray:
        """Return the inverse (M, M) of the matrix."""
        split = len(self.first)
        whole = np.zeros((len(self.scale),) * 2, order="F")  # not empty: what is above the diagonal is divided, too
        whole[:split, :split], whole[split:, :split], whole[split:, split:] = self.first, self.across.T, self.last
        out, _ = linalg.lapack.dpotri(whole, lower=True, overwrite_c=True)
        out /= self.scale[:, None]
        out /= self.scale
        return np.asarray(_symmetric(np.asarray(out)).T)  # in the order in which sparse matrices multiply it, uncopied


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Normal equations of M unknowns for penalties that differ in the first J only: the others are eliminated once."""

    others: tuple[FloatArray, FloatArray]  # factor (K, K) and scale of the others
    half: FloatArray  # (K, J), factor^-1 times the scaled rows beside it
    known: FloatArray  # (K, 1), the same of the moment
    schur: FloatArray  # (J, J), what is left of the first
    moment: FloatArray  # (J,)

    @classmethod
    def of(cls, normal: FloatArray, moment: FloatArray, penalty: sparse.csr_array, first: int) -> Eliminated:
        """Eliminate from ``(normal + penalty) x = moment``, (M, M) and (M,), all but so many first unknowns."""
        inner, outer = slice(first), slice(first, None)
        factor, scale = factorize(normal[outer, outer], penalty[outer, outer])
        half, known = (  # (K, N) in the order of LAPACK, so that nothing is copied
            linalg.solve_triangular(factor, (rows / scale).T, lower=True, overwrite_b=True, check_finite=False)
            for rows in (normal[inner, outer], moment[None, outer])
        )
        schur = half.T @ half
        return cls((factor, scale), half, known, np.subtract(normal[inner, inner], schur, out=schur), moment[inner])

    def solved(self, penalty: sparse.csr_array) -> FloatArray:
        """Return the solution (M,) for a penalty (M, M)."""
        first, (factor, scale) = len(self.schur), self.others
        last, own = factorize(self.schur, penalty[:first, :first])
        whole = Factor(factor, self.half / own, last, np.append(scale, own))
        return np.roll(whole.back(whole.joined(self.known, self.moment[:, None])[:, 0]), first)


@compiled("const i4[::1], const i4[::1], const f8[::1], const f8[:, ::1]")
def quadratic_forms(
    first: NDArray[np.int32], column: NDArray[np.int32], value: FloatArray, matrix: FloatArray
) -> FloatArray:
    """Return ``f' A f`` (N,) of the rows f of a sparse matrix (N, K), given as in ``csr_array``, with a symmetric A."""
    out = np.zeros(len(first) - 1)
    for n in range(len(out)):
        for one in range(first[n], first[n + 1]):
            row, total = matrix[column[one]], 0.0  # whole rows: of differences of forms, most cancels within each
            for other in range(first[n], first[n + 1]):
                total += row[column[other]] * value[other]
            out[n] += value[one] * total
    return out
