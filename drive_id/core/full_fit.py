"""The fit of method ``full``: which model the data ask for, its parameters, and how far they can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core import frames
from drive_id.core.fit_settings import MOST_ORDERS, FitSettings
from drive_id.core.full_model import RESISTANCE, SENSOR_ORDERS, VOLTAGE, FullModel
from drive_id.core.full_solver import PENALTIES, Choice, FullSolution, Solver
from drive_id.core.order_search import HIGHEST_ORDER, unexpected_orders
from drive_id.core.passivity import enforce_passivity, passive_points
from drive_id.core.window_information import WindowInformation
from drive_id.core.windows import Windows
from drive_id.types import BoolArray, FloatArray

BATCH = 0.05
"""s; residuals of windows that start within as much are taken as dependent, those further apart as not."""

_FREE_GAIN = 0.05
_DELAY_SIGNIFICANCE = 5.0
_LEAST_DELAY_ANGLE = 2e-3
_ORDER_SIGNIFICANCE = 2.0
_NYQUIST_SHARE = 0.9
_LEAST_FREEDOM = 0.05
_SLOPE_STEP = 0.02
_SEARCHES = 2
_LEAST_HEATING = 5.0
"""K between recordings, from which on the magnet's temperature coefficient is estimated."""


@dataclass(frozen=True, eq=False)
class FullFit:
    """What was fitted, and what each batch of time changes in it.

    Parameters
    ----------
    model : FullModel
    solution : FullSolution
    changes : (size, B) float
        What leaving each batch's residuals out changes in the estimate, to first order, and last what the penalties
        change: ``changes @ changes.T`` is the covariance of the estimate, a heteroscedasticity and autocorrelation
        consistent one, plus its squared bias by smoothing.
    delay, sigma_delay : float
        Estimated delay of the voltages and its deviation, samples; NaN when it was not asked for.
    advantage : float
        Share of the squared error on data left out that free maps save over reciprocal ones; negative when they cost.
    speeds : (N,) float
        Electrical speeds of windows, rad/s.
    drop_slope : float
        Mean slope of the inverter's curve over the currents that flowed, ohm.
    total_voltage : float
        Mean square of the integrated voltages, (Vs)^2.
    """

    model: FullModel
    solution: FullSolution
    changes: FloatArray
    delay: float
    sigma_delay: float
    advantage: float
    speeds: FloatArray
    drop_slope: float
    total_voltage: float

    @property
    def choice(self) -> Choice:
        """What was fitted."""
        return self.solution.choice

    def deviation(self, form: FloatArray) -> float:
        """Return the standard deviation of a linear function (size,) of the estimate."""
        return float(np.sqrt(np.sum((form @ self.changes) ** 2)))

    def white(self, forms: FloatArray) -> FloatArray:
        """Return the deviations (K,) of linear functions (size, K) if the residuals were white."""
        half = self.solution.half_gain(np.asarray(self.solution.basis.T @ forms))
        return np.asarray(self.solution.residual_rms * np.sqrt(np.sum(half**2, axis=0)))

    def passive(self, i_dq: FloatArray) -> BoolArray:
        """Tell (N,) where the symmetric part of the flux map's Jacobian at currents (N, 2), A, is positive definite."""
        return passive_points(self.model.flux, self.solution.residual[self.model.map], i_dq)

    @property
    def sigma_resistance(self) -> float:
        """Ohm."""
        form = np.zeros(self.model.size)
        form[RESISTANCE] = 1.0
        return self.deviation(form)


def fit_full(information: WindowInformation, settings: FitSettings, turn: float) -> FullFit:
    """Choose a model and fit it.

    Parameters
    ----------
    information : WindowInformation
        Finished.
    settings : FitSettings
    turn : float
        Root mean square of the angle turned per sample, rad.
    """
    solver, solution, found, advantage = _chosen(information, settings, turn)
    if settings.search_orders:
        highest = min(HIGHEST_ORDER, int(_NYQUIST_SHARE * np.pi / max(turn, 1e-3)) - 1)
        known, searches = information.model.all_orders, 0
        while (
            new := unexpected_orders(information.model, solution.residual, information.kept(), known, highest)
        ) and searches < _SEARCHES:
            kept = tuple(order for order in solution.choice.orders if order not in SENSOR_ORDERS)
            information = information.with_orders((*kept, *new)[:MOST_ORDERS])
            known, searches = (*known, *new), searches + 1
            solver, solution, found, advantage = _chosen(information, settings, turn)
    if settings.passive_maps:
        solution = enforce_passivity(solver, solution)
    model, kept_windows = information.model, information.kept()
    turns = [np.angle(np.exp(1j * np.diff(windows.angle, axis=1)[:, 0])) / windows.duration for windows in kept_windows]
    speeds = np.concatenate(turns)
    total_voltage = float(solver.total[VOLTAGE, VOLTAGE] / max(solver.counts.sum(), 1.0))
    changes = np.column_stack([batch_changes(information, solution), solver.shrinkage(solution)])
    slope = _drop_slope(model, solution, kept_windows)
    return FullFit(model, solution, changes, *found, advantage, speeds, slope, total_voltage)


