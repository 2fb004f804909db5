"""The fit of method ``full``: which model the data ask for, its parameters, and how far they can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse

from drive_id.core import frames
from drive_id.core.fit_settings import MOST_ORDERS, FitSettings
from drive_id.core.full.basis import Choice
from drive_id.core.full.choice import Chosen, choose, distinct_orders
from drive_id.core.full.information import WindowInformation
from drive_id.core.full.model import RESISTANCE, SENSOR_ORDERS, FullModel
from drive_id.core.full.noise_correction import thinned, undiluted
from drive_id.core.full.order_search import HIGHEST_ORDER, unexpected_orders
from drive_id.core.full.passivity import enforce_passivity, passive_points
from drive_id.core.full.solver import FullSolution
from drive_id.core.full.windows import Windows
from drive_id.core.maps.flux_models import BasisRows
from drive_id.core.numerics.threads import in_threads
from drive_id.types import BoolArray, FloatArray

BATCH = 0.05
"""s; residuals of windows that start within as much are taken as dependent, those further apart as not."""

_SERIES, _CONVERGED = 16, 1e-3
_SLOPE_STEP = 0.02
_SEARCHES = 2
_STUDENT = 1.21
"""What Student's 97.5 % quantile exceeds the normal one by, relative and per degree of freedom: (1.96^2 + 1) / 4."""
_KURTOSIS, _FEWEST = 3.0, 6.0


@dataclass(frozen=True, eq=False)
class FullFit:
    """What was fitted, and what each batch of time changes in it.

    Parameters
    ----------
    model : FullModel
    solution : FullSolution
    changes : (size, B) float
        What leaving each batch's residuals out changes in the estimate, to first order, and last what the penalties
        change and what the correction for the noise in the currents may have missed: ``changes @ changes.T`` is the
        covariance of the estimate, a heteroscedasticity and autocorrelation consistent one, plus squared biases.
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
    turn, duration : float
        Median angle by which a window turns the rotor, rad, and median duration of one, s.
    outlying : float
        Largest mean square residual of a batch of time, over the median of all.
    outlying_share : float
        Its root, over that of ``total_voltage``.
    outlying_time : float
        Where that is, in time of data, s.
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
    turn: float
    duration: float
    outlying: float
    outlying_share: float
    outlying_time: float

    @property
    def choice(self) -> Choice:
        """What was fitted."""
        return self.solution.choice

    def deviation(self, form: FloatArray) -> float:
        """Return the standard deviation of a linear function (size,) of the estimate."""
        return float(spread(form @ self.changes))

    def white(self, rows: BasisRows) -> FloatArray:
        """Return the deviations (N, 2) of fluxes B gamma, Wb, if the residuals were white."""
        t = self.solution.basis[self.model.map]
        covariance = np.asarray(t @ (t @ self.solution.white_covariance).T)
        met = covariance[rows.column[..., None], rows.column[..., None, :]]  # (N, 2, K, K)
        variance = np.einsum("nak,nakl,nal->na", rows.value, met, rows.value)
        return np.asarray(self.solution.residual_rms * np.sqrt(np.maximum(variance, 0.0)))

    def passive(self, i_dq: FloatArray) -> BoolArray:
        """Tell (N,) where the symmetric part of the flux map's Jacobian at currents (N, 2), A, is positive definite."""
        return passive_points(self.model.flux, self.solution.residual[self.model.map], i_dq)

    @property
    def sigma_resistance(self) -> float:
        """Ohm."""
        form = np.zeros(self.model.size)
        form[RESISTANCE] = 1.0
        return self.deviation(form)


def spread(changes: FloatArray) -> FloatArray:
    """Return the deviation (...) of an estimate that batches of time change by (..., B).

    Few passes of the trajectory determine an estimate, so that its deviation is uncertain, too: it is widened as
    Student's distribution is. Its degrees of freedom follow from the fourth powers of the changes, which for B normal
    ones are three times the squared variance.
    """
    squares = changes**2
    total = squares.sum(axis=-1)
    freedom = _KURTOSIS * total**2 / np.maximum(np.sum(squares**2, axis=-1), np.finfo(np.float64).tiny)
    return np.asarray(np.sqrt(total) * (1 + _STUDENT / np.maximum(freedom, _FEWEST)))


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
    chosen = choose(information, settings, turn)
    if settings.search_orders:
        information, chosen = _with_unexpected_orders(information, chosen, settings, turn)
    model, kept, solver = information.model, information.kept(), chosen.solver
    i_dq = np.concatenate([windows.i_dq[:, 0] for windows in kept])
    solution, doubt = undiluted(solver, chosen.solution, thinned(i_dq))
    if settings.passive_maps:
        solution = enforce_passivity(solver, solution)
    turns = [np.angle(np.exp(1j * np.diff(windows.angle, axis=1)[:, 0])) / windows.duration for windows in kept]
    speeds = np.concatenate(turns)
    batches, energy, times = batch_changes(information, solution)
    changes = np.column_stack([batches, solver.shrinkage(solution), doubt])
    durations = np.concatenate([windows.duration for windows in kept])
    outlying = float(energy.max() / max(np.median(energy), np.finfo(np.float64).tiny))
    slope = _drop_slope(model, solution, kept)
    return FullFit(
        model,
        solution,
        changes,
        chosen.delay,
        chosen.sigma_delay,
        chosen.advantage,
        speeds,
        slope,
        solver.total_voltage,
        float(np.median(np.abs(speeds) * durations)),
        float(np.median(durations)),
        outlying,
        float(np.sqrt(energy.max() / max(solver.total_voltage, np.finfo(np.float64).tiny))),
        float(times[energy.argmax()]),
    )


