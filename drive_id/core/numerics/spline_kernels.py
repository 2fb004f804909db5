"""B-splines of any degree on any knots, and their tensor products, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray, IntArray


@compiled
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


@compiled
def tensor_products(
    cell_d: IntArray,
    w_d: FloatArray,
    cell_q: IntArray,
    w_q: FloatArray,
    count_q: int,
    offset: int,
    column: NDArray[np.int32],
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
