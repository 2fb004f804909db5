"""Convexity of a co-energy spline: the Bernstein coefficients of its Hessian, and a barrier method that respects it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb

import numpy as np

from drive_id.core.maps.coenergy import PotentialSpline, SplineBasis
from drive_id.core.numerics.normal_equations import solved
from drive_id.types import FloatArray, IntArray

_FASTER = 20.0  # factor by which the weight of the barrier falls from round to round
_MOST_STEPS = 300  # of Newton's method in all rounds
_CLOSE = 0.05  # Newton decrement, squared, at which a round ends
_SHARE_OF_WAY = 0.95  # that a step may go towards the first singular matrix
_ENOUGH = 0.1  # share of the predicted decline that a step must reach (Armijo)


@dataclass(frozen=True, eq=False)
class HessianForms:
    """Bernstein coefficients of the Hessian of a co-energy spline: 2 x 2 matrices, linear in its coefficients w.

    Of each cell, the Hessian in Bernstein form of degree (p, p) for a co-energy of degree p. The Hessian lies in the
    convex hull of its coefficients. It is continuous with its first derivatives for p of at least 4, so coefficients on
    an edge between two cells lie between their neighbours and are left out.
    """

    d: FloatArray  # (3, S, n), along i_d: n spline coefficients to S Bernstein ones, of the spline, its slope and bend
    q: FloatArray  # likewise along i_q
    half_square: FloatArray  # (P,), spline coefficients of (i_d^2 + i_q^2) / 2, whose Hessian is the unit matrix

    @classmethod
    def of(cls, potential: PotentialSpline) -> HessianForms:
        """Return the forms of a space of co-energies of degree 4 or more along both axes."""
        squares = (_square(potential.d)[:, None] + _square(potential.q)) / 2
        return cls(_bernstein(potential.d), _bernstein(potential.q), squares.ravel())

    @property
    def matrices(self) -> int:
        """Number of 2 x 2 matrices."""
        return int(self.d.shape[1] * self.q.shape[1])

    def hessians(self, w: FloatArray) -> FloatArray:
        """Return the entries [W_dd, W_dq, W_qq] of all coefficients for w (P,), as (3, S_d, S_q)."""
        net = w.reshape(self.d.shape[2], self.q.shape[2])
        return np.stack([self.d[2 - k] @ net @ self.q[k].T for k in range(3)])

    def pulled(self, weights: FloatArray) -> FloatArray:
        """Return the gradient (P,) by w of ``sum(weights * hessians(w))`` for weights (3, S_d, S_q)."""
        parts = [self.d[2 - k].T @ weights[k] @ self.q[k] for k in range(3)]
        return np.asarray(sum(parts)).ravel()

    def curvature(self, weights: FloatArray) -> FloatArray:
        """Return the Hessian (P, P) by w of ``1/2 sum_kl weights_kl h_k h_l``, h being ``hessians(w)``.

        Parameters
        ----------
        weights : (3, 3, S_d, S_q) float
            Symmetric in k and l.
        """
        (d, other_d), (q, other_q) = self._pairs
        total = np.zeros((len(d), len(q)))
        for k in range(3):
            for m in range(3):
                left = self.d[2 - k][:, d] * self.d[2 - m][:, other_d]
                right = self.q[k][:, q] * self.q[m][:, other_q]
                total += left.T @ (weights[k, m] @ right)
        n_d, n_q = self.d.shape[2], self.q.shape[2]
        out = np.zeros((n_d, n_q, n_d, n_q))
        out[d[:, None], q, other_d[:, None], other_q] = total
        return out.reshape(n_d * n_q, n_d * n_q)

    def least_eigenvalue(self, w: FloatArray) -> float:
        """Return a lower bound of the Hessian's eigenvalues over the whole rectangle."""
        a, b, c = self.hessians(w)
        return float(((a + c) / 2 - np.hypot((a - c) / 2, b)).min())

    @cached_property
    def _pairs(self) -> list[tuple[IntArray, ...]]:
        """Of spline coefficients that a common Bernstein coefficient depends on, along both axes."""
        met = [(forms[0] != 0).astype(np.float64) for forms in (self.d, self.q)]
        return [np.nonzero(along.T @ along) for along in met]


