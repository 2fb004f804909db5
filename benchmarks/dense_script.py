"""The baseline of the benchmarks: the paper's regression as a plain, vectorized numpy script.

What an engineer would write first: all rows in one dense matrix, then ``lstsq``. It shares no code with the package.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import BSpline

SHIFTS = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])
COUNT = 8


def to_dq(x_abc: Any, angle: Any) -> Any:
    """Transform phase quantities to d and q."""
    axes = angle[:, None] - SHIFTS
    return 2 / 3 * np.stack([(np.cos(axes) * x_abc).sum(1), -(np.sin(axes) * x_abc).sum(1)], axis=1)


def basis(i_dq: Any) -> Any:
    """Return all tensor-product cubic B-splines at all samples, dense."""
    factors = []
    for x in i_dq.T:
        width = (x.max() - x.min()) / (COUNT - 3)
        knots = x.min() + width * np.arange(-3, COUNT + 1)
        factors.append(BSpline.design_matrix(np.clip(x, knots[3], knots[-4]), knots, 3).toarray())
    return (factors[0][:, :, None] * factors[1][:, None, :]).reshape(len(i_dq), -1)


def fit(stamp: Any, i_abc: Any, u_abc: Any, angle: Any, speed: Any) -> tuple[float, float, Any]:
    """Return R, u_e and gamma of method ``joint``."""
    period = (stamp[-1] - stamp[0]) * 1e-9 / (len(stamp) - 1)
    i_dq = to_dq(i_abc, angle)
    b = basis(i_dq)
    phi, omega = angle[:-1], speed[:-1]
    middle = phi + omega * period / 2
    sinc = np.sinc(omega * period / 2 / np.pi)[:, None]
    v = period * sinc * to_dq(u_abc[:-1], middle)
    nodes, gauss = np.polynomial.legendre.leggauss(4)
    q1 = np.zeros_like(v)
    for node, weight in zip(nodes, gauss, strict=True):
        s = (node + 1) / 2
        q1 += weight / 2 * period * to_dq(i_abc[:-1] + s * np.diff(i_abc, axis=0), phi + omega * s * period)
    drop = to_dq(np.tanh(i_abc), angle)
    q4 = period / 2 * (drop[1:] + drop[:-1])
    total = (omega * period / 2)[:, None] * (b[1:] + b[:-1])
    change = b[1:] - b[:-1]
    rows = np.concatenate(
        [
            np.hstack([q1[:, :1], q4[:, :1], change, -total]),
            np.hstack([q1[:, 1:], q4[:, 1:], total, change]),
        ]
    )
    x = np.linalg.lstsq(rows, v.T.ravel(), rcond=None)[0]
    return float(x[0]), float(x[1]), x[2:]
