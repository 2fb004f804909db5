"""Which model the data ask for: delay, harmonics, smoothness, and whether the maps are reciprocal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.fit_settings import FitSettings
from drive_id.core.full.basis import PENALTIES, Choice
from drive_id.core.full.information import WindowInformation
from drive_id.core.full.model import FullModel
from drive_id.core.full.noise_correction import noise_products, thinned
from drive_id.core.full.solver import FullSolution, Solver, predictable
from drive_id.core.full.windows import MOST_DELAY
from drive_id.types import FloatArray

_CLEAR_GAIN, _SOME_GAIN = 0.05, 0.01
_LEAST_SAVED = 3e-4
"""Of the voltage, rms: of a reciprocal machine, splines and curves leave up to half as much, and free maps follow that.
A machine for which they save no more than this loses 0.03 % of its flux by being taken as reciprocal."""
_DELAY_SIGNIFICANCE = 2.0
_LEAST_DELAY_ANGLE = 2e-3
_ORDER_SIGNIFICANCE = 2.0
_LEAST_HARMONIC = 1e-4
_COINCIDENCE = 0.1
_DELAY_BIAS = 0.01
"""Samples; what the estimate of a delay was seen to be off by."""
_NOISE_SHARE = 0.02
"""What noise was seen to add to the product of voltage shifts and residuals, over the sum of squared residuals."""
_USUAL_DELAY, _MOST_LEFT = 2.0, 0.7
_SMOOTHING_DOUBT = 2.0
"""How far a delay is uncertain, in units of what ten times the penalty changes: on a ring, it decides, not the data."""
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
    """Fit the model that the data ask for, see :func:`~drive_id.core.full.fit.fit_full`."""
    model = information.model
    solver = Solver(model, information.folds, information.counts)
    distinct = distinct_orders(model.all_orders if settings.calibrate_currents else model.orders, turn)
    orders = tuple(order for order in model.all_orders if order in distinct)
    kept = information.kept()
    heating = np.concatenate([windows.heating for windows in kept])
    i_dq = thinned(np.concatenate([windows.i_dq[:, 0] for windows in kept]))
    choice = Choice(settings.maps != "free", orders, per_phase=settings.per_phase_inverter, penalty=PENALTIES[-2])
    choice = replace(choice, magnet=bool(np.ptp(heating) > _LEAST_HEATING))
    if not settings.calibrate_delay:
        choice = replace(choice, delay=settings.voltage_delay)
    settled = _settle(solver, choice, i_dq, settings, turn)
    choice, advantage = settled.choice, np.nan
    if settings.maps == "auto":
        free = replace(choice, reciprocal=False, delay=0.0 if settings.calibrate_delay else choice.delay)
        advantage, clearly = _saved(solver, free, settled.error)
        if clearly and _saved_without_noise(solver, settled, free, i_dq) > _CLEAR_GAIN:
            everything = solver.solve(replace(free, orders=orders))
            significant = _significant_orders(model, everything, i_dq)
            choice = solver.smoothest(replace(free, orders=significant))[0]
    return Chosen(solver, solver.solve(choice), settled.delay, settled.sigma_delay, advantage)


@dataclass(frozen=True, eq=False)
class _Settled:
    """A choice with delay, orders and penalty, and its mean squared error (F,) on each fold left out, (Vs)^2."""

    choice: Choice
    error: FloatArray
    delay: float
    sigma_delay: float


def _settle(solver: Solver, choice: Choice, i_dq: FloatArray, settings: FitSettings, turn: float) -> _Settled:
    """Find whether the drive compensates its inverter, then the delay, then the harmonics, then the penalty."""
    delay, sigma_delay = np.nan, np.nan
    solution = solver.solve(choice)
    if solver.saving(solution, solver.model.lags) > _CLEAR_GAIN:
        choice = replace(choice, lag=True)
        solution = solver.solve(choice)
    if settings.calibrate_delay and choice.reciprocal:
        delay, sigma_delay = _delay(solver, solution, i_dq)
        if abs(delay) > _DELAY_SIGNIFICANCE * sigma_delay and abs(delay) * turn > _LEAST_DELAY_ANGLE:
            solution = solver.solve(replace(choice, delay=delay))
    significant = _significant_orders(solver.model, solution, i_dq)
    return _Settled(*solver.smoothest(replace(solution.choice, orders=significant)), delay, sigma_delay)


def _delay(solver: Solver, solution: FullSolution, i_dq: FloatArray) -> tuple[float, float]:
    """Return the delay of the voltages without what noise in the currents has made of it, and its deviation, samples.

    A controller answers noise with voltage, later. The deviation holds what was taken away, what may be left where the
    data hardly tell a delay, and what smoothing changes. A delay of more samples than is usual must explain much of the
    residuals to be one.
    """
    found, sigma, squares = solver.delay(solution)
    smoother = solver.delay(solver.solve(replace(solution.choice, penalty=PENALTIES[-1])))[0]
    noise = noise_products(solver, solution, i_dq, squares)
    by_noise = solver.delay(solver.solve(solution.choice, noise))[0] - found
    left = _NOISE_SHARE * sigma**2 * solution.rows
    doubts = [sigma, _DELAY_BIAS, _SMOOTHING_DOUBT * (smoother - found), by_noise, left]
    if abs(found) > _USUAL_DELAY and squares > _MOST_LEFT * solution.sum_of_squares:
        doubts.append(MOST_DELAY)
    return float(np.clip(found - by_noise, -MOST_DELAY, MOST_DELAY)), float(np.linalg.norm(doubts))


def _saved(solver: Solver, choice: Choice, error: FloatArray) -> tuple[float, bool]:
    """Return the share of a squared error (F,) on data left out that a choice saves, and whether clearly.

    Clearly is more than noise does, in nearly all folds, and not next to nothing. Where two say no, the others are not
    asked.
    """
    folds = np.flatnonzero(predictable(error))
    first, rest = folds[:2], folds[2:]
    other = solver.left_out(choice, folds=first)[:, 0]
    if np.all(other > (1 - _SOME_GAIN) * error[first]):
        return 1.0 - float(other.sum() / error[first].sum()), False
    other = np.append(other, solver.left_out(choice, folds=rest)[:, 0])
    saved = 1.0 - float(other.sum() / error[folds].sum())
    enough = (error[folds] - other).mean() > _LEAST_SAVED**2 * solver.total_voltage
    return saved, bool(enough and saved > _CLEAR_GAIN and np.sum(other < error[folds]) >= len(folds) - 1)


def _saved_without_noise(solver: Solver, settled: _Settled, other: Choice, i_dq: FloatArray) -> float:
    """Return the share of the squared error on data left out that another choice saves beyond what it saves of noise.

    Free maps may also follow noise, flat across a thin trajectory, where reciprocal ones must not. What they save of
    noise doubles with it; what they save of an error of the model does not.
    """
    error, solution = settled.error, solver.solve(settled.choice)
    noise = noise_products(solver, solution, i_dq, solution.sum_of_squares)
    by_other = solver.left_out(other)[:, 0]
    noisy, noisy_by_other = (solver.left_out(each, noise=noise)[:, 0] for each in (settled.choice, other))
    saved = 2 * (error - by_other) - (noisy - noisy_by_other)
    folds = predictable(error)
    return float(saved[folds].sum() / error[folds].sum())


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
