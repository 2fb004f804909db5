"""Uniform cubic B-splines: weights of the four functions that live in a cell, and their slopes.

``n`` functions on ``[low, high]`` have ``n - 3`` cells of equal width and equally spaced knots also beyond the ends
(the P-spline convention, Fahrmeir et al. 2013, section 8.1); in cell ``c`` functions ``c ... c + 3`` are non-zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.core.numerics.compiled import compiled
from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray

_SIXTH = 1 / 6  # a division takes longer than all the rest of the weights


@dataclass(frozen=True)
class Axis:
    """A range of one current, A, divided for ``count`` cubic B-splines.

    Raises
    ------
    ConfigurationError
        When the range is empty or fewer than four functions are asked for.
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

    def sites(self) -> FloatArray:
        """Return ``count`` equally spaced points over the range, ends included, at which interpolation is unique."""
        return np.linspace(self.low, self.high, self.count)

    def collocation(self, points: FloatArray) -> FloatArray:
        """Return the dense matrix (len(points), count) of all functions at points within the range."""
        knots = self.low + self.width * np.arange(-3, self.count + 1)
        return basis_matrix(np.clip(points, knots[3], knots[-4]), np.asarray(knots, np.float64))


@compiled
def locate(x: float, low: float, width: float, cells: int) -> tuple[int, float]:
    """Return the cell that holds ``x`` and the position in it; beyond the ends, the end cell and its edge."""
    position = (x - low) / width
    if not position > 0.0:
        return 0, 0.0
    if position >= cells:
        return cells - 1, 1.0
    cell = int(position)
    return cell, position - cell


@compiled
def weights(t: float, w: FloatArray) -> None:
    """Write the values of the four functions at position ``t`` in [0, 1] of their cell into ``w`` (4,)."""
    s = 1.0 - t
    w[0] = s * s * s * _SIXTH
    w[1] = (4.0 + t * t * (3.0 * t - 6.0)) * _SIXTH
    w[2] = (4.0 + s * s * (3.0 * s - 6.0)) * _SIXTH
    w[3] = t * t * t * _SIXTH


@compiled
def slopes(t: float, width: float, w: FloatArray) -> None:
    """Write the derivatives of the four functions with respect to the current, 1/A, into ``w`` (4,)."""
    s = 1.0 - t
    w[0] = -0.5 * s * s / width
    w[1] = (1.5 * t - 2.0) * t / width
    w[2] = -(1.5 * s - 2.0) * s / width
    w[3] = 0.5 * t * t / width


def basis_matrix(points: FloatArray, knots: FloatArray) -> FloatArray:
    """Return all cubic B-splines of the knots at points between ``knots[3]`` and ``knots[-4]``, by de Boor's recursion.

    Parameters
    ----------
    points : (N,) float
    knots : (n + 4,) float
        Not falling.

    Returns
    -------
    (N, n) float
    """
    count = len(knots) - 4
    cell = np.clip(np.searchsorted(knots, points, side="right") - 1, 3, count - 1)
    value = np.ones((1, len(points)))
    for degree in range(1, 4):
        below = np.array([knots[cell - j] for j in range(degree - 1, -1, -1)])
        above = np.array([knots[cell + j] for j in range(1, degree + 1)])
        share = value / (above - below)
        value = np.zeros((degree + 1, len(points)))
        value[:-1] = share * (above - points)
        value[1:] += share * (points - below)
    out = np.zeros((len(points), count))
    out[np.arange(len(points))[:, None], cell[:, None] + np.arange(-3, 1)] = value.T
    return out


def interpolation_matrix(nodes: FloatArray, points: FloatArray) -> FloatArray:
    """Return what the values at the nodes weigh in the not-a-knot cubic spline through them at the points.

    Parameters
    ----------
    nodes : (n,) float
        Rising, at least 4.
    points : (N,) float
        Within the nodes.

    Returns
    -------
    (N, n) float
    """
    knots = np.concatenate([np.repeat(nodes[0], 4), nodes[2:-2], np.repeat(nodes[-1], 4)])
    weights = np.linalg.solve(basis_matrix(nodes, knots).T, basis_matrix(points, knots).T)
    return np.asarray(weights.T)
