"""A GradNet function for motulator: a small network whose output is the gradient of a convex function, fitted to a map.

With the input x = i / i_base and the output y = psi / psi_base,

    y = mu x + bias + W' g(W x + b),   g(z) = (beta z)^(p - 1) / (1 + sum((beta z)^p))^((p - 1) / p),

with even p. motulator makes it symmetric about the d axis: ``y = (f(x) + conj(f(conj(x)))) / 2``. The map is reciprocal
and monotone by construction. A map without these properties, or one that is not symmetric, is approximated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.exchange.exports.writers.archives import npz_bytes
from drive_id.types import FloatArray

_UNITS, _EXPONENT = 12, 8
_STARTS, _MOST_POINTS, _EVALUATIONS = 2, 600, 200
_LARGEST_ERROR = 0.02
_FLIP = np.array([1.0, -1.0])


@dataclass(frozen=True, eq=False)
class GradNet:
    """One module of a GradNet with two inputs, in per unit.

    Parameters
    ----------
    W : (N, 2) float
    b : (N,) float
    beta_log : float
    mu_log : (2,) float
    bias : (2,) float
    """

    W: FloatArray
    b: FloatArray
    beta_log: float
    mu_log: FloatArray
    bias: FloatArray

    @classmethod
    def of(cls, vector: FloatArray) -> GradNet:
        """Unpack a vector of parameters (3 N + 5,)."""
        units = (len(vector) - 5) // 3
        W, b, rest = vector[: 2 * units].reshape(units, 2), vector[2 * units : 3 * units], vector[3 * units :]
        return cls(W, b, float(rest[0]), rest[1:3], rest[3:5])

    def symmetric(self, x: FloatArray) -> FloatArray:
        """Return the outputs (M, 2) at inputs (M, 2), made symmetric about the d axis."""
        return np.asarray(0.5 * (self(x) + self(x * _FLIP) * _FLIP))

    def symmetric_jacobian(self, x: FloatArray) -> FloatArray:
        """Return the derivatives (M, 2, P) of :meth:`symmetric` by the parameters."""
        return np.asarray(0.5 * (self.jacobian(x) + self.jacobian(x * _FLIP) * _FLIP[:, None]))

    def __call__(self, x: FloatArray) -> FloatArray:
        """Return the outputs (M, 2) at inputs (M, 2)."""
        z, norm = self._activated(x)
        return np.asarray(np.exp(self.mu_log) * x + self.bias + (z / norm) ** (_EXPONENT - 1) @ self.W)

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return the derivatives (M, 2, P) of the outputs by the parameters, in the order of :meth:`of`."""
        z, norm = self._activated(x)
        u, count, beta = z / norm, len(x), np.exp(self.beta_log)
        g = u ** (_EXPONENT - 1)
        # W' dg/dz (M, 2, N), with dg/dz = (p - 1) (diag(u^(p - 2)) - g g') / norm
        slope = self.W.T * (u ** (_EXPONENT - 2))[:, None] - (g @ self.W)[..., None] * g[:, None]
        slope = (_EXPONENT - 1) * slope / norm[..., None]
        by_w = beta * slope[..., None] * x[:, None, None] + np.eye(2)[:, None] * g[:, None, :, None]
        by_beta = (slope @ z[..., None])[..., 0]
        by_mu = np.eye(2) * (np.exp(self.mu_log) * x)[:, None]
        by_bias = np.broadcast_to(np.eye(2), (count, 2, 2))
        parts = [by_w.reshape(count, 2, -1), beta * slope, by_beta[..., None], by_mu, by_bias]
        return np.concatenate(parts, axis=-1)

    def _activated(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return z (M, N) and the smooth p-norm (M, 1) of it; no power overflows, however large z is."""
        z = np.exp(self.beta_log) * (x @ self.W.T + self.b)
        size = np.maximum(np.abs(z).max(axis=1, keepdims=True), 1.0)
        norm = size * (size**-_EXPONENT + ((z / size) ** _EXPONENT).sum(axis=1, keepdims=True)) ** (1 / _EXPONENT)
        return z, norm


def write(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Fit a network to the points with data, and write its parameters as ``GradNetFunction`` reads them.

    Raises
    ------
    ConfigurationError
        When the network leaves more than 2 % of the largest flux, rms: the machine is not symmetric, or the map is not
        monotone.
    """
    kept = (table.inside | table.filled).ravel()
    i_dq, psi_dq = (np.stack(pair, axis=-1).reshape(-1, 2)[kept] for pair in (table.grid, table.psi))
    i_base, psi_base = float(np.abs(i_dq).max()), float(np.abs(psi_dq).max())
    net, error = fitted(i_dq / i_base, psi_dq / psi_base)
    if error > _LARGEST_ERROR:
        raise ConfigurationError(
            f"A GradNet, symmetric about the d axis and monotone, differs from this map by {100 * error:.1f} % rms "
            "of the largest flux: export --format motulator instead."
        )
    return npz_bytes(
        {
            "W": net.W[None],
            "b": net.b[None],
            "beta_log": np.array([net.beta_log]),
            "mu_log": net.mu_log,
            "bias": net.bias,
            "activation": np.array("PNormGradient"),
            "p": np.array(_EXPONENT),
            "psi_base": np.array(psi_base),
            "i_base": np.array(i_base),
        }
    )


def fitted(x: FloatArray, y: FloatArray) -> tuple[GradNet, float]:
    """Return the network that fits best after several starts, and its distance rms.

    Parameters
    ----------
    x, y : (M, 2) float
        Per unit.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415  # only this format needs it

    chosen = np.random.default_rng(0).permutation(len(x))[:_MOST_POINTS]
    points, values = x[chosen], y[chosen]

    def residual(vector: FloatArray) -> FloatArray:
        return (GradNet.of(vector).symmetric(points) - values).ravel()

    def jacobian(vector: FloatArray) -> FloatArray:
        return GradNet.of(vector).symmetric_jacobian(points).reshape(2 * len(points), -1)

    best: tuple[float, FloatArray] | None = None
    for seed in range(_STARTS):
        generator = np.random.default_rng(seed)
        start = np.concatenate([generator.normal(0, 0.5, 3 * _UNITS), [0.0, -2.0, -2.0, 0.0, 0.0]])
        found = least_squares(residual, start, jacobian, method="lm", max_nfev=_EVALUATIONS)
        if best is None or found.cost < best[0]:
            best = (float(found.cost), found.x)
    assert best is not None
    net = GradNet.of(best[1])
    return net, float(np.sqrt(np.mean((net.symmetric(x) - y) ** 2)))