def _with_unexpected_orders(
    information: WindowInformation, chosen: Chosen, settings: FitSettings, turn: float
) -> tuple[WindowInformation, Chosen]:
    """Fit harmonics, too, that stand out from what is left, as long as there are any."""
    known = information.model.all_orders
    for _ in range(_SEARCHES):
        new = unexpected_orders(information.model, chosen.solution.residual, information.kept(), known, HIGHEST_ORDER)
        new = tuple(order for order in new if order in distinct_orders((*known, order), turn))
        if not new:
            break
        kept = tuple(order for order in chosen.solution.choice.orders if order not in SENSOR_ORDERS)
        information = information.with_orders((*kept, *new)[:MOST_ORDERS])
        known = (*known, *new)
        chosen = choose(information, settings, turn)
    return information, chosen


def _drop_slope(model: FullModel, solution: FullSolution, kept: Sequence[Windows]) -> float:
    i_abc = np.concatenate([frames.to_abc(windows.i_dq[:, 0], windows.angle[:, 0]) for windows in kept])
    heights = solution.residual[model.phase_columns()].mean(axis=1)
    step = _SLOPE_STEP * model.i_max
    sides = [(model.shapes(i_abc + sign * step) @ heights).mean() for sign in (1, -1)]
    return float(sides[0] - sides[1]) / (2 * step)


def batch_changes(information: WindowInformation, solution: FullSolution) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what each batch of kept windows changes in the estimate, (size, B), and its mean square and time (B,)."""
    model, kept = information.model, information.kept()
    through = sparse.csr_array(sparse.hstack([solution.basis, solution.residual[:, None]]))
    covariance = solution.white_covariance  # before the threads want it

    def batches_of(segment: Windows) -> list[tuple[FloatArray, float, float]]:
        return _batch_scores(solution, covariance, segment, model.forms(segment, through, solution.choice.orders))

    batches = [batch for part in in_threads(batches_of, kept) for batch in part]
    scores, energy, time = (np.array(part) for part in zip(*batches, strict=True))
    share = information.windows / max(sum(len(segment) for segment in kept), 1)
    return np.asarray(solution.basis @ solution.gain(np.sqrt(share) * scores.T)), energy, time


def _batch_scores(
    solution: FullSolution, covariance: FloatArray, segment: Windows, rows: FloatArray
) -> list[tuple[FloatArray, float, float]]:
    """Return for each batch the scores (ZT)'e (M,), the mean square residual, (Vs)^2, and its time, s.

    ``rows`` (N, 2, M + 1) are ZT and, last, the residuals r.
    The residuals e are without the fit's leverage. That is CR2, ``e = (I - H)^{-1/2} r`` with ``H = Z cov Z'``, by the
    binomial series, which bounds what residuals of full leverage are multiplied by.
    """
    residuals = rows[..., -1]
    edges = [0, *(1 + np.flatnonzero(np.diff(segment.interval(BATCH)))), len(segment)]
    out = []
    for start, end in pairwise(edges):
        forms = rows[start:end, :, :-1].reshape(-1, len(solution.scale))
        met = np.flatnonzero(forms.any(axis=0))
        forms, covered = forms[:, met], covariance[np.ix_(met, met)]
        scale, score = solution.scale[met], forms.T @ residuals[start:end].ravel()
        total = score.copy()
        for k in range(1, _SERIES):
            score = (k - 0.5) / k * (forms.T @ (forms @ (covered @ score)))
            total += score
            if np.linalg.norm(score / scale) < _CONVERGED * np.linalg.norm(total / scale):
                break
        all_scores = np.zeros(len(solution.scale))
        all_scores[met] = total
        out.append((all_scores, float(np.mean(residuals[start:end] ** 2)), float(segment.time[start:end].mean())))
    return out
