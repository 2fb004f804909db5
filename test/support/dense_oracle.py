"""The paper's regression written the slow, plain way: matrices K, dense rows, numpy's lstsq.

Shares no code with the package. Splines are scipy's, the integrals of K are Gauss-Legendre quadratures, and the
equations are stacked as printed (with the errata: the current starts from i^k, the cost is the sum of squares).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline


def park(phi):
    axes = [phi, phi - 2 * np.pi / 3, phi + 2 * np.pi / 3]
    return 2 / 3 * np.array([np.cos(axes), -np.sin(axes)])


def dq(x_abc, phi):
    return np.array([park(p) @ x for p, x in zip(phi, x_abc, strict=True)])


def bases(x, low, high, count):
    width = (high - low) / (count - 3)
    knots = low + width * np.arange(-3, count + 1)
    return BSpline.design_matrix(np.clip(x, knots[3], knots[-4]), knots, 3).toarray()


class DenseOracle:
    def __init__(self, samples, low, high, count, scale=1.0):
        period, phi, omega = samples.sample_period, samples.angle, samples.speed
        i_dq = dq(samples.i_abc, phi)
        by_d = bases(i_dq[:, 0], low[0], high[0], count)
        by_q = bases(i_dq[:, 1], low[1], high[1], count)
        basis = np.einsum("na,nb->nab", by_d, by_q).reshape(len(phi), -1)
        functions = basis.shape[1]
        n = len(phi) - 1
        nodes, gauss = np.polynomial.legendre.leggauss(8)
        rows, rhs = np.zeros((n, 2, 2 + 2 * functions)), np.zeros((n, 2))
        for k in range(n):
            for node, weight in zip(nodes, gauss, strict=True):
                tau = (node + 1) / 2 * period
                matrix = weight / 2 * period * park(phi[k] + omega[k] * tau)
                rhs[k] += matrix @ samples.u_abc[k]
                slope = (samples.i_abc[k + 1] - samples.i_abc[k]) / period
                rows[k, :, 0] += matrix @ (samples.i_abc[k] + slope * tau)
            drop_0 = park(phi[k]) @ np.tanh(samples.i_abc[k] / scale)
            drop_1 = park(phi[k + 1]) @ np.tanh(samples.i_abc[k + 1] / scale)
            rows[k, :, 1] = period / 2 * (drop_0 + drop_1)
            both = np.zeros((2, 2, 2 * functions))
            for e in range(2):
                both[e, 0, :functions] = basis[k + e]
                both[e, 1, functions:] = basis[k + e]
            rotation = np.array([[0.0, -1.0], [1.0, 0.0]])
            rows[k, :, 2:] = omega[k] * rotation @ (period / 2 * (both[0] + both[1])) + both[1] - both[0]
        self.rows, self.rhs = rows, rhs

    def solve(self, with_inverter=True):
        """Return R, u_e (drop convention), gamma."""
        size = self.rows.shape[2]
        columns = np.arange(size) if with_inverter else np.delete(np.arange(size), 1)
        x = np.zeros(size)
        x[columns] = np.linalg.lstsq(self.rows.reshape(-1, size)[:, columns], self.rhs.ravel(), rcond=None)[0]
        return x[0], x[1], x[2:]
