"""Clarke-Park transformation and its exact integrals over a sample.

Space vectors are complex: the stator-frame vector is ``x_s = 2/3 (x_a + x_b e^{j2pi/3} + x_c e^{-j2pi/3})`` (amplitude
invariant), the rotor-frame vector ``x_d + j x_q = e^{-j phi} x_s``, which is the paper's ``K(phi) x_abc``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray

ComplexArray = NDArray[np.complex128]

PHASE_SHIFTS = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])
"""Angle of the axis of phases a, b, c in the stator frame, rad."""

J = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Rotation of d and q components by 90 degrees."""
THIRD, ROOT_THIRD = 1 / 3, math.sqrt(1 / 3)
"""Factors of the transformation: divisions are slow in kernels."""
_SERIES_BELOW = 0.1
"""Half turn, rad, below which the closed form cancels and the series to the 9th power is exact."""


def wrapped(angle: FloatArray) -> FloatArray:
    """Return angles of any shape, rad, between -pi and pi."""
    return np.asarray(angle - 2 * np.pi * np.rint(angle / (2 * np.pi)))


def space_vector(x_abc: FloatArray) -> ComplexArray:
    """Return the stator-frame space vector (...) of phase quantities (..., 3); the zero sequence cancels."""
    a, b, c = np.moveaxis(np.asarray(x_abc), -1, 0)
    x_s = np.empty(a.shape, np.complex128)
    x_s.real = (2 * a - b - c) / 3
    x_s.imag = (b - c) / np.sqrt(3)
    return x_s


def to_dq(x_abc: FloatArray, angle: FloatArray) -> FloatArray:
    """Transform phase quantities (N, 3) at electrical angles (N,), rad, to d and q components (N, 2)."""
    x_dq = np.empty((len(x_abc), 2))
    _rotate(np.ascontiguousarray(x_abc), np.cos(angle), np.sin(angle), x_dq)
    return x_dq


@compiled("const f8[:, ::1], const f8[::1], const f8[::1], f8[:, ::1]")
def _rotate(x_abc: FloatArray, cosine: FloatArray, sine: FloatArray, x_dq: FloatArray) -> None:
    for k in range(len(x_abc)):
        a, b, c = x_abc[k, 0], x_abc[k, 1], x_abc[k, 2]
        x, y = (2.0 * a - b - c) * THIRD, (b - c) * ROOT_THIRD
        x_dq[k, 0], x_dq[k, 1] = x * cosine[k] + y * sine[k], y * cosine[k] - x * sine[k]


def to_abc(x_dq: FloatArray, angle: FloatArray) -> FloatArray:
    """Transform d and q components (N, 2) at electrical angles (N,), rad, to phase quantities (N, 3)."""
    return phases((x_dq[:, 0] + 1j * x_dq[:, 1]) * np.exp(1j * angle))


def phases(x_s: ComplexArray) -> FloatArray:
    """Return the phase quantities (..., 3) of a stator-frame space vector (...), without zero sequence."""
    return np.asarray((x_s[..., None] * np.exp(-1j * PHASE_SHIFTS)).real)


def as_pairs(x: ComplexArray) -> FloatArray:
    """Return real and imaginary parts as columns, (N,) complex to (N, 2) float."""
    return np.stack([x.real, x.imag], axis=-1)


def integrate_held(u_abc: FloatArray, angle: FloatArray, speed: FloatArray, period: float) -> FloatArray:
    """Integrate K u_abc over each sample, u_abc held in the stator frame: ``eq:udq_quadrature``, the paper's v.

    Takes held phase voltages (N, 3), V, angle (N,), rad, and speed (N,), rad/s, at the start of each sample, and the
    period T, s; returns (N, 2), Vs.
    """
    out = np.empty((len(angle), 2))
    _integrate(np.ascontiguousarray(u_abc), angle, speed, period, False, out)
    return out


def integrate_linear(i_abc: FloatArray, angle: FloatArray, speed: FloatArray, period: float) -> FloatArray:
    """Integrate K i_abc over each sample, i_abc linear between samples: ``eq:idq_quadrature``, starting from i^k.

    Takes the phase currents (N + 1, 3), A, at the ends of N samples, all else as :func:`integrate_held`; returns the
    paper's q_1, (N, 2), As.
    """
    out = np.empty((len(angle), 2))
    _integrate(np.ascontiguousarray(i_abc), angle, speed, period, True, out)
    return out


@compiled("const f8[:, ::1], const f8[::1], const f8[::1], f8, b1, f8[:, ::1]")
def _integrate(
    x_abc: FloatArray, angle: FloatArray, speed: FloatArray, period: float, linear: bool, x_dq: FloatArray
) -> None:
    """Integrate about the middle of each sample, from where the even moment of the rotation meets the mean value.

    With ``t`` turned in half a sample, the even moment is ``sin t / t`` and the odd one ``int s sin(2 t s) ds`` from
    -1/2 to 1/2.
    """
    for k in range(len(angle)):
        a, b, c = x_abc[k, 0], x_abc[k, 1], x_abc[k, 2]
        x, y = (2.0 * a - b - c) * THIRD, (b - c) * ROOT_THIRD
        half = 0.5 * speed[k] * period
        square, sine = half * half, math.sin(half)
        even = sine / half if half != 0.0 else 1.0
        if linear:
            a, b, c = x_abc[k + 1, 0], x_abc[k + 1, 1], x_abc[k + 1, 2]
            rise_x, rise_y = (2.0 * a - b - c) * THIRD - x, (b - c) * ROOT_THIRD - y
            if abs(half) < _SERIES_BELOW:
                odd = 1.0 - square / 10.0 * (1.0 - square / 28.0 * (1.0 - square / 54.0 * (1.0 - square / 88.0)))
                odd *= half / 6.0
            else:
                odd = (sine - half * math.cos(half)) / (2.0 * square)
            x, y = (x + 0.5 * rise_x) * even + odd * rise_y, (y + 0.5 * rise_y) * even - odd * rise_x
        else:
            x, y = x * even, y * even
        cosine, sine = math.cos(angle[k] + half), math.sin(angle[k] + half)
        x_dq[k, 0], x_dq[k, 1] = period * (x * cosine + y * sine), period * (y * cosine - x * sine)
