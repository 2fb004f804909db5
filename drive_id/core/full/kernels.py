"""The inner loops of method ``full``: rows of the regression over windows, sums of their products."""

from __future__ import annotations

import numpy as np

from drive_id.core.maps.flux_models import ColumnArray
from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray, IntArray


@compiled
def add_end(
    column: ColumnArray, value: FloatArray, turn: FloatArray, start: IntArray, factor: FloatArray, out: FloatArray
) -> None:
    """Add the flux at one end of windows to the rows of the regression, for all maps in one space.

    Parameters
    ----------
    column, value : (N, 2, K)
        Basis functions, see :class:`~drive_id.core.maps.flux_models.BasisRows`; no column twice in a row.
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


@compiled
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


@compiled
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
