"""What noise in the currents does to a fit: it stands in the regressors, and flattens the map (regression dilution).

Noise n of variance sigma^2 leaves residuals ``(dB gamma) n`` and adds ``N = sigma^2 sum dB'dB`` to the map's cross
products. With N added once more, an estimate is that of twice the noise: how it moves is how far noise has moved it
already. That is simulation-extrapolation (Cook and Stefanski 1994), by expectation in place of simulation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from drive_id.core.full.solver import FullSolution, Solver
from drive_id.types import FloatArray

_SOME = 1000


def thinned(i_dq: FloatArray) -> FloatArray:
    """Return some of the currents (N, 2), evenly over time: enough for a mean over them."""
    return i_dq[:: -(-len(i_dq) // _SOME)]


def noise_products(solver: Solver, solution: FullSolution, i_dq: FloatArray, squares: float) -> sparse.csr_array:
    """Return N, (P, P) of the map's P coefficients, (Vs)^2.

    Parameters
    ----------
    solver : Solver
    solution : FullSolution
        Its map has the slopes dB gamma.
    i_dq : (N, 2) float
        Some of the currents that were visited, evenly over time, A.
    squares : float
        Sum of squares of the residuals that the noise leaves, (Vs)^2: tells how large it is.
    """
    model = solver.model
    slopes = [rows.sparse(model.flux.parameters) for rows in model.flux.slope_rows(i_dq)]
    products = sum(one.T @ one for one in slopes)
    gamma = solution.residual[model.map]
    shown = max(float(gamma @ (products @ gamma)), np.finfo(np.float64).tiny)
    return sparse.csr_array(products * (max(squares, 0.0) / shown))


def undiluted(solver: Solver, solution: FullSolution, i_dq: FloatArray) -> tuple[FullSolution, FloatArray]:
    """Give back what noise in the currents takes from the map, and tell how sure that is.

    That is ``(A + N)^-1 N x``, what as much noise once more would take of the estimate x.

    Parameters
    ----------
    solver : Solver
    solution : FullSolution
    i_dq : (N, 2) float
        As of :func:`noise_products`.

    Returns
    -------
    FullSolution, (size,) float
        The latter what noise would take of what is given back: nearly as much as that itself where the currents leave a
        direction to noise alone, as a ring does.
    """
    noise = noise_products(solver, solution, i_dq, solution.sum_of_squares)
    twice = solver.solve(solution.choice, noise)
    taken = solution.residual - twice.residual
    pull = np.zeros(solver.model.size)
    pull[solver.model.map] = noise @ taken[solver.model.map]
    return replace(solution, residual=solution.residual + taken), twice.moved(pull)
