"""Cross products of the regression's rows for tensor splines, in one compiled pass that forms no rows.

The same result as :mod:`drive_id.core.paper.rows`, faster. With D = w^{k+1} - w^k and S = omega T / 2 (w^{k+1} + w^k),
w being the 16 non-zero spline values, the rows of ``eq:single_row`` hold [D, -S] and [S, D] in the columns of gamma_d
and gamma_q. Their cross products are

    D D' + S S'   for gamma_d and for gamma_q alike,        S D' - D S'   for gamma_d with gamma_q:

the symmetric and the antisymmetric part of (D + S) D' + (S - D) S': a single 16 x 16 matrix has to be summed.
"""

from __future__ import annotations

import math

import numpy as np

from drive_id.core.numerics import bspline
from drive_id.core.numerics.compiled import compiled
from drive_id.types import BoolArray, FloatArray, IntArray

_PAIRS = 4
"""Pairs of samples whose products are added at once."""
_SERIES_BELOW = 0.1
_THIRD, _ROOT_THIRD = 1 / 3, math.sqrt(1 / 3)


@compiled(
    "const f8[:, ::1], const f8[:, ::1], const f8[:, ::1], const f8[::1], const f8[::1], const f8[::1], const b1[::1], "
    "f8, const f8[:, ::1], const i8[::1], f8[:, ::1]"
)
def add_spline_rows(
    i_abc: FloatArray,
    u_abc: FloatArray,
    drop: FloatArray,
    cosine: FloatArray,
    sine: FloatArray,
    speed: FloatArray,
    left_out: BoolArray,
    period: float,
    axes: FloatArray,
    counts: IntArray,
    gram: FloatArray,
) -> tuple[int, int]:
    """Add the cross products Z'Z of the rows of N - 1 pairs of consecutive samples to ``gram``.

    Parameters
    ----------
    i_abc, u_abc : (N, 3) float
        A, V.
    drop : (N, 3) float
        The inverter's shape at the currents, dimensionless.
    cosine, sine : (N,) float
        Of the electrical angle.
    speed : (N,) float
        Electrical, rad/s.
    left_out : (N,) bool
        Samples to leave out.
    period : float
        s.
    axes : (2, 3) float
        Of i_d and i_q: lower end, upper end and width of a cell, A.
    counts : (2,) int
        Splines along i_d and i_q.
    gram : (3 + P, 3 + P) float
        See :class:`~drive_id.core.paper.regression.RegressionSums`.

    Returns
    -------
    rows, outside : int
        Rows added, and pairs outside the range of the splines.
    """
    functions = counts[0] * counts[1]
    weights, column = np.zeros((2, 16)), np.zeros((2, 16), np.int64)  # of this sample and the previous one, alternating
    vectors, known, w_d, w_q = np.zeros((2, 4)), np.empty((2, 3)), np.empty(4), np.empty(4)
    left, right, terms = np.zeros((2 * _PAIRS, 16)), np.zeros((2 * _PAIRS, 16)), np.zeros((2 * _PAIRS, 6))
    square, mixed, scalar = np.zeros((16, 16)), np.zeros((6, 16)), np.zeros((3, 3))
    rows, outside, waiting = 0, 0, 0
    last_cell, was_valid, was_inside = -1, False, True
    for k in range(len(i_abc)):
        now, last = k % 2, 1 - k % 2
        c, s = cosine[k], sine[k]
        x = (2.0 * i_abc[k, 0] - i_abc[k, 1] - i_abc[k, 2]) * _THIRD
        y = (i_abc[k, 1] - i_abc[k, 2]) * _ROOT_THIRD
        i_d, i_q = x * c + y * s, y * c - x * s
        vectors[now, 0], vectors[now, 1] = x, y
        x = (2.0 * drop[k, 0] - drop[k, 1] - drop[k, 2]) * _THIRD
        y = (drop[k, 1] - drop[k, 2]) * _ROOT_THIRD
        vectors[now, 2], vectors[now, 3] = x * c + y * s, y * c - x * s
        inside = axes[0, 0] <= i_d <= axes[0, 1] and axes[1, 0] <= i_q <= axes[1, 1]
        valid = inside and not left_out[k]
        cell = _write_weights(i_d, i_q, axes, counts, w_d, w_q, weights, column, now)
        if cell != last_cell and last_cell >= 0:
            _add_products(left, right, terms, waiting, square, mixed)
            _scatter(square, mixed, column[last], functions, gram)
            waiting = 0
        outside += k > 0 and not (inside and was_inside)
        if valid and was_valid:
            rows += 2
            half = speed[k - 1] * (0.5 * period)
            _write_known(u_abc, k - 1, cosine[k - 1], sine[k - 1], half, period, vectors, known)
            for a in range(3):
                for b in range(a + 1):
                    scalar[a, b] += known[0, a] * known[0, b] + known[1, a] * known[1, b]
            if cell == last_cell:
                _write_pair(weights, now, half, known, left, right, terms, waiting)
                waiting += 1
                if waiting == _PAIRS:
                    _add_products(left, right, terms, waiting, square, mixed)
                    waiting = 0
            else:
                _add_crossing(weights, column, now, half, known, functions, gram)
        last_cell, was_valid, was_inside = cell, valid, inside
    _add_products(left, right, terms, waiting, square, mixed)
    _scatter(square, mixed, column[(len(i_abc) - 1) % 2], functions, gram)
    for a in range(3):
        for b in range(a + 1):
            gram[a, b] += scalar[a, b]
            gram[b, a] = gram[a, b]
    return rows, outside


