"""B-splines: uniform cubic ones of the paper, and any degree on any knots.

``n`` uniform cubic functions on ``[low, high]`` have ``n - 3`` cells of equal width and equally spaced knots, also
beyond the ends (the P-spline convention, Fahrmeir et al. 2013, section 8.1); in cell ``c`` functions ``c ... c + 3``
are non-zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drive_id.core.numerics.compiled import compiled
from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray, IntArray

_SIXTH = 1 / 6  # divisions are slow


@dataclass(frozen=True)
class Axis:
    """Range of one current, A, with ``count`` cubic B-splines.

    Raises ConfigurationError when the range is empty or ``count`` is below four.
    """

    low: float
    high: float
    count: int

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise ConfigurationError(f"A spline axis from {self.low} A to {self.high} A is empty: give low < high.")
        if self.count < 4:
            raise ConfigurationError(f"{self.count} cubic splines on one axis are too few: give at least 4.")

    @property
    def width(self) -> float:
        """Width of a cell, A."""
        return (self.high - self.low) / (self.count - 3)


@compiled("f8, f8, f8, i8")
def locate(x: float, low: float, width: float, cells: int) -> tuple[int, float]:
    """Return the cell of ``x`` and the position in it, 0 to 1; beyond the ends, the end cell and its edge."""
    position = (x - low) / width
    if not position > 0.0:
        return 0, 0.0
    if position >= cells:
        return cells - 1, 1.0
    cell = int(position)
    return cell, position - cell


@compiled("f8, f8[::1]")
def weights(t: float, w: FloatArray) -> None:
    """Write the values of the four functions at position ``t`` in [0, 1] of their cell into ``w`` (4,)."""
    s = 1.0 - t
    w[0] = s * s * s * _SIXTH
    w[1] = (4.0 + t * t * (3.0 * t - 6.0)) * _SIXTH
    w[2] = (4.0 + s * s * (3.0 * s - 6.0)) * _SIXTH
    w[3] = t * t * t * _SIXTH


@compiled("f8, f8, f8[::1]")
def slopes(t: float, width: float, w: FloatArray) -> None:
    """Write the derivatives of the four functions with respect to the current, 1/A, into ``w`` (4,)."""
    s = 1.0 - t
    w[0] = -0.5 * s * s / width
    w[1] = (1.5 * t - 2.0) * t / width
    w[2] = -(1.5 * s - 2.0) * s / width
    w[3] = 0.5 * t * t / width


@compiled("const f8[::1], const f8[::1], i8, i8[::1], f8[:, ::1]")
def spline_values(x: FloatArray, knots: FloatArray, degree: int, cell: IntArray, w: FloatArray) -> None:
    """Evaluate B-splines at points (N,), those beyond the ends moved to them, by the Cox-de Boor recursion.

    The knots (C + 1 + 2 degree,) increase, ``degree`` of them before and behind the edges of the cells, clamped or not.
    Writes the first non-zero function into ``cell`` (N,), and the values of it and its successors into ``w`` (N, degree
    + 1).
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


@compiled("const i8[::1], const f8[:, ::1], const i8[::1], const f8[:, ::1], i8, i8, i4[:, :], f8[:, :]")
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
    """Multiply the splines of two axes, see :func:`spline_values`, and write columns and values (N, K) of the products.

    The second axis has ``count_q`` functions; ``offset`` is the column of the first product.
    """
    for n in range(len(cell_d)):
        k = 0
        for a in range(w_d.shape[1]):
            first = offset + (cell_d[n] + a) * count_q + cell_q[n]
            for b in range(w_q.shape[1]):
                column[n, k] = first + b
                value[n, k] = w_d[n, a] * w_q[n, b]
                k += 1
