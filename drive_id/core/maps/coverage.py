"""Coverage of the current plane: counts per grid node, the mask of a map, and the share of the disc."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.core.numerics.running_sums import SavedSums, exactly
from drive_id.types import BoolArray, FloatArray, IntArray

FLUX_CELLS = 16
"""Usual cells per axis of the map of method ``full``, whose data cover the disc where no hole is wider than a cell."""
_STRAY_SHARE = 0.1  # of the typical count of a node, below which samples beyond the rim count as stray
_NEAR = 1e-9  # nodes, by which a node may lie beyond a line on which it is, by rounding
_ROUNDING = 1 + 1e-9  # holes are mostly a whole number of nodes wide, which must not depend on rounding


def enclosed(inside: BoolArray) -> BoolArray:
    """Tell (D, Q) which nodes lie on straight lines between those of a mask: its convex hull."""
    rows = np.flatnonzero(inside.any(axis=1))
    if len(rows) == 0:
        return np.array(inside)
    column, every = np.arange(inside.shape[1]), np.arange(rows[0], rows[-1] + 1)
    last = _bulged(rows, np.where(inside, column, -1).max(axis=1)[rows], every)
    first = -_bulged(rows, -np.where(inside, column, inside.shape[1]).min(axis=1)[rows], every)
    out = np.array(inside)
    out[every] |= (column >= first[:, None] - _NEAR) & (column <= last[:, None] + _NEAR)
    return out


def _bulged(x: IntArray, y: IntArray, at: IntArray) -> FloatArray:
    """Return the least concave function above points (N,), x increasing, at other places (K,) between them."""
    kept: list[int] = []
    for k in range(len(x)):
        while len(kept) > 1 and (y[kept[-1]] - y[kept[-2]]) * (x[k] - x[kept[-1]]) <= (y[k] - y[kept[-1]]) * (
            x[kept[-1]] - x[kept[-2]]
        ):
            kept.pop()
        kept.append(k)
    return np.asarray(np.interp(at, x[kept], y[kept].astype(np.float64)))


class Visits:
    """Counts of samples at the nodes of a map's grid.

    Parameters
    ----------
    i_d, i_q : (D,), (Q,) float
        Equally spaced axes, A.
    """

    def __init__(self, i_d: FloatArray, i_q: FloatArray) -> None:
        self.i_d = i_d
        self.i_q = i_q
        self.count: IntArray = np.zeros((len(i_d), len(i_q)), np.int64)

    def add(self, i_dq: FloatArray) -> None:
        """Count samples (N, 2), A, at their nearest nodes; those off the grid are left out."""
        # Not compiled: the trajectory publisher calls this at its first start and must not wait for numba.
        d, on_d = _cells(i_dq[:, 0], _edges(self.i_d))
        q, on_q = _cells(i_dq[:, 1], _edges(self.i_q))
        cell = (d * len(self.i_q) + q)[on_d & on_q]
        self.count += np.bincount(cell, minlength=self.count.size).reshape(self.count.shape)

    def copy(self) -> Visits:
        """Return an independent copy."""
        other = Visits(self.i_d, self.i_q)
        other.count = self.count.copy()
        return other

    def merge(self, other: Visits) -> None:
        """Add the counts of other samples on the same grid."""
        self.count += other.count

    def state(self) -> SavedSums:
        """Return the counts as arrays."""
        return {"count": self.count.copy()}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state, see :class:`~drive_id.core.numerics.running_sums.Accumulator`."""
        self.count = exactly(state["count"], self.count)

    def grid(self) -> FloatArray:
        """Return the currents of all nodes, (D, Q, 2), A."""
        return np.stack(np.meshgrid(self.i_d, self.i_q, indexing="ij"), axis=-1)

    def inside(self, hole_d: float, hole_q: float) -> BoolArray:
        """Tell (D, Q) where data support the map: visited nodes and small holes between them.

        Parameters
        ----------
        hole_d, hole_q : float
            Largest hole that a model of this resolution bridges, A. Nothing is added outside the visited region.
        """
        radius_d = max(1.0, _ROUNDING * hole_d / 2 / (self.i_d[1] - self.i_d[0]))
        radius_q = max(1.0, _ROUNDING * hole_q / 2 / (self.i_q[1] - self.i_q[0]))
        reach_d, reach_q = int(radius_d), int(radius_q)
        grid = np.ogrid[-reach_d : reach_d + 1, -reach_q : reach_q + 1]
        ball = (grid[0] / radius_d) ** 2 + (grid[1] / radius_q) ** 2 <= 1.0
        typical = float(np.median(self.count[self.count > 0])) if self.count.any() else 0.0
        visited = self.count > _STRAY_SHARE * typical  # stray samples beyond the rim do not count
        padded = np.pad(visited, ((reach_d, reach_d), (reach_q, reach_q)))
        closed = ~_dilated(~_dilated(padded, ball), ball)
        return closed[reach_d:-reach_d, reach_q:-reach_q]