@compiled("const f8[:, ::1], i8, f8, f8, f8, f8, f8[:, ::1], f8[:, ::1]")
def _write_known(
    u_abc: FloatArray,
    k: int,
    c: float,
    s: float,
    half: float,
    period: float,
    vectors: FloatArray,
    known: FloatArray,
) -> None:
    """Write q_1, q_4 and v of a pair of samples, d in the first row and q in the second.

    ``vectors`` are the currents in the stator frame and the drops in the rotor frame, ``half`` is half the turn, rad;
    see ``frames.rotation_integrals``.
    """
    x = half * half
    if abs(half) < _SERIES_BELOW:  # factors, because divisions are slow
        odd = 1.0 - x * (1 / 10) * (1.0 - x * (1 / 28) * (1.0 - x * (1 / 54) * (1.0 - x * (1 / 88))))
        odd *= half * (1 / 6)
        sinc = 1.0 - x * (1 / 20) * (1.0 - x * (1 / 42) * (1.0 - x * (1 / 72) * (1.0 - x * (1 / 110))))
        sinc = 1.0 - x * (1 / 6) * sinc
        y = 1.0 - x * (1 / 12) * (1.0 - x * (1 / 30) * (1.0 - x * (1 / 56) * (1.0 - x * (1 / 90))))
        sine, cosine = half * sinc, 1.0 - x * (1 / 2) * y
    else:
        cosine, sine = math.cos(half), math.sin(half)
        odd, sinc = (sine - half * cosine) / (2.0 * x), sine / half
    zeroth_re, zeroth_im = cosine * sinc, -sine * sinc
    first_re, first_im = 0.5 * cosine * sinc - sine * odd, -0.5 * sine * sinc - cosine * odd
    first, last = k % 2, 1 - k % 2
    x = (2.0 * u_abc[k, 0] - u_abc[k, 1] - u_abc[k, 2]) * _THIRD
    y = (u_abc[k, 1] - u_abc[k, 2]) * _ROOT_THIRD
    x, y = zeroth_re * x - zeroth_im * y, zeroth_re * y + zeroth_im * x
    known[0, 2], known[1, 2] = period * (x * c + y * s), period * (y * c - x * s)
    re, im = vectors[first, 0], vectors[first, 1]
    step_re, step_im = vectors[last, 0] - re, vectors[last, 1] - im
    x = zeroth_re * re - zeroth_im * im + first_re * step_re - first_im * step_im
    y = zeroth_re * im + zeroth_im * re + first_re * step_im + first_im * step_re
    known[0, 0], known[1, 0] = period * (x * c + y * s), period * (y * c - x * s)
    known[0, 1] = 0.5 * period * (vectors[0, 2] + vectors[1, 2])
    known[1, 1] = 0.5 * period * (vectors[0, 3] + vectors[1, 3])


@compiled("f8, f8, const f8[:, ::1], const i8[::1], f8[::1], f8[::1], f8[:, ::1], i8[:, ::1], i8")
def _write_weights(
    i_d: float,
    i_q: float,
    axes: FloatArray,
    counts: IntArray,
    w_d: FloatArray,
    w_q: FloatArray,
    weights: FloatArray,
    column: IntArray,
    now: int,
) -> int:
    """Write the 16 non-zero splines at a current and their indices, and return the first of these."""
    cell_d, t_d = bspline.locate(i_d, axes[0, 0], axes[0, 2], counts[0] - 3)
    cell_q, t_q = bspline.locate(i_q, axes[1, 0], axes[1, 2], counts[1] - 3)
    bspline.weights(t_d, w_d)
    bspline.weights(t_q, w_q)
    for a in range(4):
        for b in range(4):
            weights[now, 4 * a + b] = w_d[a] * w_q[b]
            column[now, 4 * a + b] = (cell_d + a) * counts[1] + cell_q + b
    first: int = column[now, 0]
    return first


@compiled("f8[:, ::1], i8, f8, f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], i8")
def _write_pair(
    weights: FloatArray,
    now: int,
    half: float,
    known: FloatArray,
    left: FloatArray,
    right: FloatArray,
    terms: FloatArray,
    pair: int,
) -> None:
    """Write D + S and S - D on the left, D and S on the right, and the known terms, of a pair in one cell."""
    for j in range(16):
        change = weights[now, j] - weights[1 - now, j]
        total = half * (weights[now, j] + weights[1 - now, j])
        left[2 * pair, j], left[2 * pair + 1, j] = change + total, total - change
        right[2 * pair, j], right[2 * pair + 1, j] = change, total
    _write_terms(known, terms, 2 * pair)


