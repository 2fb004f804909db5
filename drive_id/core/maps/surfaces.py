"""Both flux linkages as splines over the current plane: values, slopes and inverse."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drive_id.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import KDTree

_STEPS = 40  # of Newton's method at most
_HALVINGS = 12  # of a step that leads away
_CONVERGED = 1e-10  # distance of the fluxes, by their ranges, at which a point is done
_ACCEPTED = 1e-6  # the same, up to which a point without further progress counts
_LEAST_DETERMINANT = 1e-3
"""Of the inductance matrix, relative to the square of its norm; below it Newton's step is damped."""


@dataclass(frozen=True, eq=False)
class Bicubic:
    """A function on a grid, bicubic in each cell. Build it by :meth:`over` or :meth:`through`."""

    x: FloatArray  # (D,)
    y: FloatArray  # (Q,)
    cells: FloatArray  # (D - 1, Q - 1, 4, 4), value and slope at both ends of each cell, along x and along y

    @classmethod
    def over(cls, x: FloatArray, y: FloatArray, value: FloatArray) -> Bicubic:
        """Interpolate values (D, Q) by cubic splines, of at least four points along each axis."""
        by_y = _slopes(y, value.T).T
        return cls.through(x, y, value, _slopes(x, value), by_y, _slopes(x, by_y))

    @classmethod
    def through(
        cls, x: FloatArray, y: FloatArray, value: FloatArray, by_x: FloatArray, by_y: FloatArray, mixed: FloatArray
    ) -> Bicubic:
        """Take values and derivatives (D, Q) at the nodes; values and slopes are continuous everywhere."""
        nodes = np.stack([np.stack([value, by_y], axis=-1), np.stack([by_x, mixed], axis=-1)], axis=-2)
        along_x = np.concatenate([nodes[:-1], nodes[1:]], axis=-2)
        return cls(x, y, np.concatenate([along_x[:, :-1], along_x[:, 1:]], axis=-1))

    def ev(self, x: FloatArray, y: FloatArray, dx: int = 0, dy: int = 0) -> FloatArray:
        """Return the function, or its first derivatives by x and y, at places (...) within the nodes."""
        (of_x, along_x), (of_y, along_y) = _weights(self.x, x, dx), _weights(self.y, y, dy)
        return np.asarray(np.einsum("...i,...ij,...j", along_x, self.cells[of_x, of_y], along_y))


def _slopes(x: FloatArray, value: FloatArray) -> FloatArray:
    """Return the slopes (N, K) of cubic splines through values (N, K), not-a-knot at both ends (de Boor 1978)."""
    step, matrix, right = np.diff(x), np.zeros((len(x), len(x))), np.empty_like(value)
    rise, inner = np.diff(value, axis=0) / step[:, None], np.arange(1, len(x) - 1)
    matrix[inner, inner - 1], matrix[inner, inner + 1] = step[1:], step[:-1]
    matrix[inner, inner] = 2 * (step[1:] + step[:-1])
    right[1:-1] = 3 * (step[1:, None] * rise[:-1] + step[:-1, None] * rise[1:])
    for end, beside in ((0, 1), (-1, -2)):
        own, both = step[end], step[end] + step[beside]
        matrix[end, [end, beside]] = step[beside], both
        right[end] = ((own + 2 * both) * step[beside] * rise[end] + own**2 * rise[beside]) / both
    return np.asarray(np.linalg.solve(matrix, right))


