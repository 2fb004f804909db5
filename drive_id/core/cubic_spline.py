"""Cubic splines on any knots as dense matrices: a few points or nodes, where loading scipy would take longer."""

from __future__ import annotations

import numpy as np

from drive_id.types import FloatArray


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
