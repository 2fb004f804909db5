"""Flux models linear in their parameters, ``f(i) = B(i) gamma`` (``eq:splines``): tensor splines and polynomials.

The regression needs only the rows of B, see :class:`FluxModel`. Rows are sparse: per sample and axis
(d, q), K columns and their values.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from drive_id.core.numerics import bspline
from drive_id.core.numerics.bspline import Axis
from drive_id.core.numerics.compiled import compiled
from drive_id.types import BoolArray, FloatArray

ColumnArray = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class BasisRows:
    """Rows of B at N currents."""

    column: ColumnArray  # (N, 2, K), parameters that act on psi_d and psi_q; the values of a repeated column add up
    value: FloatArray  # (N, 2, K), of their basis functions, Wb per unit of the parameter

    def dot(self, gamma: FloatArray) -> FloatArray:
        """Return B gamma: (N, 2) for parameters (P,), (N, 2, M) for parameters (P, M)."""
        if gamma.ndim == 1:
            out = np.empty(self.column.shape[:2])
            _dot(self.column, self.value, np.ascontiguousarray(gamma), out)
            return out
        return np.asarray((self.sparse(len(gamma)) @ gamma).reshape(*self.column.shape[:2], -1))

    def sparse(self, parameters: int) -> sparse.csr_array:
        """Return B as one sparse matrix (2 N, parameters), both rows of a current adjacent."""
        ends = np.arange(0, self.column.size + 1, self.column.shape[2])
        shape = (len(ends) - 1, parameters)
        return sparse.csr_array((self.value.ravel(), self.column.ravel(), ends), shape=shape)

    def dense(self, parameters: int) -> FloatArray:
        """Return B as (N, 2, parameters)."""
        out = np.zeros((*self.column.shape[:2], parameters))
        n, axis = np.indices(self.column.shape)[:2]
        np.add.at(out, (n, axis, self.column), self.value)
        return out


@compiled("const i4[:, :, ::1], const f8[:, :, ::1], const f8[::1], f8[:, ::1]")
def _dot(column: ColumnArray, value: FloatArray, gamma: FloatArray, out: FloatArray) -> None:
    for n in range(len(column)):
        for axis in range(column.shape[1]):
            total = 0.0
            for k in range(column.shape[2]):
                total += value[n, axis, k] * gamma[column[n, axis, k]]
            out[n, axis] = total


class FluxModel(ABC):
    """Flux linkages psi_dq(i_dq), linear in ``parameters`` coefficients."""

    @property
    @abstractmethod
    def parameters(self) -> int:
        """Number of coefficients, for both fluxes."""

    def rows(self, i_dq: FloatArray) -> BasisRows:
        """Return B at currents (N, 2), A; splines move currents outside their range to its edge."""
        return self._rows(i_dq, 0, 0)

    def slope_rows(self, i_dq: FloatArray) -> tuple[BasisRows, BasisRows]:
        """Return the analytic dB/di_d and dB/di_q at currents (N, 2), A, see :func:`jacobian`."""
        return self._rows(i_dq, 1, 0), self._rows(i_dq, 0, 1)

    @abstractmethod
    def _rows(self, i_dq: FloatArray, order_d: int, order_q: int) -> BasisRows:
        """Return the derivative of B whose order is 0 or 1 by i_d and by i_q."""

    @abstractmethod
    def contains(self, i_dq: FloatArray) -> BoolArray:
        """Tell (N,) which of the currents (N, 2), A, lie where the model is defined."""


def jacobian(model: FluxModel, gamma: FloatArray, i_dq: FloatArray) -> FloatArray:
    """Return the incremental inductances [[L_dd, L_dq], [L_qd, L_qq]] at currents (N, 2), A, as (N, 2, 2), H."""
    return np.stack([rows.dot(gamma) for rows in model.slope_rows(i_dq)], axis=-1)


def positive_definite(inductances: FloatArray) -> BoolArray:
    """Tell which matrices (..., 2, 2) have a positive definite symmetric part."""
    l_dd, l_qq = inductances[..., 0, 0], inductances[..., 1, 1]
    cross = 0.5 * (inductances[..., 0, 1] + inductances[..., 1, 0])
    return np.asarray((l_dd > 0) & (l_dd * l_qq > cross**2))


@dataclass(frozen=True)
class TensorSpline(FluxModel):
    """Tensor-product cubic B-splines (the paper's model); gamma_d before gamma_q, each row-major in [i_d, i_q]."""

    d: Axis  # range and number of functions along i_d
    q: Axis  # along i_q

    @property
    def parameters(self) -> int:
        """Number of coefficients, for both fluxes."""
        return 2 * self.d.count * self.q.count

    def _rows(self, i_dq: FloatArray, order_d: int, order_q: int) -> BasisRows:
        column = np.empty((len(i_dq), 2, 16), np.int32)
        value = np.empty((len(i_dq), 2, 16))
        axes = np.array([[self.d.low, self.d.width], [self.q.low, self.q.width]])
        _tensor_rows(np.ascontiguousarray(i_dq), axes, self.d.count, self.q.count, order_d, order_q, column, value)
        return BasisRows(column, value)

    def contains(self, i_dq: FloatArray) -> BoolArray:
        """Tell (N,) which of the currents (N, 2), A, lie in the rectangle of the axes."""
        low, high = np.array([self.d.low, self.q.low]), np.array([self.d.high, self.q.high])
        return np.asarray(((i_dq >= low) & (i_dq <= high)).all(axis=1))


@compiled("const f8[:, ::1], const f8[:, ::1], i8, i8, i8, i8, i4[:, :, ::1], f8[:, :, ::1]")
def _tensor_rows(
    i_dq: FloatArray,
    axes: FloatArray,
    count_d: int,
    count_q: int,
    order_d: int,
    order_q: int,
    column: ColumnArray,
    value: FloatArray,
) -> None:
    w_d, w_q = np.empty(4), np.empty(4)
    functions = count_d * count_q
    for n in range(len(i_dq)):
        cell_d, t_d = bspline.locate(i_dq[n, 0], axes[0, 0], axes[0, 1], count_d - 3)
        cell_q, t_q = bspline.locate(i_dq[n, 1], axes[1, 0], axes[1, 1], count_q - 3)
        if order_d == 0:
            bspline.weights(t_d, w_d)
        else:
            bspline.slopes(t_d, axes[0, 1], w_d)
        if order_q == 0:
            bspline.weights(t_q, w_q)
        else:
            bspline.slopes(t_q, axes[1, 1], w_q)
        k = 0
        for a in range(4):
            for b in range(4):
                index = (cell_d + a) * count_q + cell_q + b
                w = w_d[a] * w_q[b]
                column[n, 0, k], column[n, 1, k] = index, index + functions
                value[n, 0, k], value[n, 1, k] = w, w
                k += 1


@dataclass(frozen=True)
class Polynomial(FluxModel):
    """Polynomials of total degree ``degree`` in i_d / scale and i_q / scale, one for psi_d and one for psi_q.

    Degree 1 is the linear machine with cross-coupling, ``psi = psi_m + L i``; higher degrees add saturation.
    """

    degree: int  # 1 to 12
    scale: float  # current mapped to 1, A, which keeps the powers well conditioned

    @property
    def parameters(self) -> int:
        """Number of coefficients, for both fluxes."""
        return (self.degree + 1) * (self.degree + 2)

    def _rows(self, i_dq: FloatArray, order_d: int, order_q: int) -> BasisRows:
        m, n = np.array([(m, n) for m in range(self.degree + 1) for n in range(self.degree + 1 - m)]).T
        x, y = np.moveaxis(i_dq / self.scale, -1, 0)[:, :, None]
        factor = (m if order_d else 1) * (n if order_q else 1) / self.scale ** (order_d + order_q)
        values = factor * x ** np.maximum(m - order_d, 0) * y ** np.maximum(n - order_q, 0)
        columns = np.arange(self.parameters, dtype=np.int32).reshape(2, -1)
        shape = (len(i_dq), 2, len(m))
        return BasisRows(
            np.ascontiguousarray(np.broadcast_to(columns, shape)),
            np.ascontiguousarray(np.broadcast_to(values[:, None, :], shape)),
        )

    def contains(self, i_dq: FloatArray) -> BoolArray:
        """Tell (N,) that a polynomial is defined everywhere."""
        return np.ones(len(i_dq), np.bool_)