@compiled("f8[:, ::1], f8[:, ::1], i8")
def _write_terms(known: FloatArray, terms: FloatArray, row: int) -> None:
    """Write the factors of D and, below, those of S in the products with q_1, q_4 and v."""
    for a in range(3):
        terms[row, a], terms[row, 3 + a] = known[0, a], known[1, a]
        terms[row + 1, a], terms[row + 1, 3 + a] = known[1, a], -known[0, a]


@compiled("f8[:, ::1], i8[:, ::1], i8, f8, f8[:, ::1], i8, f8[:, ::1]")
def _add_crossing(
    weights: FloatArray,
    column: IntArray,
    now: int,
    half: float,
    known: FloatArray,
    functions: int,
    gram: FloatArray,
) -> None:
    """Add the products of a pair of samples in two cells."""
    right, terms, both = np.empty((2, 32)), np.empty((2, 6)), np.empty(32, np.int64)
    square, mixed = np.empty((32, 32)), np.empty((6, 32))
    for j in range(16):
        before, after = weights[1 - now, j], weights[now, j]
        both[j], both[16 + j] = column[1 - now, j], column[now, j]
        right[0, j], right[0, 16 + j], right[1, j], right[1, 16 + j] = -before, after, half * before, half * after
    _write_terms(known, terms, 0)
    for a in range(32):
        x, y = right[0, a] + right[1, a], right[1, a] - right[0, a]
        for b in range(32):
            square[a, b] = x * right[0, b] + y * right[1, b]
    for a in range(6):
        for b in range(32):
            mixed[a, b] = terms[0, a] * right[0, b] + terms[1, a] * right[1, b]
    _scatter(square, mixed, both, functions, gram)


@compiled("f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, f8[:, ::1], f8[:, ::1]")
def _add_products(
    left: FloatArray, right: FloatArray, terms: FloatArray, pairs: int, square: FloatArray, mixed: FloatArray
) -> None:
    """Add the products left' right to ``square`` and terms' right to ``mixed``, of the first ``pairs`` of four pairs.

    Unrolled by hand so that the sums stay in registers: three times as fast as the loop.
    """
    for n in range(2 * pairs, len(left)):
        for a in range(16):
            left[n, a] = right[n, a] = 0.0
        for a in range(6):
            terms[n, a] = 0.0
    for a in range(16):
        x0, x1, x2, x3 = left[0, a], left[1, a], left[2, a], left[3, a]
        x4, x5, x6, x7 = left[4, a], left[5, a], left[6, a], left[7, a]
        for b in range(16):
            first = (x0 * right[0, b] + x1 * right[1, b]) + (x2 * right[2, b] + x3 * right[3, b])
            last = (x4 * right[4, b] + x5 * right[5, b]) + (x6 * right[6, b] + x7 * right[7, b])
            square[a, b] += first + last
    for a in range(6):
        x0, x1, x2, x3 = terms[0, a], terms[1, a], terms[2, a], terms[3, a]
        x4, x5, x6, x7 = terms[4, a], terms[5, a], terms[6, a], terms[7, a]
        for b in range(16):
            first = (x0 * right[0, b] + x1 * right[1, b]) + (x2 * right[2, b] + x3 * right[3, b])
            last = (x4 * right[4, b] + x5 * right[5, b]) + (x6 * right[6, b] + x7 * right[7, b])
            mixed[a, b] += first + last


@compiled("f8[:, ::1], f8[:, ::1], i8[::1], i8, f8[:, ::1]")
def _scatter(square: FloatArray, mixed: FloatArray, column: IntArray, functions: int, gram: FloatArray) -> None:
    """Add the products to ``gram``, symmetrically, and clear them."""
    d, q = 3, 3 + functions
    for a in range(len(square)):
        for b in range(a + 1):
            same, turned = 0.5 * (square[a, b] + square[b, a]), 0.5 * (square[a, b] - square[b, a])
            m, n = column[a], column[b]
            gram[d + m, d + n] += same
            gram[q + m, q + n] += same
            gram[d + m, q + n] += turned
            gram[q + n, d + m] += turned
            if a != b:
                gram[d + n, d + m] += same
                gram[q + n, q + m] += same
                gram[d + n, q + m] -= turned
                gram[q + m, d + n] -= turned
            square[a, b] = square[b, a] = 0.0
    for j in range(3):
        for a in range(len(square)):
            gram[j, d + column[a]] += mixed[j, a]
            gram[d + column[a], j] += mixed[j, a]
            gram[j, q + column[a]] += mixed[3 + j, a]
            gram[q + column[a], j] += mixed[3 + j, a]
            mixed[j, a] = mixed[3 + j, a] = 0.0
