"""Reciprocal flux maps that are symmetric about the d axis, linear in their coefficients: affine, or splines.

Both are gradients of a co-energy. The splines are penalized by the integral of the squared third derivatives of the
co-energy, i.e. of the second derivatives of the fluxes: the affine machine is what remains of them under a large
weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline

from drive_id.core.maps.coenergy import PotentialSpline, SplineBasis
from drive_id.types import FloatArray

DEGREE = 4  # of the co-energy: its third derivatives are penalized
ODD = 2  # coefficients of an asymmetric part, psi_q at zero current and L_dq, where it is fitted: the last of a basis
_NODES = 5  # Gauss nodes per cell: exact for squares of splines of degree 4, times a weight that is constant per cell


def affine_rows(i_dq: FloatArray) -> FloatArray:
    """Return psi_d and psi_q (N, 2, 5) per unit of ``[psi_d0, L_d, L_q, psi_q0, L_dq]`` at currents (N, 2)."""
    rows = np.zeros((len(i_dq), 2, 5))
    rows[:, 0, 0] = rows[:, 1, 3] = 1.0
    rows[:, 0, 1] = rows[:, 1, 4] = i_dq[:, 0]
    rows[:, 1, 2] = rows[:, 0, 4] = i_dq[:, 1]
    return rows


@dataclass(frozen=True)
class AffineBasis:
    """``psi_d = psi_PM + L_d i_d, psi_q = L_q i_q``; with an odd part also psi_q at zero current and L_dq."""

    odd: bool = False

    @property
    def parameters(self) -> int:
        """Number of coefficients: 3, or 5 with an odd part."""
        return 3 + ODD * self.odd

    @property
    def penalty(self) -> FloatArray:
        """None of them is penalized."""
        return np.zeros((self.parameters,) * 2)

    @property
    def free(self) -> int:
        """Number of coefficients that the roughness leaves free: all of them."""
        return self.parameters

    @property
    def log_volume(self) -> float:
        """Zero: there is only one such basis."""
        return 0.0

    def rows(self, i_dq: FloatArray) -> FloatArray:
        """Return the fluxes (N, 2, C) of the coefficients at currents (N, 2), A."""
        return affine_rows(i_dq)[..., : self.parameters]


@dataclass(frozen=True, eq=False)
class CoEnergyBasis:
    """Gradients of a co-energy spline of degree 4 over the square of +-reach, even in i_q."""

    reach: float  # A
    cells: int  # along each axis, even
    bend: float  # cells at zero current are cosh(bend) times narrower than at the rim: iron bridges saturate early
    relief: float = 0.0  # the roughness in narrow cells counts less, by this power of their width
    odd: bool = False  # with psi_q at zero current and L_dq

    @cached_property
    def _axis(self) -> SplineBasis:
        z = np.linspace(-1.0, 1.0, self.cells + 1)
        edges = np.sinh(self.bend * z) / np.sinh(self.bend) if self.bend else z
        return SplineBasis(self.reach * edges, DEGREE)

    @cached_property
    def _even(self) -> sparse.csr_array:
        """Matrix from the coefficients of functions even in i_q to those of the tensor spline, constants left out."""
        count = self._axis.count
        half = (count + 1) // 2
        column = np.minimum(np.arange(count), count - 1 - np.arange(count))
        mirror = sparse.csr_array((np.ones(count), (np.arange(count), column)), shape=(count, half))
        whole = sparse.csr_array(sparse.kron(sparse.eye_array(count), mirror))
        return sparse.csr_array(whole[:, 1:])  # the first coefficient is as good as free: only the constant needs it

    @property
    def _smooth(self) -> int:
        shape: tuple[int, int] = self._even.shape
        return shape[1]

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return self._smooth + ODD * self.odd

    @property
    def free(self) -> int:
        """Number of coefficients that the roughness leaves free: those of an affine machine."""
        return 3 + ODD * self.odd

    def rows(self, i_dq: FloatArray) -> FloatArray:
        """Return the fluxes (N, 2, C) of the coefficients at currents (N, 2), A."""
        potential = PotentialSpline(self._axis, self._axis)
        flat = potential.rows(np.ascontiguousarray(i_dq)).sparse(potential.parameters) @ self._even
        rows = flat.toarray().reshape(-1, 2, self._smooth)
        return np.concatenate([rows, affine_rows(i_dq)[..., 3:]], axis=2) if self.odd else rows

    @cached_property
    def penalty(self) -> FloatArray:
        """Integral (C, C) of ``W_ddd^2 + 3 W_ddq^2 + 3 W_dqq^2 + W_qqq^2``, bent cells counting less."""
        gram = [self._gram(order) for order in range(DEGREE)]
        parts = [weight * np.kron(gram[3 - k], gram[k]) for k, weight in enumerate((1.0, 3.0, 3.0, 1.0))]
        whole = np.sum(parts, axis=0)
        even = self._even
        out = np.zeros((self.parameters,) * 2)
        out[: self._smooth, : self._smooth] = even.T @ (even.T @ whole).T
        return np.asarray((out + out.T) / 2)

    @cached_property
    def log_volume(self) -> float:
        """Log determinant of the affine machine's coefficients less that of the penalty, to compare bases."""
        axis = np.linspace(-self.reach, self.reach, 2 * self.cells + 1)
        sites = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
        count = self._smooth
        rows = self.rows(sites)[..., :count].reshape(-1, count)
        affine = np.linalg.lstsq(rows, affine_rows(sites)[..., :3].reshape(-1, 3), rcond=None)[0]
        eigenvalues = np.linalg.eigvalsh(self.penalty[:count, :count])[3:]
        return float(np.linalg.slogdet(affine.T @ affine)[1] - np.sum(np.log(eigenvalues)))

    def _gram(self, order: int) -> FloatArray:
        """Return the integral over the axis of products of derivatives of this order."""
        axis = self._axis
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        width = np.diff(axis.edges)
        x = (axis.edges[:-1, None] + width[:, None] * (nodes + 1) / 2).ravel()
        narrow = (width / width.max()) ** self.relief
        mass = (width[:, None] * narrow[:, None] * weights / 2).ravel()
        at_nodes = BSpline(axis.knots, np.eye(axis.count), axis.degree)(x, order)
        return np.asarray(at_nodes.T @ (mass[:, None] * at_nodes))


FluxBasis = AffineBasis | CoEnergyBasis


def linearized(basis: FluxBasis, gamma: FloatArray, i_dq: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return fluxes (N, 2), Wb, and incremental inductances (N, 2, 2), H, by difference quotients."""
    step = 1e-3 * float(np.hypot(*i_dq.T).max())
    slopes = [
        (basis.rows(i_dq + step * unit) - basis.rows(i_dq - step * unit)) @ gamma / (2 * step) for unit in np.eye(2)
    ]
    return basis.rows(i_dq) @ gamma, np.stack(slopes, axis=-1)
