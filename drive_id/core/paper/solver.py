"""Solution of the paper's normal equations: scaled, rank-revealing, with jackknife standard errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.paper.rows import FLUX, RESISTANCE, VOLTAGE, VOLTAGE_ERROR
from drive_id.types import TINY, FloatArray, IntArray

RANK_TOLERANCE = 1e-6
"""Singular values of the column-scaled rows below this share of the largest count as zero."""

_LEVERAGE_FLOOR = 1e-3  # keeps a block finite that alone determines an unknown


@dataclass(frozen=True, eq=False)
class Solution:
    """Least-squares estimate."""

    resistance: float  # R, ohm
    voltage_error: float  # u_e in the drop convention, V; 0 for a method without it
    gamma: FloatArray  # (P,), flux parameters, Wb; 0 for functions without data
    rank: int  # number of unknowns that the data determine
    condition: float  # of the column-scaled rows, within the rank
    residual_rms: float  # of the rows, Vs
    columns: IntArray  # (C,), of Z that are unknowns
    factor: FloatArray
    """(C, rank), W with W'NW = 1 on the determined part of the normal matrix N: WW' is its pseudo-inverse."""


@one_blas_thread()
def solve(total: FloatArray, rows: int, with_inverter: bool) -> Solution:
    """Solve ``eq:ls_regression`` from the cross products of its rows.

    Parameters
    ----------
    total : (3 + P, 3 + P) float
        Z'Z, see :class:`~drive_id.core.paper.regression.RegressionSums`.
    rows : int
        Accumulated rows.
    with_inverter : bool
        Estimate the voltage error (method ``joint``) or leave its column out (``psm``).

    Returns
    -------
    Solution
        Of minimum norm in the scaled unknowns where the data do not determine them.
    """
    size = len(total)
    columns = np.array([RESISTANCE, *([VOLTAGE_ERROR] if with_inverter else []), *range(FLUX, size)], dtype=np.int64)
    factor, condition = _whitening(total[np.ix_(columns, columns)])
    estimate = np.zeros(size)
    estimate[VOLTAGE] = -1.0
    estimate[columns] = factor @ (factor.T @ total[columns, VOLTAGE])
    square_sum = max(float(estimate @ total @ estimate), 0.0)
    return Solution(
        resistance=float(estimate[RESISTANCE]),
        voltage_error=float(estimate[VOLTAGE_ERROR]),
        gamma=estimate[FLUX:],
        rank=factor.shape[1],
        condition=condition,
        residual_rms=float(np.sqrt(square_sum / max(rows, 1))),
        columns=columns,
        factor=factor,
    )


def _whitening(normal: FloatArray) -> tuple[FloatArray, float]:
    """Return W and the condition of the rows, see :class:`Solution`."""
    norm = np.sqrt(np.diag(normal))
    inverse = np.divide(1.0, norm, out=np.zeros_like(norm), where=norm > 0)
    eigenvalues, vectors = np.linalg.eigh(normal * inverse[:, None] * inverse)
    kept = eigenvalues > RANK_TOLERANCE**2 * max(eigenvalues[-1], TINY)
    eigenvalues, vectors = eigenvalues[kept], vectors[:, kept]
    condition = float(np.sqrt(eigenvalues[-1] / eigenvalues[0])) if len(eigenvalues) else float("inf")
    return inverse[:, None] * vectors / np.sqrt(eigenvalues), condition


@dataclass(frozen=True, eq=False)
class Jackknife:
    """Changes of the estimate when each block of time is left out (delete-a-block jackknife).

    The variance of a linear function of the unknowns is the sum of its squared changes, see :func:`sigma`.
    """

    resistance: FloatArray  # (B,), ohm
    voltage_error: FloatArray  # (B,), V
    gamma: FloatArray  # (B, P), Wb

    @property
    def known(self) -> bool:
        """Whether there were enough blocks; otherwise all changes are infinite."""
        return len(self.gamma) > 1


@one_blas_thread()
def jackknife(blocks: FloatArray, solution: Solution) -> Jackknife:
    """Leave out each block of time in turn.

    Blocks of many samples preserve the correlation of the residuals, and the leverage of a block that alone visits a
    region counts, which a sandwich estimate would hide. Noise in the regressors biases the paper's estimate differently
    in each block, so the result exceeds the scatter of repeated experiments.

    Parameters
    ----------
    blocks : (B, 3 + P, 3 + P) float
        Z'Z per block.
    solution : Solution
        Of their sum.

    Returns
    -------
    Jackknife
        Infinite with fewer than two blocks.
    """
    count, size = blocks.shape[:2]
    columns, factor = solution.columns, solution.factor
    estimate = np.zeros(size)
    estimate[[RESISTANCE, VOLTAGE_ERROR, VOLTAGE]] = solution.resistance, solution.voltage_error, -1.0
    estimate[FLUX:] = solution.gamma
    identity = (1 + _LEVERAGE_FLOOR) * np.eye(factor.shape[1])
    changes = np.zeros((count, size))
    for change, block in zip(changes, blocks, strict=True):
        leverage = factor.T @ block[np.ix_(columns, columns)] @ factor
        change[columns] = factor @ np.linalg.solve(identity - leverage, factor.T @ (block[columns] @ estimate))
    if count < 2:
        changes[:, columns] = np.inf
    else:
        changes *= np.sqrt((count - 1) / count)
    return Jackknife(changes[:, RESISTANCE], changes[:, VOLTAGE_ERROR], changes[:, FLUX:])


def sigma(changes: FloatArray) -> float:
    """Return the standard error of a quantity from its changes (B,), see :class:`Jackknife`."""
    return float(np.sqrt(np.sum(changes**2)))
