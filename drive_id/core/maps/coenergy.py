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

from drive_id.core.maps.flux_models import BasisRows, FluxModel
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
    """B-splines on cells of any width, clamped at the ends."""

    edges: FloatArray  # (C + 1,), of the cells, strictly increasing, A
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
class GradientSpline(FluxModel):
    """Flux maps in the space of gradients of a co-energy spline.

    The parameters of psi_d, row-major in [i_d, i_q], come before those of psi_q.
    """

    d: FloatArray  # (C + 1,), edges of the cells along i_d, A
    q: FloatArray  # along i_q
    degree: int  # of the co-energy, at least 2

    @classmethod
    def within(cls, low: FloatArray, high: FloatArray, cells: int, degree: int) -> GradientSpline:
        """Divide the rectangle from ``low`` (2,) to ``high`` (2,), A, into cells that are finer at zero current."""
        return cls(bent_edges(low[0], high[0], cells), bent_edges(low[1], high[1], cells), degree)

    @property
    def parameters(self) -> int:
        """Number of coefficients, for both fluxes."""
        return sum(d.count * q.count for d, q in self._bases)

    @cached_property
    def _bases(self) -> tuple[tuple[SplineBasis, SplineBasis], tuple[SplineBasis, SplineBasis]]:
        """Splines along i_d and i_q of psi_d, and those of psi_q: of a degree less along the flux's own current."""
        d, q = SplineBasis(self.d, self.degree), SplineBasis(self.q, self.degree)
        return (SplineBasis(self.d, self.degree - 1), q), (d, SplineBasis(self.q, self.degree - 1))

    def _rows(self, i_dq: FloatArray, order_d: int, order_q: int) -> BasisRows:
        (d, q), _ = self._bases
        return _products(i_dq, self._bases, ((order_d, order_q),) * 2, (0, d.count * q.count))

    def contains(self, i_dq: FloatArray) -> BoolArray:
        """Tell (N,) which of the currents (N, 2), A, lie in the rectangle of the cells."""
        low, high = np.array([self.d[0], self.q[0]]), np.array([self.d[-1], self.q[-1]])
        return np.asarray(((i_dq >= low) & (i_dq <= high)).all(axis=1))

    @cached_property
    def potential(self) -> PotentialSpline:
        """The reciprocal maps of this space, by the coefficients of their co-energy."""
        (_, q), (d, _) = self._bases
        return PotentialSpline(d, q)

    @cached_property
    def gradient(self) -> sparse.csr_array:
        """G (parameters, potentials): ``gamma = G w`` is the gradient of the co-energy with coefficients w."""
        (_, q), (d, _) = self._bases
        psi_d = sparse.kron(d.derivative(), sparse.eye_array(q.count))
        psi_q = sparse.kron(sparse.eye_array(d.count), q.derivative())
        return sparse.csr_array(sparse.vstack([psi_d, psi_q]))

    @cached_property
    def roughness(self) -> sparse.csr_array:
        """P (parameters, parameters): ``gamma' P gamma`` sums the squared second differences of the coefficients."""
        return sparse.csr_array(sparse.block_diag([_differences(d.count, q.count) for d, q in self._bases]))


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
        return _products(i_dq, ((self.d, self.q),) * 2, ((1, 0), (0, 1)), (0, 0))


def _products(
    i_dq: FloatArray,
    bases: tuple[tuple[SplineBasis, SplineBasis], tuple[SplineBasis, SplineBasis]],
    orders: tuple[tuple[int, int], tuple[int, int]],
    starts: tuple[int, int],
) -> BasisRows:
    """Return for both fluxes products of splines along i_d and i_q, or of their derivatives, from a column on."""
    functions = (bases[0][0].degree + 1) * (bases[0][1].degree + 1)
    column, value = np.empty((len(i_dq), 2, functions), np.int32), np.empty((len(i_dq), 2, functions))
    for flux, (of_flux, order, start) in enumerate(zip(bases, orders, starts, strict=True)):
        (first_d, w_d), (first_q, w_q) = (
            basis.slopes(i) if slope else basis.values(i)
            for basis, i, slope in zip(of_flux, i_dq.T, order, strict=True)
        )
        tensor_products(first_d, w_d, first_q, w_q, of_flux[1].count, start, column[:, flux], value[:, flux])
    return BasisRows(column, value)


def _differences(count_d: int, count_q: int) -> sparse.coo_array:
    along_d = np.diff(np.eye(count_d), 2, axis=0)
    along_q = np.diff(np.eye(count_q), 2, axis=0)
    return sparse.coo_array(
        sparse.kron(along_d.T @ along_d, sparse.eye_array(count_q))
        + sparse.kron(sparse.eye_array(count_d), along_q.T @ along_q)
    )
