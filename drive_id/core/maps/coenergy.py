"""Co-energy splines and their gradients: reciprocal and free flux maps in one space.

The co-energy W(i_d, i_q) is a tensor-product B-spline of degree p on both axes. Its derivative by i_d has degree p - 1
along i_d and p along i_q, its derivative by i_q the reverse. A flux map with independent coefficients in these two
spaces is *free*; ``gamma = G w`` makes it the gradient of a co-energy with coefficients w, hence reciprocal,
``L_dq = L_qd``. A normal matrix N accumulated for the free map serves the reciprocal one as ``G' N G``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from drive_id.core.maps.flux_models import BasisRows
from drive_id.core.numerics.bspline import spline_values, tensor_products
from drive_id.errors import ConfigurationError
from drive_id.types import BoolArray, FloatArray, IntArray

_BEND = 2.0
"""Cells at zero current are ``cosh(_BEND)``, about 3.8, times narrower than at the rim: iron bridges saturate early."""


def bent_edges(low: float, high: float, cells: int, bend: float = _BEND) -> FloatArray:
    """Return cells + 1 edges over [low, high], A: ``I sinh(bend z) / sinh(bend)`` of equally spaced z."""
    if not (np.isfinite(low) and np.isfinite(high) and low < high and cells >= 1):
        raise ConfigurationError(f"{cells} cells from {low} A to {high} A: give low < high and at least one cell.")
    largest = max(abs(low), abs(high))
    ends = np.arcsinh(np.array([low, high]) / largest * np.sinh(bend)) / bend
    edges = largest * np.sinh(bend * np.linspace(ends[0], ends[1], cells + 1)) / np.sinh(bend)
    edges[0], edges[-1] = low, high
    return np.asarray(edges)


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """B-splines on cells of any width, clamped at the ends.

    Parameters
    ----------
    edges : (C + 1,) float
        Edges of the cells, strictly increasing, A.
    """

    edges: FloatArray
    degree: int

    @property
    def count(self) -> int:
        """Number of functions, C + degree."""
        return len(self.edges) - 1 + self.degree

    @cached_property
    def knots(self) -> FloatArray:
        """The edges with the ends repeated, (C + 1 + 2 degree,), A."""
        ends = np.full(self.degree, self.edges[0]), np.full(self.degree, self.edges[-1])
        return np.concatenate([ends[0], self.edges, ends[1]])

    def values(self, x: FloatArray) -> tuple[IntArray, FloatArray]:
        """Evaluate the functions.

        Parameters
        ----------
        x : (N,) float
            A; values beyond the ends are moved to them.

        Returns
        -------
        (N,) int, (N, degree + 1) float
            First non-zero function, and the values of it and its successors.
        """
        cell, w = np.empty(len(x), np.int64), np.empty((len(x), self.degree + 1))
        spline_values(np.ascontiguousarray(x), self.knots, self.degree, cell, w)
        return cell, w

    def slopes(self, x: FloatArray) -> tuple[IntArray, FloatArray]:
        """Evaluate the derivatives, 1/A, as :meth:`values`."""
        cell, lower = self._lower.values(x)
        share = self._steepness[cell] * lower
        w = np.zeros((len(x), self.degree + 1))
        w[:, :-1] = -share
        w[:, 1:] += share
        return cell, w

    def derivative(self) -> sparse.csr_array:
        """Return the matrix (count - 1, count) from coefficients to those of the derivative, one degree lower."""
        width = self.knots[self.degree + 1 : self.degree + self.count] - self.knots[1 : self.count]
        step = sparse.diags_array([-1.0, 1.0], offsets=[0, 1], shape=(self.count - 1, self.count))
        return sparse.csr_array(sparse.diags_array(self.degree / width) @ step)

    @cached_property
    def _lower(self) -> SplineBasis:
        return SplineBasis(self.edges, self.degree - 1)

    @cached_property
    def _steepness(self) -> FloatArray:
        """Degree over the width of the support (C, degree) of the lower splines that each cell meets, 1/A."""
        knot = np.arange(len(self.edges) - 1)[:, None] + self.degree
        after, before = (self.knots[knot + np.arange(first, first + self.degree)] for first in (1, 1 - self.degree))
        return np.asarray(self.degree / (after - before))


@dataclass(frozen=True, eq=False)
class GradientSpline:
    """Flux maps in the space of gradients of a co-energy spline: a :class:`~.flux_models.FluxModel`.

    The parameters of psi_d, row-major in [i_d, i_q], come before those of psi_q.

    Parameters
    ----------
    d, q : (C + 1,) float
        Edges of the cells along i_d and i_q, A.
    degree : int
        Of the co-energy, at least 2.
    """

    d: FloatArray
    q: FloatArray
    degree: int

    @classmethod
    def within(cls, low: FloatArray, high: FloatArray, cells: int, degree: int) -> GradientSpline:
        """Divide the rectangle from ``low`` (2,) to ``high`` (2,), A, into cells that are finer at zero current."""
        return cls(bent_edges(low[0], high[0], cells), bent_edges(low[1], high[1], cells), degree)

    @property
    def parameters(self) -> int:
        """Number of coefficients, for both fluxes."""
        return self._count_d + self._count_q

    @property
    def _count_d(self) -> int:
        return (self._low_d.count) * self._high_q.count

    @property
    def _count_q(self) -> int:
        return self._high_d.count * self._low_q.count

    @cached_property
    def _low_d(self) -> SplineBasis:
        return SplineBasis(self.d, self.degree - 1)

    @cached_property
    def _high_d(self) -> SplineBasis:
        return SplineBasis(self.d, self.degree)

    @cached_property
    def _low_q(self) -> SplineBasis:
        return SplineBasis(self.q, self.degree - 1)

    @cached_property
    def _high_q(self) -> SplineBasis:
        return SplineBasis(self.q, self.degree)

    def rows(self, i_dq: FloatArray) -> BasisRows:
        """Return B at currents (N, 2), A; currents outside the range are moved to its edge."""
        i_d, i_q = i_dq[:, 0], i_dq[:, 1]
        return self._joined(
            self._low_d.values(i_d), self._high_q.values(i_q), self._high_d.values(i_d), self._low_q.values(i_q)
        )

    def slope_rows(self, i_dq: FloatArray) -> tuple[BasisRows, BasisRows]:
        """Return dB/di_d and dB/di_q at currents (N, 2), A."""
        i_d, i_q = i_dq[:, 0], i_dq[:, 1]
        slopes_d = self._joined(
            self._low_d.slopes(i_d), self._high_q.values(i_q), self._high_d.slopes(i_d), self._low_q.values(i_q)
        )
        slopes_q = self._joined(
            self._low_d.values(i_d), self._high_q.slopes(i_q), self._high_d.values(i_d), self._low_q.slopes(i_q)
        )
        return slopes_d, slopes_q

    def contains(self, i_dq: FloatArray) -> BoolArray:
        """Tell (N,) which of the currents (N, 2), A, lie in the rectangle of the cells."""
        low, high = np.array([self.d[0], self.q[0]]), np.array([self.d[-1], self.q[-1]])
        return np.asarray(((i_dq >= low) & (i_dq <= high)).all(axis=1))

    @cached_property
    def potential(self) -> PotentialSpline:
        """The reciprocal maps of this space, by the coefficients of their co-energy."""
        return PotentialSpline(self._high_d, self._high_q)

    @cached_property
    def gradient(self) -> sparse.csr_array:
        """G (parameters, potentials): ``gamma = G w`` is the gradient of the co-energy with coefficients w."""
        psi_d = sparse.kron(self._high_d.derivative(), sparse.eye_array(self._high_q.count))
        psi_q = sparse.kron(sparse.eye_array(self._high_d.count), self._high_q.derivative())
        return sparse.csr_array(sparse.vstack([psi_d, psi_q]))

    @cached_property
    def roughness(self) -> sparse.csr_array:
        """P (parameters, parameters): ``gamma' P gamma`` sums the squared second differences of the coefficients."""
        d = _differences(self._low_d.count, self._high_q.count)
        q = _differences(self._high_d.count, self._low_q.count)
        return sparse.csr_array(sparse.block_diag([d, q]))

    def _joined(
        self,
        d_low: tuple[IntArray, FloatArray],
        q_high: tuple[IntArray, FloatArray],
        d_high: tuple[IntArray, FloatArray],
        q_low: tuple[IntArray, FloatArray],
    ) -> BasisRows:
        functions = d_low[1].shape[1] * q_high[1].shape[1]
        column, value = np.empty((len(d_low[0]), 2, functions), np.int32), np.empty((len(d_low[0]), 2, functions))
        tensor_products(*d_low, *q_high, self._high_q.count, 0, column[:, 0], value[:, 0])
        tensor_products(*d_high, *q_low, self._low_q.count, self._count_d, column[:, 1], value[:, 1])
        return BasisRows(column, value)


