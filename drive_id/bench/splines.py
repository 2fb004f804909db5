"""From sampled flux maps to the compiled spline tables of :mod:`drive_id.bench.kernels`.

The tables are uniform cubic B-splines sum_j c_j b(x - j), whose value at node j is (c_j + 4 c_{j+1} + c_{j+2})/6.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from drive_id.bench.parameters import SplineTable
from drive_id.types import FloatArray

EXTENSION = 0.3  # part of its width by which a map is extended on each side, linearly: currents may overshoot it
_MOST_NODES = 401  # along an axis that is resampled


def interpolate(values: FloatArray, axis: int) -> FloatArray:
    """Return the coefficients of the cubic spline through ``values`` with the not-a-knot condition.

    Parameters
    ----------
    values : (..., n, ...) float
        Samples at n >= 4 equally spaced nodes along ``axis``.

    Returns
    -------
    (..., n + 2, ...) float
    """
    n = values.shape[axis]
    matrix = np.zeros((n + 2, n + 2))
    for j in range(n):
        matrix[j, j : j + 3] = 1 / 6, 4 / 6, 1 / 6
    jump = (1.0, -4.0, 6.0, -4.0, 1.0)  # of the third derivative at the second and the last but one node
    matrix[n, :5] = jump
    matrix[n + 1, -5:] = jump
    first = np.moveaxis(values, axis, 0)
    right = np.concatenate((first, np.zeros((2, *first.shape[1:])))).reshape(n + 2, -1)
    return np.moveaxis(np.linalg.solve(matrix, right).reshape(n + 2, *first.shape[1:]), 0, axis)


def interpolate_periodic(values: FloatArray) -> FloatArray:
    """Return the coefficients of the periodic cubic spline through ``values``.

    Parameters
    ----------
    values : (..., h) float
        Samples at h equally spaced nodes of one period.

    Returns
    -------
    (..., h + 3) float
        The last three repeat the first three, so that every interval finds its four coefficients side by side.
    """
    h = values.shape[-1]
    transfer = (4 + 2 * np.cos(2 * np.pi * np.arange(h // 2 + 1) / h)) / 6
    centred = np.fft.irfft(np.fft.rfft(values, axis=-1) / transfer, n=h, axis=-1)
    padded: FloatArray = np.take(centred, np.arange(-1, h + 2) % h, axis=-1)
    return padded


def extend(coefficients: FloatArray, axis: int, count: int) -> FloatArray:
    """Append ``count`` coefficients on both sides of ``axis`` on a straight line: smooth, and linear soon outside."""
    first = np.moveaxis(coefficients, axis, 0)
    ramp = np.arange(1, count + 1).reshape(-1, *([1] * (first.ndim - 1)))
    before = first[0] - ramp[::-1] * (first[1] - first[0])
    after = first[-1] + ramp * (first[-1] - first[-2])
    return np.moveaxis(np.concatenate((before, first, after)), 0, axis)


def uniform_axis(axis: FloatArray) -> FloatArray:
    """Return ``axis`` itself when equally spaced, else an equally spaced one at least as dense, up to 401 nodes."""
    steps = np.diff(axis)
    width = float(axis[-1] - axis[0])
    if np.ptp(steps) <= 1e-9 * width:
        return axis
    count = min(int(np.ceil(width / steps.min())) + 1, _MOST_NODES)
    return np.linspace(axis[0], axis[-1], count)


def resample(values: FloatArray, old: FloatArray, new: FloatArray, axis: int) -> FloatArray:
    """Move samples along ``axis`` from the nodes ``old`` to ``new`` by a cubic not-a-knot spline."""
    if new is old:
        return values
    return np.asarray(make_interp_spline(old, values, axis=axis)(new))


def build_table(i_d: FloatArray, i_q: FloatArray, theta: FloatArray | None, psi: FloatArray) -> SplineTable:
    """Build the compiled spline of a flux map.

    Parameters
    ----------
    i_d, i_q : (D,), (Q,) float
        Increasing axes, A; other than equally spaced ones are resampled.
    theta : (H,) float or None
        Equally spaced angles of one period without its end, rad.
    psi : (D, Q, 2) or (D, Q, 2, H) float
        Flux linkages, Wb.
    """
    d, q = uniform_axis(i_d), uniform_axis(i_q)
    values = resample(resample(psi, i_d, d, 0), i_q, q, 1)
    beyond_d, beyond_q = (int(np.ceil(EXTENSION * len(axis))) + 3 for axis in (d, q))
    values = extend(interpolate(values, 0), 0, beyond_d)
    values = extend(interpolate(values, 1), 1, beyond_q)
    step_d, step_q = (d[-1] - d[0]) / (len(d) - 1), (q[-1] - q[0]) / (len(q) - 1)
    values = values[..., None] if theta is None else interpolate_periodic(values)
    return SplineTable(
        coefficients=np.ascontiguousarray(values),
        d_start=float(d[0] - beyond_d * step_d),
        d_rate=float(1 / step_d),
        q_start=float(q[0] - beyond_q * step_q),
        q_rate=float(1 / step_q),
        theta_start=0.0 if theta is None else float(theta[0]),
        theta_rate=1.0 if theta is None else float(1 / (theta[1] - theta[0])),
    )


def mean_table(table: SplineTable) -> SplineTable:
    """Return the exact average of ``table`` over the rotor position: uniform B-splines average by coefficient."""
    c = table.coefficients
    if c.shape[3] == 1:
        return table
    mean = np.ascontiguousarray(c[..., :-3].mean(axis=-1, keepdims=True))
    return table._replace(coefficients=mean, theta_start=0.0, theta_rate=1.0)
