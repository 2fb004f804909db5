"""Maps whose inductance matrix is positive definite on the whole disc, where the data alone would not make them so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drive_id.core.full.solver import FullSolution, Solver
from drive_id.core.maps.flux_models import FluxModel
from drive_id.types import BoolArray, FloatArray

_POINTS = 41
_STIFFER = 10.0
_ROUNDS = 7


def passive_points(model: FluxModel, gamma: FloatArray, i_dq: FloatArray) -> BoolArray:
    """Tell (N,) where the symmetric part of the Jacobian D_f at currents (N, 2), A, is positive definite."""
    by_d, by_q = (rows.dot(gamma) for rows in model.slope_rows(i_dq))
    cross = 0.5 * (by_d[:, 1] + by_q[:, 0])
    return np.asarray((by_d[:, 0] > 0) & (by_d[:, 0] * by_q[:, 1] > cross**2))


def enforce_passivity(solver: Solver, solution: FullSolution) -> FullSolution:
    """Fit again, ever smoother, until the map folds nowhere on the disc.

    A fold of a map is noise: an incremental inductance is never negative. The stiffness of the map is raised by tens,
    the least that is needed is taken. A map that is passive is returned as it is.

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
    for _ in range(_ROUNDS):
        if passive_points(model.flux, solution.residual[model.map], i_dq).all():
            break
        solution = solver.solve(replace(solution.choice, penalty=_STIFFER * solution.choice.penalty))
    return solution
