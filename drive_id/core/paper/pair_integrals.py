"""One sample, and one pair of neighbouring samples, in the terms of ``eq:single_row``: parts of compiled kernels.

What :mod:`drive_id.core.frames` does with whole arrays, without a temporary one.
"""

from __future__ import annotations

import math

from drive_id.core.numerics.compiled import inlined
from drive_id.types import FloatArray

_SERIES_BELOW = 0.1
_THIRD, _ROOT_THIRD = 1 / 3, math.sqrt(1 / 3)


@inlined
def rotate(
    i_abc: FloatArray, drop: FloatArray, k: int, c: float, s: float, vectors: FloatArray, now: int
) -> tuple[float, float]:
    """Write the current in the stator frame and the drop in the rotor frame; return the current in the rotor frame."""
    re, im = _vector(i_abc, k)
    x, y = _vector(drop, k)
    vectors[now, 0], vectors[now, 1] = re, im
    vectors[now, 2], vectors[now, 3] = x * c + y * s, y * c - x * s
    return re * c + im * s, im * c - re * s


@inlined
def _vector(x_abc: FloatArray, k: int) -> tuple[float, float]:
    """Return the stator-frame space vector, see :func:`drive_id.core.frames.space_vector`."""
    a, b, c = x_abc[k, 0], x_abc[k, 1], x_abc[k, 2]
    return (2.0 * a - b - c) * _THIRD, (b - c) * _ROOT_THIRD


@inlined
def write_known(
    u_abc: FloatArray,
    k: int,
    c: float,
    s: float,
    half: float,
    period: float,
    vectors: FloatArray,
    known: FloatArray,
) -> None:
    """Write q_1, q_4 and v of a pair of samples: d in the first row, q in the second; see :func:`rotate`."""
    zeroth_re, zeroth_im, first_re, first_im = _moments(half)
    first, last = k % 2, 1 - k % 2
    x, y = _vector(u_abc, k)
    x, y = zeroth_re * x - zeroth_im * y, zeroth_re * y + zeroth_im * x
    known[0, 2], known[1, 2] = period * (x * c + y * s), period * (y * c - x * s)
    re, im = vectors[first, 0], vectors[first, 1]
    step_re, step_im = vectors[last, 0] - re, vectors[last, 1] - im
    x = zeroth_re * re - zeroth_im * im + first_re * step_re - first_im * step_im
    y = zeroth_re * im + zeroth_im * re + first_re * step_im + first_im * step_re
    known[0, 0], known[1, 0] = period * (x * c + y * s), period * (y * c - x * s)
    known[0, 1] = 0.5 * period * (vectors[0, 2] + vectors[1, 2])
    known[1, 1] = 0.5 * period * (vectors[0, 3] + vectors[1, 3])


@inlined
def _moments(half: float) -> tuple[float, float, float, float]:
    """Return the two complex ``frames.rotation_integrals`` of twice the angle ``half``, rad."""
    x = half * half
    if abs(half) < _SERIES_BELOW:
        odd = half * _series(x, 1 / 6, 1 / 10, 1 / 28, 1 / 54, 1 / 88)
        sinc = 1.0 - x * _series(x, 1 / 6, 1 / 20, 1 / 42, 1 / 72, 1 / 110)
        s, c = half * sinc, 1.0 - x * _series(x, 1 / 2, 1 / 12, 1 / 30, 1 / 56, 1 / 90)
    else:
        c, s = math.cos(half), math.sin(half)
        odd, sinc = (s - half * c) / (2.0 * x), s / half
    return c * sinc, -s * sinc, 0.5 * c * sinc - s * odd, -0.5 * s * sinc - c * odd


@inlined
def _series(x: float, a: float, b: float, c: float, d: float, e: float) -> float:
    """Return a (1 - b x (1 - c x (1 - d x (1 - e x)))): factors, for divisions take longer than all the rest."""
    return a * (1.0 - b * x * (1.0 - c * x * (1.0 - d * x * (1.0 - e * x))))