def _dilated(mask: BoolArray, ball: BoolArray) -> BoolArray:
    """Dilate the mask (D, Q), empty beyond its edges, by a symmetric convex ball."""
    reach, count = len(ball) // 2, len(mask)
    steps = np.arange(mask.shape[1])
    sums = np.pad(np.cumsum(mask, axis=1), ((0, 0), (1, 0)))
    out = np.zeros_like(mask)
    for shift, half in zip(range(-reach, reach + 1), ball.sum(axis=1) // 2, strict=True):
        first, last = max(shift, 0), min(count, count + shift)
        near = sums[:, np.minimum(steps + half + 1, len(steps))] > sums[:, np.maximum(steps - half, 0)]
        out[first - shift : last - shift] |= near[first:last]
    return out


def _edges(axis: FloatArray) -> FloatArray:
    half = (axis[1] - axis[0]) / 2
    return np.append(axis - half, axis[-1] + half)


def _cells(x: FloatArray, edges: FloatArray) -> tuple[IntArray, BoolArray]:
    """Return for each value (N,) its cell between the edges (C + 1,) and whether it lies within them."""
    cell = np.searchsorted(edges, x, side="right") - 1
    cell = np.where(x == edges[-1], len(edges) - 2, cell)
    return cell, (cell >= 0) & (cell < len(edges) - 1)


def disc_coverage(i_d: FloatArray, i_q: FloatArray, inside: BoolArray, i_max: float) -> float:
    """Return the share (0 to 1) of the disc of radius ``i_max``, A, that the mask (D, Q) covers."""
    near, total = disc_points(i_d, i_q, i_max)
    return float(near[inside].sum() / total)


def disc_points(i_d: FloatArray, i_q: FloatArray, i_max: float) -> tuple[IntArray, int]:
    """Return how many of equally spaced points of the disc lie nearest to each node (D, Q), and how many there are."""
    fine = np.linspace(-i_max, i_max, 201)
    node_d = np.rint(np.interp(fine, i_d, np.arange(len(i_d)), left=-1, right=-1)).astype(np.int64)
    node_q = np.rint(np.interp(fine, i_q, np.arange(len(i_q)), left=-1, right=-1)).astype(np.int64)
    disc = fine[:, None] ** 2 + fine**2 <= i_max**2
    counted = disc & (node_d >= 0)[:, None] & (node_q >= 0)
    cell = (node_d[:, None] * len(i_q) + node_q)[counted]
    return np.bincount(cell, minlength=len(i_d) * len(i_q)).reshape(len(i_d), len(i_q)), int(disc.sum())


def smoothed(values: FloatArray, mask: BoolArray, reach: int = 5) -> FloatArray:
    """Return at each node (D, Q) the mean of the values at masked nodes within ``reach`` nodes along each axis."""
    side = 2 * reach + 1
    padded = [np.pad(np.where(mask, array, 0.0), reach) for array in (values, np.ones_like(values))]
    view = np.lib.stride_tricks.sliding_window_view
    sums = [view(view(array, side, 0).sum(axis=-1), side, 1).sum(axis=-1) for array in padded]
    return np.asarray(np.divide(sums[0], sums[1], out=np.zeros_like(sums[0]), where=sums[1] > 0))