def _chosen(
    information: WindowInformation, settings: FitSettings, turn: float
) -> tuple[Solver, FullSolution, tuple[float, float], float]:
    """Choose delay, harmonics, smoothness and reciprocity; return the fit, the delay found, the advantage of free maps."""
    model = information.model
    solver = Solver(model, information.folds, information.counts)
    orders = tuple(order for order in model.all_orders if (order + 1) * turn < _NYQUIST_SHARE * np.pi)
    if not settings.calibrate_currents:
        orders = tuple(order for order in orders if order not in SENSOR_ORDERS)
    heating = np.concatenate([windows.heating for windows in information.kept()])
    choice = Choice(settings.maps != "free", orders, per_phase=settings.per_phase_inverter, penalty=PENALTIES[-2])
    choice = replace(choice, magnet=bool(np.ptp(heating) > _LEAST_HEATING))
    found = np.nan, np.nan
    if not settings.calibrate_delay:
        choice = replace(choice, delay=settings.voltage_delay)
    solution = solver.solve(choice)
    if settings.calibrate_delay and choice.reciprocal:
        found = delay, sigma = solver.delay(solution)
        if abs(delay) > _DELAY_SIGNIFICANCE * sigma and abs(delay) * turn > _LEAST_DELAY_ANGLE:
            solution = solver.solve(replace(choice, delay=delay))
    choice, error = solver.smoothest(replace(solution.choice, orders=_significant_orders(model, solution)))
    advantage = np.nan
    if settings.maps == "auto":
        choice, advantage = _reciprocal_or_free(solver, choice, error, orders, settings)
    return solver, solver.solve(choice), found, advantage


def _drop_slope(model: FullModel, solution: FullSolution, kept: Sequence[Windows]) -> float:
    i_abc = np.concatenate([frames.to_abc(windows.i_dq[:, 0], windows.angle[:, 0]) for windows in kept])
    heights = solution.residual[model.phase_columns()].mean(axis=1)
    step = _SLOPE_STEP * model.i_max
    sides = [(model.shapes(i_abc + sign * step) @ heights).mean() for sign in (1, -1)]
    return float(sides[0] - sides[1]) / (2 * step)


def _reciprocal_or_free(
    solver: Solver, choice: Choice, error: FloatArray, orders: tuple[int, ...], settings: FitSettings
) -> tuple[Choice, float]:
    """Take free maps only where they predict data left out clearly better, and in nearly all folds."""
    free = replace(choice, reciprocal=False, delay=0.0 if settings.calibrate_delay else choice.delay)
    (free_error,) = solver.left_out(free)
    advantage = 1.0 - float(free_error.sum() / error.sum())
    if advantage > _FREE_GAIN and np.sum(free_error < error) >= len(error) - 1:
        everything = solver.solve(replace(free, orders=orders))
        return solver.smoothest(replace(free, orders=_significant_orders(solver.model, everything)))[0], advantage
    return choice, advantage


def _significant_orders(model: FullModel, solution: FullSolution) -> tuple[int, ...]:
    """Return the harmonics whose amplitudes differ from zero by more than the noise explains.

    The mean square of the amplitudes' estimates over their variances is 1 for a harmonic that is not there.
    """
    chosen = []
    for order in solution.choice.orders:
        columns = np.arange(model.harmonics[order].start, model.harmonics[order].stop)
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


def batch_changes(information: WindowInformation, solution: FullSolution) -> FloatArray:
    """Return what the residuals of each batch of kept windows change in the estimate, (size, B)."""
    model, kept = information.model, information.kept()
    scores = [score for segment in kept for score in _batch_scores(model, solution, segment)]
    share = information.windows / max(sum(len(segment) for segment in kept), 1)
    return np.asarray(solution.basis @ solution.gain(np.sqrt(share) * np.array(scores).T))


def _batch_scores(model: FullModel, solution: FullSolution, segment: Windows) -> list[FloatArray]:
    """Return the scores of each batch, its residuals freed of what the fit took from them by its leverage (CR2)."""
    batch = (segment.time / BATCH).astype(np.int64)
    scores = []
    for number in np.unique(batch):
        rows = model.design(segment.part(np.flatnonzero(batch == number))).reshape(-1, model.size)
        forms = np.asarray(solution.basis.T @ rows.T)
        met = np.flatnonzero(forms.any(axis=1))
        leverage = forms[met].T @ solution.white_covariance[np.ix_(met, met)] @ forms[met]
        values, vectors = np.linalg.eigh(np.eye(len(rows)) - leverage)
        residual = vectors @ (vectors.T @ (rows @ solution.residual) / np.sqrt(np.maximum(values, _LEAST_FREEDOM)))
        scores.append(forms @ residual)
    return scores
