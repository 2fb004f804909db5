"""The inner loops of method ``full``: B-splines on bent cells, rows of the regression, sums of their products."""

from __future__ import annotations

import numpy as np

from drive_id.core import vectorized
from drive_id.core.compiled import compiled_or
from drive_id.core.flux_models import ColumnArray
from drive_id.types import FloatArray, IntArray


@compiled_or(vectorized.spline_values)
def spline_values(x: FloatArray, knots: FloatArray, degree: int, cell: IntArray, w: FloatArray) -> None:
    """Evaluate B-splines by the Cox-de Boor recursion.

    Parameters
    ----------
    x : (N,) float
        Places; beyond the ends, as on them.
    knots : (C + 1 + 2 degree,) float
        Clamped.
    degree : int
    cell : (N,) int
        Is set to the first function that is not zero.
    w : (N, degree + 1) float
        Is set to the values of that and its successors.
    """
    cells = len(knots) - 1 - 2 * degree
    for n in range(len(x)):
        at = min(max(x[n], knots[degree]), knots[degree + cells])
        low, high = 0, cells
        while high - low > 1:
            middle = (low + high) // 2
            if at >= knots[degree + middle]:
                low = middle
            else:
                high = middle
        knot = low + degree
        cell[n] = low
        w[n, 0] = 1.0
        for order in range(1, degree + 1):
            carried = 0.0
            for k in range(order):
                left, right = knots[knot + 1 - order + k], knots[knot + 1 + k]
                share = w[n, k] / (right - left)
                w[n, k] = carried + (right - at) * share
                carried = (at - left) * share
            w[n, order] = carried


@compiled_or(vectorized.tensor_products)
def tensor_products(
    cell_d: IntArray,
    w_d: FloatArray,
    cell_q: IntArray,
    w_q: FloatArray,
    count_q: int,
    offset: int,
    column: ColumnArray,
    value: FloatArray,
) -> None:
    """Multiply splines of two axes.

    Parameters
    ----------
    cell_d, w_d, cell_q, w_q
        Along each axis, see :func:`spline_values`.
    count_q : int
        Functions along the second axis.
    offset : int
        Column of the first product.
    column, value : (N, K)
        Are set.
    """
    for n in range(len(cell_d)):
        k = 0
        for a in range(w_d.shape[1]):
            first = offset + (cell_d[n] + a) * count_q + cell_q[n]
            for b in range(w_q.shape[1]):
                column[n, k] = first + b
                value[n, k] = w_d[n, a] * w_q[n, b]
                k += 1


@compiled_or(vectorized.add_end)
def add_end(
    column: ColumnArray, value: FloatArray, turn: FloatArray, start: IntArray, factor: FloatArray, out: FloatArray
) -> None:
    """Add the flux at one end of windows to the rows of the regression, for all maps in one space.

    Parameters
    ----------
    column, value : (N, 2, K)
        Basis functions, see :class:`~drive_id.core.flux_models.BasisRows`; no column twice in a row.
    turn : (N, 2) float
        Cosine and sine of the angle, with the sign of the end.
    start : (P,) int
        First column of each map.
    factor : (P, N) float
        By which each map counts.
    out : (N, 2, size) float
    """
    for n in range(column.shape[0]):
        for p in range(len(start)):
            cosine, sine = turn[n, 0] * factor[p, n], turn[n, 1] * factor[p, n]
            for k in range(column.shape[2]):
                d, q = start[p] + column[n, 0, k], start[p] + column[n, 1, k]
                out[n, 0, d] += cosine * value[n, 0, k]
                out[n, 1, d] += sine * value[n, 0, k]
                out[n, 0, q] -= sine * value[n, 1, k]
                out[n, 1, q] += cosine * value[n, 1, k]


@compiled_or(vectorized.add_end_through)
def add_end_through(
    column: ColumnArray,
    value: FloatArray,
    turn: FloatArray,
    start: IntArray,
    factor: FloatArray,
    first: IntArray,
    unknown: IntArray,
    share: FloatArray,
    out: FloatArray,
) -> None:
    """Add the flux at one end of windows to the rows of the regression times a sparse matrix T.

    Parameters
    ----------
    column, value, turn, start, factor
        As of :func:`add_end`.
    first : (size + 1,) int
        Where the entries of each row of T begin.
    unknown, share : (E,)
        Columns and values of these entries.
    out : (N, 2, M) float
    """
    for n in range(column.shape[0]):
        for p in range(len(start)):
            cosine, sine = turn[n, 0] * factor[p, n], turn[n, 1] * factor[p, n]
            for k in range(column.shape[2]):
                d, q = start[p] + column[n, 0, k], start[p] + column[n, 1, k]
                for entry in range(first[d], first[d + 1]):
                    term = value[n, 0, k] * share[entry]
                    out[n, 0, unknown[entry]] += cosine * term
                    out[n, 1, unknown[entry]] += sine * term
                for entry in range(first[q], first[q + 1]):
                    term = value[n, 1, k] * share[entry]
                    out[n, 0, unknown[entry]] -= sine * term
                    out[n, 1, unknown[entry]] += cosine * term


@compiled_or(vectorized.add_block)
def add_block(block: FloatArray, chosen: IntArray, total: FloatArray) -> None:
    """Add the lower triangle of a matrix (K, K) to rows and columns ``chosen`` (K,), rising, of another one."""
    for column in range(len(chosen)):
        for row in range(column, len(chosen)):
            total[chosen[row], chosen[column]] += block[row, column]


def add_products(rows: FloatArray, total: FloatArray) -> None:
    """Add the lower triangle of rows' rows to ``total`` (size, size), passing by columns that are zero.

    Parameters
    ----------
    rows : (N, size) float
        Neighbours in time, whose currents meet few of the basis functions.
    total : (size, size) float, in Fortran's order
    """
    from scipy.linalg.blas import dsyrk  # noqa: PLC0415  # slow to load, and kernels are loaded with the package

    chosen = np.flatnonzero(rows.any(axis=0))
    add_block(dsyrk(1.0, rows[:, chosen].T, lower=1), chosen, total)