@dataclass(frozen=True, eq=False)
class PotentialSpline:
    """Gradients of a co-energy spline, by its coefficients w, row-major in [i_d, i_q]: ``f = B w``.

    The first coefficient is as good as free: the sum of all functions is constant.
    """

    d: SplineBasis
    q: SplineBasis

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return self.d.count * self.q.count

    def rows(self, i_dq: FloatArray) -> BasisRows:
        """Return B at currents (N, 2), A: both fluxes have the same columns."""
        i_d, i_q = i_dq[:, 0], i_dq[:, 1]
        functions = (self.d.degree + 1) * (self.q.degree + 1)
        column, value = np.empty((len(i_d), 2, functions), np.int32), np.empty((len(i_d), 2, functions))
        sides = (self.d.slopes(i_d), self.q.values(i_q)), (self.d.values(i_d), self.q.slopes(i_q))
        for flux, (along_d, along_q) in enumerate(sides):
            tensor_products(*along_d, *along_q, self.q.count, 0, column[:, flux], value[:, flux])
        return BasisRows(column, value)


def _differences(count_d: int, count_q: int) -> sparse.coo_array:
    along_d = np.diff(np.eye(count_d), 2, axis=0)
    along_q = np.diff(np.eye(count_q), 2, axis=0)
    return sparse.coo_array(
        sparse.kron(along_d.T @ along_d, sparse.eye_array(count_q))
        + sparse.kron(sparse.eye_array(count_d), along_q.T @ along_q)
    )
