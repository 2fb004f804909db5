"""Which model the data ask for: delay, harmonics, smoothness, and whether the maps are reciprocal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.fit_settings import FitSettings
from drive_id.core.full_basis import PENALTIES, Choice
from drive_id.core.full_model import FullModel
from drive_id.core.full_solver import FullSolution, Solver
from drive_id.core.window_information import WindowInformation
from drive_id.types import FloatArray

_FREE_GAIN = 0.05
_DELAY_SIGNIFICANCE = 5.0
_LEAST_DELAY_ANGLE = 2e-3
_ORDER_SIGNIFICANCE = 2.0
_LEAST_HARMONIC = 1e-4
_SOME = 1000
_COINCIDENCE = 0.1
_DELAY_BIAS = 0.01
"""Samples; what the estimate of a delay was seen to be off by."""
_LEAST_HEATING = 5.0
"""K between recordings, from which on the magnet's temperature coefficient is estimated."""


@dataclass(frozen=True, eq=False)
class Chosen:
    """A fit, and what was found on the way.

    Parameters
    ----------
    solver : Solver
    solution : FullSolution
    delay, sigma_delay : float
        Estimated delay of the voltages and its deviation, samples; NaN when it was not asked for.
    advantage : float
        Share of the squared error on data left out that free maps save over reciprocal ones; negative when they cost.
    """

    solver: Solver
    solution: FullSolution
    delay: float
    sigma_delay: float
    advantage: float


def distinct_orders(orders: Iterable[int], turn: float) -> tuple[int, ...]:
    """Return the harmonics that samples ``turn`` rad apart (root mean square) can tell from lower ones and the map.

    The angles are known, so nothing but an exact coincidence confounds two orders: with N samples per turn, h and k
    look the same where h + k or h - k is a multiple of N.
    """
    samples_per_turn = 2 * np.pi / max(turn, 1e-6)
    chosen: list[int] = []
    for order in sorted(orders):
        sums = np.array([order + sign * lower for lower in (0, *chosen) for sign in (-1, 1)]) / samples_per_turn
        multiple = np.rint(sums)
        if not np.any((multiple >= 1) & (np.abs(sums - multiple) * samples_per_turn < _COINCIDENCE)):
            chosen.append(order)
    return tuple(chosen)


def choose(information: WindowInformation, settings: FitSettings, turn: float) -> Chosen:
    """Fit the model that the data ask for, see :func:`~drive_id.core.full_fit.fit_full`."""
    model = information.model
    solver = Solver(model, information.folds, information.counts)
    distinct = distinct_orders(model.all_orders if settings.calibrate_currents else model.orders, turn)
    orders = tuple(order for order in model.all_orders if order in distinct)
    kept = information.kept()
    heating = np.concatenate([windows.heating for windows in kept])
    i_dq = np.concatenate([windows.i_dq[:, 0] for windows in kept])
    i_dq = i_dq[:: -(-len(i_dq) // _SOME)]
    choice = Choice(settings.maps != "free", orders, per_phase=settings.per_phase_inverter, penalty=PENALTIES[-2])
    choice = replace(choice, magnet=bool(np.ptp(heating) > _LEAST_HEATING))
    delay, sigma_delay = np.nan, np.nan
    if not settings.calibrate_delay:
        choice = replace(choice, delay=settings.voltage_delay)
    solution = solver.solve(choice)
    if settings.calibrate_delay and choice.reciprocal:
        delay, sigma_delay = solver.delay(solution)
        sigma_delay = float(np.hypot(sigma_delay, _DELAY_BIAS))
        if abs(delay) > _DELAY_SIGNIFICANCE * sigma_delay and abs(delay) * turn > _LEAST_DELAY_ANGLE:
            solution = solver.solve(replace(choice, delay=delay))
    choice, error = solver.smoothest(replace(solution.choice, orders=_significant_orders(model, solution, i_dq)))
    advantage = np.nan
    if settings.maps == "auto":
        choice, advantage = _reciprocal_or_free(solver, choice, error, (orders, i_dq), settings)
    return Chosen(solver, solver.solve(choice), delay, sigma_delay, advantage)


def _reciprocal_or_free(
    solver: Solver,
    choice: Choice,
    error: FloatArray,
    harmonics: tuple[tuple[int, ...], FloatArray],
    settings: FitSettings,
) -> tuple[Choice, float]:
    """Take free maps only where they predict data left out clearly better, and in nearly all folds."""
    free = replace(choice, reciprocal=False, delay=0.0 if settings.calibrate_delay else choice.delay)
    first, rest = [0, 1], list(range(2, len(error)))
    free_error = solver.left_out(free, folds=first)[:, 0]
    if not np.any(free_error < error[first]):  # enough to know
        return choice, 1.0 - float(free_error.sum() / error[first].sum())
    free_error = np.append(free_error, solver.left_out(free, folds=rest)[:, 0])
    advantage = 1.0 - float(free_error.sum() / error.sum())
    if advantage > _FREE_GAIN and np.sum(free_error < error) >= len(error) - 1:
        orders, i_dq = harmonics
        everything = solver.solve(replace(free, orders=orders))
        significant = _significant_orders(solver.model, everything, i_dq)
        return solver.smoothest(replace(free, orders=significant))[0], advantage
    return choice, advantage


def _significant_orders(model: FullModel, solution: FullSolution, i_dq: FloatArray) -> tuple[int, ...]:
    """Return the harmonics whose amplitudes differ from zero by more than the noise explains.

    The mean square of the amplitudes' estimates over their variances is 1 for a harmonic that is not there. Without
    any noise the curve of an inverter that no shape meets exactly seems to be one, of less than 1e-4 of the flux.
    """
    chosen, largest = [], float(np.abs(model.flux.rows(i_dq).dot(solution.residual[model.map])).max())
    for order in solution.choice.orders:
        columns = np.arange(model.harmonics[order].start, model.harmonics[order].stop)
        halves = [model.space(order).rows(i_dq).dot(half) for half in np.split(solution.residual[columns], 2)]
        if np.sqrt(np.mean(np.square(halves))) < _LEAST_HARMONIC * largest:
            continue
        unknowns = np.flatnonzero(np.asarray(abs(solution.basis[columns]).sum(axis=0)).ravel())
        forms = np.zeros((solution.basis.shape[1], len(unknowns)))
        forms[unknowns, np.arange(len(unknowns))] = 1.0
        half = solution.half_gain(forms)
        covariance = solution.residual_rms**2 * (half.T @ half)
        estimate = np.linalg.lstsq(solution.basis[columns][:, unknowns].toarray(), solution.residual[columns])[0]
        scale = np.sqrt(np.diag(covariance))
        values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
        usable = values > 1e-9 * values[-1]
        square = (vectors[:, usable].T @ (estimate / scale)) ** 2 / values[usable]
        if np.mean(square) > _ORDER_SIGNIFICANCE:
            chosen.append(order)
    return tuple(chosen)
