"""Where scattered points support a map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from drive_id.types import BoolArray, FloatArray

_NEIGHBOURS = 4  # of a point: their distance is the typical spacing, also of a grid
_HOLE = 2.5
"""Radius of the largest hole between the points that a map bridges, in typical distances of the fourth neighbour."""
_ROUNDING = 1e-9  # of currents, relative to the largest


@dataclass(frozen=True, eq=False)
class Support:
    """The convex hull of points, without large holes."""

    points: FloatArray  # (N, 2), distinct, not all on one line, A

    @classmethod
    def of(cls, points: FloatArray) -> Support:
        """Return the support of points (N, 2), of which some may coincide."""
        size = np.abs(points).max()
        _, first = np.unique(np.round(points / size / _ROUNDING), axis=0, return_index=True)
        return cls(points[np.sort(first)])

    @cached_property
    def hole(self) -> float:
        """Radius of the largest hole that counts as supported, A."""
        distances, _ = self._tree.query(self.points, min(_NEIGHBOURS + 1, len(self.points)))
        return _HOLE * float(np.median(distances[:, -1]))

    def contains(self, i_dq: FloatArray) -> BoolArray:
        """Tell (N,) which of the currents (N, 2), A, lie in the hull, its edge included, and not in a hole."""
        near, _ = self._tree.query(i_dq)
        return np.asarray(self.in_hull(i_dq) & (near <= self.hole))

    def in_hull(self, i_dq: FloatArray) -> BoolArray:
        """Tell (N,) which of the currents (N, 2), A, lie in the convex hull of the points, its edge included."""
        tolerance = _ROUNDING * np.abs(self.points).max()
        return np.asarray((i_dq @ self._hull[:, :2].T + self._hull[:, 2] <= tolerance).all(axis=1))

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points)

    @cached_property
    def _hull(self) -> FloatArray:
        """Normals and offsets of the hull's edges (E, 3)."""
        return np.asarray(ConvexHull(self.points).equations)
