"""Maps whose inductance matrix is positive definite on the whole disc, where the data alone would not make them so."""

from __future__ import annotations

import numpy as np

from drive_id.core.flux_models import FluxModel
from drive_id.core.full_solver import FullSolution, Solver
from drive_id.types import BoolArray, FloatArray

_POINTS = 41
_FLOOR = 0.02
"""Least eigenvalue that is asked for, as a share of the median one."""

_WEIGHT = 30.0
_ROUNDS = 12


def passive_points(model: FluxModel, gamma: FloatArray, i_dq: FloatArray) -> BoolArray:
    """Tell (N,) where the symmetric part of the Jacobian D_f at currents (N, 2), A, is positive definite."""
    return np.asarray(_least_eigenvalues(model, gamma, i_dq)[0] > 0)


def _least_eigenvalues(model: FluxModel, gamma: FloatArray, i_dq: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least eigenvalue (N,), H, of the symmetric part of the Jacobian, and its direction (N, 2)."""
    by_d, by_q = (rows.dot(gamma) for rows in model.slope_rows(i_dq))
    cross = 0.5 * (by_d[:, 1] + by_q[:, 0])
    matrices = np.stack([np.stack([by_d[:, 0], cross], -1), np.stack([cross, by_q[:, 1]], -1)], axis=1)
    values, vectors = np.linalg.eigh(matrices)
    return values[:, 0], vectors[:, :, 0]


def enforce_passivity(solver: Solver, solution: FullSolution) -> FullSolution:
    """Fit again, asking for a slope wherever the map folds, until it does so nowhere on the disc.

    The slope along the direction v of least inductance, ``v' D_f v``, is linear in the parameters: each point where it
    is too small adds one row to the regression. A map that is passive is returned as it is.

    Parameters
    ----------
    solver : Solver
    solution : FullSolution

    Returns
    -------
    FullSolution
        After a bounded number of rounds, passive or not: the review tells.
    """
    model = solver.model
    axes = [np.linspace(low, high, _POINTS) for low, high in zip(model.low, model.high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    i_dq = grid[np.hypot(*grid.T) <= model.i_max]
    by_d, by_q = model.flux.slope_rows(i_dq)
    unit = _WEIGHT * float(np.sqrt(np.diag(solver.total)[model.map].mean()))
    forms, targets = np.zeros((model.size, 0)), np.zeros(0)
    for _ in range(_ROUNDS):
        value, v = _least_eigenvalues(model.flux, solution.residual[model.map], i_dq)
        typical = float(np.median(value))
        low = np.flatnonzero(value <= 0)
        if not len(low) or typical <= 0:
            break
        new = np.zeros((model.size, len(low)))
        at = np.arange(len(low))[:, None]
        for rows, direction in ((by_d, v[low, 0]), (by_q, v[low, 1])):
            for flux in range(2):
                weight = (direction * v[low, flux])[:, None] * rows.value[low, flux]
                np.add.at(new, (model.map.start + rows.column[low, flux], at), weight)
        new *= unit / typical * float(np.abs(solution.residual[model.map]).max())
        forms = np.concatenate([forms, new], axis=1)
        scale = unit * float(np.abs(solution.residual[model.map]).max())
        targets = np.concatenate([targets, np.full(len(low), _FLOOR * scale)])
        solution = solver.solve(solution.choice, (forms, targets))
    return solution