def barrier_minimum(
    normal: FloatArray,
    right: FloatArray,
    forms: HessianForms,
    start: FloatArray,
    slope: float,
    least: float,
    tolerance: float,
) -> FloatArray:
    """Minimize ``w' normal w / 2 - right' w`` over the w whose Hessians have eigenvalues above ``least`` everywhere.

    Newton's method on the objective plus mu times the barrier ``-sum log det(M - least)`` over all Bernstein
    coefficients M; mu falls until the objective is within ``tolerance`` of its minimum.

    Parameters
    ----------
    normal : (P, P) float
        Positive definite.
    right : (P,) float
    start : (P,) float
        Any coefficients; they are mixed with those of a paraboloid until they are convex.
    slope : float
        Curvature of the paraboloid, typical of the problem, above ``2 * least``.
    least : float
        Positive.
    tolerance : float
        Positive, in units of the objective.

    Returns
    -------
    (P,) float
        Convex by construction, also if the number of steps should not suffice for the tolerance.
    """
    unit = np.stack([np.full((forms.d.shape[1], forms.q.shape[1]), value) for value in (1.0, 0.0, 1.0)])
    lowest = forms.least_eigenvalue(start)
    share = max(0.0, (2 * least - lowest) / (slope - lowest))
    w = (1 - share) * start + share * slope * forms.half_square

    def value(w: FloatArray, h: FloatArray, mu: float) -> float:
        return float(w @ (normal @ w) / 2 - right @ w - mu * np.log(h[0] * h[2] - h[1] ** 2).sum())

    h = forms.hessians(w) - least * unit
    mu = max(float(w @ (normal @ w) / 2 - right @ w + start @ right / 2), tolerance) / forms.matrices
    for _ in range(_MOST_STEPS):
        gradient, weights = _log_barrier(h)
        ascent = normal @ w - right + mu * forms.pulled(gradient)
        step = -solved(normal + mu * forms.curvature(weights), ascent)
        along = forms.hessians(step)
        decrement = -float(ascent @ step)
        size = min(1.0, _SHARE_OF_WAY * _largest_step(h, along))
        before = value(w, h, mu)
        while value(w + size * step, h + size * along, mu) > before - _ENOUGH * size * decrement and size > 1e-9:
            size /= 2
        w, h = w + size * step, h + size * along
        if decrement < _CLOSE * mu or size <= 1e-9:
            if 2 * forms.matrices * mu <= tolerance:
                break
            mu /= _FASTER
    return w


def _log_barrier(h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return gradient (3, ...) and Hessian (3, 3, ...) of ``-log det`` by the entries [a, b, c] of [[a, b], [b, c]]."""
    a, b, c = h
    det = a * c - b**2
    gradient = np.stack([-c, 2 * b, -a]) / det
    second = np.array(
        [[c**2, -2 * b * c, b**2], [-2 * b * c, 2 * (a * c + b**2), -2 * a * b], [b**2, -2 * a * b, a**2]]
    )
    return gradient, second / det**2


def _largest_step(h: FloatArray, along: FloatArray) -> float:
    """Return the size at which the first of the matrices h + size * along becomes singular; infinite if none does."""
    (a, b, c), (x, y, z) = h, along
    det = a * c - b**2
    half = (c * x - 2 * b * y + a * z) / det / 2
    least = half - np.sqrt(np.maximum(half**2 - (x * z - y**2) / det, 0.0))
    smallest = float(least.min())
    return -1 / smallest if smallest < 0 else np.inf


def _bernstein(basis: SplineBasis) -> FloatArray:
    """Return the matrices (3, S, n) of :class:`HessianForms` along one axis, all of the degree of the basis."""
    p, cells = basis.degree, len(basis.edges) - 1
    t = (1 - np.cos(np.pi * (np.arange(p + 1) + 0.5) / (p + 1))) / 2
    powers = np.arange(p + 1)
    at_t = np.array([comb(p, k) for k in powers]) * t[:, None] ** powers * (1 - t[:, None]) ** (p - powers)
    to_bernstein = np.linalg.inv(at_t)
    out = np.zeros((3, cells, p + 1, basis.count))
    for cell, (low, high) in enumerate(zip(basis.edges[:-1], basis.edges[1:], strict=True)):
        first, values = basis.values(low + (high - low) * t)
        own = slice(int(first[0]), int(first[0]) + p + 1)
        coefficients = to_bernstein @ values
        out[0, cell, :, own] = coefficients
        for order in (1, 2):
            coefficients = (p + 1 - order) / (high - low) * np.diff(coefficients, axis=0)
            out[order, cell, :, own] = _elevated(coefficients, p)
    kept = np.zeros((cells, p + 1), np.bool_)
    kept[:, 1:-1] = kept[0, 0] = kept[-1, -1] = True
    return out[:, kept]


def _elevated(coefficients: FloatArray, degree: int) -> FloatArray:
    """Return the same polynomials (k + 1, ...) in Bernstein form of a higher degree."""
    while len(coefficients) <= degree:
        count = len(coefficients)
        share = (np.arange(1, count) / count)[:, None]
        inner = share * coefficients[:-1] + (1 - share) * coefficients[1:]
        coefficients = np.vstack([coefficients[:1], inner, coefficients[-1:]])
    return coefficients


def _square(basis: SplineBasis) -> FloatArray:
    """Return the coefficients (n,) of x^2: means of the products of two of their inner knots."""
    p = basis.degree
    pairs = list(combinations(range(1, p + 1), 2))
    return np.array([np.mean([basis.knots[j + a] * basis.knots[j + b] for a, b in pairs]) for j in range(basis.count)])
