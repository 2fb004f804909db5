"""Penalized least squares whose weight and drop shape are averaged by their marginal likelihood (REML).

For each shape of the inverter's drop and each weight lambda of the roughness, the solution is Gaussian. The result is
the mean and covariance of the mixture, each with its restricted marginal likelihood: the errors then include what the
data leave open of the smoothness and of the shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from drive_id.types import FloatArray

_WEIGHTS = np.geomspace(1e-9, 1e3, 25)  # of the roughness, relative to the columns
_ROUNDING = 1e-13  # added to the scaled diagonal, so that rounding leaves it positive definite
_UNLIKELY = 40.0  # distance in -2 log likelihood beyond which a solution is left out of the mixture


@dataclass(frozen=True, eq=False)
class Equations:
    """Whitened equations ``y = columns beta + drops[:, s] a + noise`` of unit variance, times a scale to be found."""

    y: FloatArray  # (N,)
    columns: FloatArray  # (N, C); the last ones are the coefficients of a flux basis
    drops: FloatArray  # (N, S), column of the inverter's drop, for each shape
    penalty: FloatArray  # (C, C), roughness, zero for what it leaves free
    rank: int  # of the penalty
    prior: FloatArray  # (K, C), weak equations ``prior beta = 0`` that settle what the data leave open
    drop_prior: float  # the same for the amplitude of the drop, 1/V
    log_volume: float  # see flux_bases
    least_scale: float  # least variance of the noise: 1 where its level is known, 0 where only the residuals tell

    @property
    def freedom(self) -> int:
        """Equations less coefficients that are not penalized."""
        rows, count = self.columns.shape
        return int(rows - (count + 1 - self.rank))


@dataclass(frozen=True, eq=False)
class Posterior:
    """Mean and covariance of the coefficients over all solutions."""

    mean: FloatArray  # (C + 1,), of the columns and of the amplitude of the drop, V
    covariance: FloatArray  # (C + 1, C + 1)
    shapes: FloatArray  # (S,), probability of each shape of the drop; sums to 1
    drop_mean: FloatArray  # (S,), expectation of the amplitude given each shape
    drop_square: FloatArray  # (S,), that of its square
    scale: float  # variance of the noise, relative to that assumed
    effective: float  # effective number of coefficients of the likeliest solution
    weight: float  # of the roughness, of the likeliest solution
    evidence: float  # -2 log of the largest marginal likelihood, to compare bases


def solved(equations: Equations) -> Posterior:
    """Return the mixture of all solutions."""
    system = equations
    count = system.columns.shape[1]
    penalty = np.zeros((count + 1,) * 2)
    penalty[:count, :count] = system.penalty
    unit = 1.0
    if system.rank:
        unit = float(np.sum(system.columns**2) / np.trace(system.penalty))
    weights = unit * _WEIGHTS if system.rank else np.zeros(1)
    found = []
    for shape in range(system.drops.shape[1]):
        normal, right = _normal(system, shape)
        found += [(shape, weight, _solution(normal + weight * penalty, right, system, weight)) for weight in weights]
    evidence = np.array([entry.evidence for _, _, entry in found])
    best = int(evidence.argmin())
    shares = np.where(evidence < evidence[best] + _UNLIKELY, np.exp(-(evidence - evidence[best]) / 2), 0.0)
    shares /= shares.sum()
    mean, square = np.zeros(count + 1), np.zeros((count + 1, count + 1))
    shapes, drop_mean, drop_square = (np.zeros(system.drops.shape[1]) for _ in range(3))
    for share, (shape, _, entry) in zip(shares, found, strict=True):
        if share == 0.0:
            continue
        own = entry.scale * entry.inverse()
        mean += share * entry.beta
        square += share * (own + np.outer(entry.beta, entry.beta))
        shapes[shape] += share
        drop_mean[shape] += share * entry.beta[-1]
        drop_square[shape] += share * (own[-1, -1] + entry.beta[-1] ** 2)
    shape, weight, entry = found[best]
    normal, _ = _normal(system, shape)
    certain = np.maximum(shapes, np.finfo(float).tiny)
    return Posterior(
        mean=mean,
        covariance=square - np.outer(mean, mean),
        shapes=shapes,
        drop_mean=drop_mean / certain,
        drop_square=drop_square / certain,
        scale=entry.scale,
        effective=float(np.sum(entry.inverse() * normal)),
        weight=float(weight / unit),
        evidence=float(evidence[best]),
    )


@dataclass(frozen=True, eq=False)
class _Gaussian:
    """One Gaussian solution; its matrix is factored with columns scaled by ``by``."""

    beta: FloatArray
    factor: tuple[FloatArray, bool]
    by: FloatArray
    scale: float
    evidence: float

    def inverse(self) -> FloatArray:
        return np.asarray(self.by[:, None] * linalg.cho_solve(self.factor, np.diag(self.by)))


def _normal(system: Equations, shape: int) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix, prior included, and the right side."""
    columns = np.column_stack([system.columns, system.drops[:, shape]])
    prior = np.zeros((len(system.prior) + 1, columns.shape[1]))
    prior[:-1, :-1] = system.prior
    prior[-1, -1] = system.drop_prior
    return columns.T @ columns + prior.T @ prior, columns.T @ system.y


def _solution(matrix: FloatArray, right: FloatArray, system: Equations, weight: float) -> _Gaussian:
    by = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix * by[:, None] * by
    scaled[np.diag_indices(len(scaled))] += _ROUNDING
    factor = linalg.cho_factor(scaled, lower=True)
    beta = by * linalg.cho_solve(factor, by * right)
    rest = max(float(system.y @ system.y - right @ beta), np.finfo(float).tiny)
    freedom = max(system.freedom, 1)
    scale = max(system.least_scale, rest / freedom)
    determinant = 2 * float(np.sum(np.log(np.diag(factor[0]))) - np.sum(np.log(by)))
    evidence = determinant + system.log_volume + rest / scale + freedom * np.log(scale)
    if system.rank:
        evidence -= system.rank * np.log(weight)
    return _Gaussian(np.asarray(beta), factor, by, scale, float(evidence))
