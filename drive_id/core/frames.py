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

_THIRD, _ROOT_THIRD = 1 / 3, math.sqrt(1 / 3)
_SERIES_BELOW = 0.1
"""Half turn, rad, below which the closed form cancels and the series to the 9th power is exact."""


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
        x, y = (2.0 * a - b - c) * _THIRD, (b - c) * _ROOT_THIRD
        x_dq[k, 0], x_dq[k, 1] = x * cosine[k] + y * sine[k], y * cosine[k] - x * sine[k]


def to_abc(x_dq: FloatArray, angle: FloatArray) -> FloatArray:
    """Transform d and q components (N, 2) at electrical angles (N,), rad, to phase quantities (N, 3)."""
    return phases((x_dq[:, 0] + 1j * x_dq[:, 1]) * np.exp(1j * angle))


def phases(x_s: ComplexArray) -> FloatArray:
    """Return the phase quantities (N, 3) of a stator-frame space vector (N,), without zero sequence."""
    return np.asarray((x_s[:, None] * np.exp(-1j * PHASE_SHIFTS)).real)


def as_pairs(x: ComplexArray) -> FloatArray:
    """Return real and imaginary parts as columns, (N,) complex to (N, 2) float."""
    return np.stack([x.real, x.imag], axis=-1)


def rotation_integrals(turn: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the zeroth and first moment, (N,) each, of the rotation over one sample, by the angle turned in it, rad.

    They are ``int_0^1 e^{-j turn s} ds`` and ``int_0^1 s e^{-j turn s} ds``, dimensionless.
    """
    half = 0.5 * np.asarray(turn, dtype=np.float64)
    small = np.abs(half) < _SERIES_BELOW
    safe = np.where(small, 1.0, half)
    odd = (np.sin(safe) - safe * np.cos(safe)) / (2 * safe**2)  # int s sin(turn s) ds from -1/2 to 1/2; cancels at 0
    square = half**2
    series = half / 6 * (1 - square / 10 * (1 - square / 28 * (1 - square / 54 * (1 - square / 88))))
    middle = np.exp(-1j * half)
    zeroth = middle * np.sinc(half / np.pi)
    return zeroth, 0.5 * zeroth - 1j * middle * np.where(small, series, odd)


def integrate_held(u_abc: FloatArray, angle: FloatArray, speed: FloatArray, period: float) -> FloatArray:
    """Integrate K u_abc over each sample, u_abc held in the stator frame: ``eq:udq_quadrature``, the paper's v.

    Takes held phase voltages (N, 3), V, angle (N,), rad, and speed (N,), rad/s, at the start of each sample, and the
    period T, s; returns (N, 2), Vs.
    """
    zeroth, _ = rotation_integrals(speed * period)
    return as_pairs(period * zeroth * space_vector(u_abc) * np.exp(-1j * angle))


def integrate_linear(i_abc: FloatArray, angle: FloatArray, speed: FloatArray, period: float) -> FloatArray:
    """Integrate K i_abc over each sample, i_abc linear between samples: ``eq:idq_quadrature``, starting from i^k.

    Takes the phase currents (N + 1, 3), A, at the ends of N samples, all else as :func:`integrate_held`; returns the
    paper's q_1, (N, 2), As.
    """
    zeroth, first = rotation_integrals(speed * period)
    i_s = space_vector(i_abc)
    return as_pairs(period * (zeroth * i_s[:-1] + first * np.diff(i_s)) * np.exp(-1j * angle))