def _weights(nodes: FloatArray, x: FloatArray, derivative: int) -> tuple[IntArray, FloatArray]:
    """Return the cell of each place (...), and the weights (..., 4) of value and slope at both ends of it."""
    cell = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    width = nodes[cell + 1] - nodes[cell]
    t = (x - nodes[cell]) / width
    s = 1.0 - t
    if derivative:
        rise = 6.0 * t * s / width
        return cell, np.stack([-rise, s * (1.0 - 3.0 * t), rise, t * (3.0 * t - 2.0)], axis=-1)
    return cell, np.stack([s * s * (1.0 + 2.0 * t), width * t * s * s, t * t * (3.0 - 2.0 * t), -width * t * t * s], -1)


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Cubic splines through two functions of (i_d, i_q), linear beyond their grid.

    Build them by :meth:`over`, or by :meth:`around` a map.
    """

    i_d: FloatArray  # (D,), A
    i_q: FloatArray  # (Q,), A
    d: Bicubic
    q: Bicubic

    @classmethod
    def over(cls, i_d: FloatArray, i_q: FloatArray, values_d: FloatArray, values_q: FloatArray) -> Surfaces:
        """Interpolate values (D, Q)."""
        return cls(i_d, i_q, Bicubic.over(i_d, i_q, values_d), Bicubic.over(i_d, i_q, values_q))

    @classmethod
    def around(
        cls, own: Surfaces, known: BoolArray, i_d: FloatArray, i_q: FloatArray, values: tuple[FloatArray, FloatArray]
    ) -> Surfaces:
        """Continue surfaces without a change where they are known: in all cells whose four corners are.

        Parameters
        ----------
        known : (D, Q) bool
            Nodes at which ``own`` counts; they are among its own.
        i_d, i_q : (D,), (Q,) float
            A.
        values : ((D, Q), (D, Q)) of float
            Both functions at all nodes.
        """
        at = np.nonzero(known)
        beyond, parts = cls.over(i_d, i_q, *values), []
        for spline, inner, value in zip((beyond.d, beyond.q), (own.d, own.q), values, strict=True):
            slopes = []
            for dx, dy in ((1, 0), (0, 1), (1, 1)):
                slope = spline.ev(*np.meshgrid(i_d, i_q, indexing="ij"), dx=dx, dy=dy)
                slope[at] = inner.ev(i_d[at[0]], i_q[at[1]], dx=dx, dy=dy)
                slopes.append(slope)
            parts.append(Bicubic.through(i_d, i_q, value, *slopes))
        return cls(i_d, i_q, *parts)

    def values(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Return both functions (..., 2) at currents (...), A."""
        d, q = self._clipped(i_d, i_q)
        beyond = np.any((d != i_d) | (q != i_q))
        out = []
        for spline in (self.d, self.q):
            value = spline.ev(d, q)
            if beyond:
                value = value + (i_d - d) * spline.ev(d, q, dx=1) + (i_q - q) * spline.ev(d, q, dy=1)
            out.append(value)
        return np.stack(out, axis=-1)

    def slopes(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Return the derivatives (..., 2, 2) by i_d and i_q (last axis) at currents (...), A."""
        d, q = self._clipped(i_d, i_q)
        off_d, off_q = i_d - d, i_q - q
        rows = []
        for spline in (self.d, self.q):
            by_d, by_q = spline.ev(d, q, dx=1), spline.ev(d, q, dy=1)
            if off_d.any() or off_q.any():  # along an edge, the slope across it changes
                mixed = spline.ev(d, q, dx=1, dy=1)
                by_d = by_d + np.where(off_d == 0, off_q * mixed, 0.0)
                by_q = by_q + np.where(off_q == 0, off_d * mixed, 0.0)
            rows.append(np.stack([by_d, by_q], axis=-1))
        return np.stack(rows, axis=-2)

    def inverse(self, wanted: FloatArray) -> FloatArray:
        """Return the currents (N, 2), A, of values (N, 2), NaN where none is found.

        Newton's method from the nearest grid point; a step is halved until it reduces the distance.
        """
        tree, grid, scale = self._search
        out = np.full(wanted.shape, np.nan)
        known = np.isfinite(wanted).all(axis=1)
        goal = wanted[known]
        i_dq = grid[tree.query(goal / scale)[1]].copy()
        error = goal - self.values(i_dq[:, 0], i_dq[:, 1])
        distance = np.hypot(*(error / scale).T)
        stuck = np.zeros(len(goal), np.bool_)
        for _ in range(_STEPS):
            going = np.flatnonzero((distance > _CONVERGED) & ~stuck)
            if not len(going):
                break
            step = _newton_step(self.slopes(i_dq[going, 0], i_dq[going, 1]), error[going])
            for _ in range(_HALVINGS):
                tried = i_dq[going] + step
                left = goal[going] - self.values(tried[:, 0], tried[:, 1])
                size = np.hypot(*(left / scale).T)
                better = size < distance[going]
                at = going[better]
                i_dq[at], error[at], distance[at] = tried[better], left[better], size[better]
                going, step = going[~better], step[~better] / 2
                if not len(going):
                    break
            stuck[going] = True
        i_dq[distance > _ACCEPTED] = np.nan
        out[known] = i_dq
        return out

    def _clipped(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.clip(i_d, self.i_d[0], self.i_d[-1]), np.clip(i_q, self.i_q[0], self.i_q[-1])

    @cached_property
    def _search(self) -> tuple[KDTree, FloatArray, FloatArray]:
        """Return a tree of the values at all grid points over their ranges, their currents (N, 2), and the ranges."""
        from scipy.spatial import KDTree  # noqa: PLC0415  # only the inverse needs it

        grid = np.stack(np.meshgrid(self.i_d, self.i_q, indexing="ij"), axis=-1).reshape(-1, 2)
        values = self.values(grid[:, 0], grid[:, 1])
        scale = np.ptp(values, axis=0)
        return KDTree(values / scale), grid, scale


def _newton_step(slopes: FloatArray, error: FloatArray) -> FloatArray:
    """Return J^-1 e (N, 2), damped where J is nearly singular."""
    norm = np.sum(slopes**2, axis=(1, 2))
    weak = np.abs(np.linalg.det(slopes)) < _LEAST_DETERMINANT * norm
    transposed = np.swapaxes(slopes, 1, 2)
    normal = transposed @ slopes + np.where(weak, _LEAST_DETERMINANT * norm, 0.0)[:, None, None] * np.eye(2)
    return np.asarray(np.linalg.solve(normal, transposed @ error[..., None])[..., 0])
