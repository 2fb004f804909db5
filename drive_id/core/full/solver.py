"""Penalized least squares on accumulated cross products, cross-validation over folds, correction for current noise.

Noise n of variance sigma^2 in the currents enters the regressors and flattens the map (regression dilution): it causes
residuals ``(dB gamma) n`` and adds ``N = sigma^2 sum dB'dB`` to the map's cross products. Adding N once more gives the
estimate at twice the noise; the difference between the two estimates is the bias by the noise. This is
simulation-extrapolation (Cook and Stefanski 1994) with the expectation in place of the simulation. The variance is
estimated from fourth differences of the currents, because the residuals contain more than this noise. Noise delta of
the angle does the same by ``(J B gamma - dB gamma J i) delta``: it turns the flux forward and the currents back. Noise
within the integrals of the current and of the inverter's shapes also attenuates R and the curve, but by a negligible
amount.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg, sparse

from drive_id.core.frames import J
from drive_id.core.full.model import (
    PENALTIES,
    RESISTANCE,
    SHIFT,
    VOLTAGE,
    FullModel,
    ModelSpec,
    delay_shares,
    map_basis,
    own_basis,
    roughness,
)
from drive_id.core.full.reduced import Reduced, best_delay, voltage_columns
from drive_id.core.full.window_sums import WindowSums, with_products
from drive_id.core.full.windows import Windows
from drive_id.core.maps.flux_models import jacobian
from drive_id.core.numerics.normal_equations import (
    Eliminated,
    Factor,
    columns_of,
    congruent,
    factorize,
    normal_of_difference,
    unpacked,
)
from drive_id.core.numerics.threads import in_threads
from drive_id.types import TINY, BoolArray, FloatArray, IntArray

LEAST_TOLD = 1.3
"""Rms of residuals over that of noise from which on something else than noise is in them."""
LEAST_SAVED = 3e-4
"""Rms, relative to that of the integrated voltages, that a variant of the model must save. For a reciprocal machine,
the misfit of splines and inverter curves, which free maps absorb, is at most half of it. If free maps save no more,
reciprocal maps cost at most 0.03 % of the flux."""
_SOME_GAIN = 0.01
"""Share that the first two folds must save for the others to be tried."""
_UNPREDICTABLE = 4.0
"""Error on a fold left out, relative to the median: a fold with a disturbance judges no variant."""
_NOISE_STEP = 2.0
"""Standard deviations of the noise over which the slope of the inverter's curve is taken: noise rounds its corners."""
_BY_NOISE, _MOST_BY_NOISE = 0.5, 0.98
"""Share of noise in the products of a direction from which on its error is widened, and the largest one that counts:
the variance of the noise is known to some percent."""
_POWERS, _FOUND = 20, 0.6
"""Steps of a power iteration for the largest share, and what they find of it at least."""
_THINNED = 2000
"""Windows from which the effect of current noise is computed: a mean over as many is within 2 %."""
_KEPT = 2
"""Eliminations that are kept: of the penalty that was chosen, and of the largest one."""
_ROUNDING = 1e-13
"""Sum of squared residuals, relative to that of the voltages, that is rounding."""


@dataclass(frozen=True, eq=False)
class _Maps:
    """Map and harmonics, eliminated: what is the same with any effects, delay and curve of the inverter."""

    t: sparse.csr_array  # (summed.size, K)
    penalty: sparse.csr_array  # (K, K)
    factor: tuple[FloatArray, FloatArray]  # L (K, K), and scale (K,)
    half: FloatArray  # (K, S), L^-1 times the scaled products with the S other columns
    beside: FloatArray  # (S, S), products of these
    effects: FloatArray | None  # among them, as :class:`Solver` takes them


@dataclass(frozen=True, eq=False)
class Variant:
    """A variant of the model, factorized."""

    t: sparse.csr_array  # (summed.size, M)
    own: sparse.csr_array  # (S, J), its last columns, of the unknowns beside the maps
    penalty: sparse.csr_array  # (M, M), the part of the normal matrix that comes from no data
    factor: Factor  # of the penalized normal matrix
    maps: _Maps

    def half(self, columns: FloatArray) -> FloatArray:
        """Return L^-1 times the products (M, N) with combinations (S, N) of the other columns."""
        return self.factor.joined(self.maps.half @ columns, np.asarray(self.own.T @ (self.maps.beside @ columns)))

    def back(self, half: FloatArray) -> FloatArray:
        """Return T L'^-1 b (summed.size, ...) for b (M, ...)."""
        return np.asarray(self.t @ self.factor.back(half))


@dataclass(frozen=True, eq=False)
class FullSolution:
    """Solution of one variant of the model."""

    spec: ModelSpec
    # (size,), estimate in the columns of the unknowns, -1 and the shares of the delay in those of the voltage, so that
    # ``Z estimate`` are the residuals, Vs
    estimate: FloatArray
    basis: sparse.csr_array  # (size, M), T, from unknowns to columns
    summed: FloatArray  # (summed.size,), the estimate in the columns of the sums
    variant: Variant
    sum_of_squares: float  # of the residuals, (Vs)^2
    rows: float

    @property
    def residual_rms(self) -> float:
        """Vs."""
        return float(np.sqrt(max(self.sum_of_squares, 0.0) / max(self.rows, 1.0)))

    @property
    def residual_sigma(self) -> float:
        """Vs, of the residuals of other windows as well: with what the unknowns take from these."""
        return self.residual_rms * float(np.sqrt(self.rows / max(self.rows - self.unknowns, 1.0)))

    @property
    def resistance(self) -> float:
        """Ohm."""
        return float(self.estimate[RESISTANCE])

    @property
    def unknowns(self) -> int:
        """Their number M."""
        return len(self.variant.factor.scale)

    def gain(self, scores: FloatArray) -> FloatArray:
        """Return the change of the unknowns (M, K) for scores (M, K), gradients of half the sum of squares."""
        return self.variant.factor.back(self.half_gain(scores))

    def response(self, gradient: FloatArray) -> FloatArray:
        """Return the change of the estimate (size,) for a gradient (size,) of half the sum of squares."""
        return np.asarray(self.basis @ self.gain(np.asarray(self.basis.T @ gradient)[:, None])[:, 0])

    def half_gain(self, forms: FloatArray) -> FloatArray:
        """Return Q (M, K), Q'Q being the covariance of ``forms' x``, (M, K), for white residuals of unit variance."""
        return self.variant.factor.half(forms)

    @property
    def variance_of_resistance(self) -> float:
        """Variance of R for white residuals, ohm^2."""
        return float(self.residual_rms**2 * np.sum(self.half_gain(self.basis[[RESISTANCE]].toarray().T) ** 2))

    @cached_property
    def white_covariance(self) -> FloatArray:
        """Covariance (M, M) of the unknowns for white residuals of unit variance."""
        return self.variant.factor.inverse()


class Solver:
    """Solves any variant of the model, on all folds or with one left out.

    Parameters
    ----------
    folds : sequence of float arrays
        Lower triangle of Z'Z (summed.size, summed.size) of each fold, row by row; not copied.
    counts : (F,) float
        Rows of each fold.
    effects : (F, summed.size, EFFECT_COLUMNS) float, optional
        Z'z of each fold for the columns z of the effects, where the folds lack them.
    unit : float, optional
        Mean diagonal of Z'Z over the columns of a free map; default: that of the folds, if they are free.
    known : dict, optional
        What solvers of these folds, with other effects, share: the elimination of map and harmonics.
    """

    def __init__(
        self,
        model: FullModel,
        folds: Sequence[FloatArray],
        counts: FloatArray,
        effects: FloatArray | None = None,
        unit: float | None = None,
        known: dict[Any, Any] | None = None,
    ) -> None:
        self.model = model
        self.counts = counts
        self._folds, self._effects, self._unit = folds, effects, unit
        total = folds[0].copy()
        for one in folds[1:]:
            total += one
        every = None if effects is None else effects.sum(axis=0)
        self.total = with_products(unpacked(total, model.summed.size), every, model)
        self._known: dict[ModelSpec, _Maps] = {} if known is None else known
        self._reduced: dict[ModelSpec, Reduced] = {}

    @classmethod
    def over(cls, sums: WindowSums) -> Solver:
        """Return the solver of the sums over windows, which must not change any more."""
        return cls(sums.model, sums.triangles(), sums.counts, sums.effects, sums.unit, sums.known)

    @property
    def total_voltage(self) -> float:
        """Mean square of the integrated voltages, (Vs)^2."""
        return float(self.total[VOLTAGE, VOLTAGE] / max(float(self.counts.sum()), 1.0))

    def solve(self, spec: ModelSpec, noise: sparse.csr_array | None = None) -> FullSolution:
        """Fit a variant to all folds, with the products (size, size) of additional noise if given."""
        known, voltage = self._variant(spec, noise), self._voltage(spec)
        estimate = known.back(known.half(voltage[: self._others, None])[:, 0]) - voltage
        squares = float(estimate @ (self.total @ estimate))
        return FullSolution(
            spec=spec,
            estimate=self.model.expansion @ estimate,
            basis=sparse.csr_array(self.model.expansion @ known.t),
            summed=estimate,
            variant=known,
            sum_of_squares=squares,
            rows=float(self.counts.sum()),
        )

    def shrinkage(self, solution: FullSolution) -> FloatArray:
        """Return the bias (size,) of the estimate caused by the penalties, to first order."""
        ridge, rough = self._penalties
        return solution.response((ridge + solution.spec.penalty * rough) @ solution.estimate)

    def by_remainder(self, solution: FullSolution) -> FloatArray:
        """Return the change (size,) of the estimate by the remainder, see :mod:`drive_id.core.full.effects`."""
        return self.by_column(solution, self.model.effect("remainder").start)[0]

    def by_column(self, solution: FullSolution, column: int) -> tuple[FloatArray, float]:
        """Return the change (size,) of the estimate by one of a column that is left out, and what it leaves, (Vs)^2."""
        half = solution.variant.half(np.eye(self._others, 1, -column))
        change = np.asarray(self.model.expansion @ solution.variant.back(half))[:, 0]
        return change, max(float(self.total[column, column] - np.sum(half**2)), TINY)

    def left_out(
        self,
        spec: ModelSpec,
        penalties: Sequence[float] = (),
        folds: Sequence[int] | IntArray | None = None,
    ) -> FloatArray:
        """Return the mean squared residual of each fold, predicted by the fit to the others, (Vs)^2.

        Parameters
        ----------
        penalties : sequence of float
            Candidates instead of the penalty of ``spec``.
        folds : sequence of int
            Folds to leave out, one at a time; default: every one.

        Returns
        -------
        (F, P) float

        Notes
        -----
        The penalty acts on the map alone: all else is eliminated once per fold, ``S = A_mm - A_mn A_nn^-1 A_nm``, and
        ``S + lambda P`` is solved for each penalty lambda.
        """
        maps, own, voltage = map_basis(self.model, spec), own_basis(self.model, spec), self._voltage(spec)
        t, split = sparse.csr_array(sparse.hstack([maps, own])), maps.shape[1]
        tried = [self._penalty(t, penalty) for penalty in penalties or (spec.penalty,)]
        of_map = len(np.unique(maps[self.model.summed.map].indices))

        def errors(number: int) -> list[float]:
            normal, beside = self._products(maps, number, own.shape[1])
            normal[:, split:] = t.T @ (beside @ own[: self._others])
            others = Eliminated.of(normal, t.T @ (beside @ voltage[: self._others]), tried[0], of_map)
            del normal  # which may be large, for several threads
            estimates = map(others.solved, tried)
            return [self._squares(number, t @ x - voltage) / max(self.counts[number], 1.0) for x in estimates]

        return np.array(in_threads(errors, range(len(self._folds)) if folds is None else [int(k) for k in folds]))

    def left_out_if_less(
        self, spec: ModelSpec, error: FloatArray, penalties: Sequence[float] = ()
    ) -> FloatArray | None:
        """Return :meth:`left_out`; None if two folds show no gain over the errors (F,) of another variant."""
        first = np.flatnonzero(predictable(error))[:2]
        errors, rest = np.empty((len(error), max(len(penalties), 1))), np.setdiff1d(np.arange(len(error)), first)
        errors[first] = self.left_out(spec, penalties, first)
        if np.all(errors[first].min(axis=1) > (1 - _SOME_GAIN) * error[first]):
            return None
        errors[rest] = self.left_out(spec, penalties, rest)
        return errors

    def best_penalty(self, spec: ModelSpec) -> tuple[ModelSpec, FloatArray]:
        """Return ``spec`` with the penalty that predicts the folds best, and the squared errors (F,), (Vs)^2."""
        return self._best(spec, self.left_out(spec, PENALTIES))

    def better_penalty(self, spec: ModelSpec, error: FloatArray) -> tuple[ModelSpec, FloatArray] | None:
        """Return the same, or None as :meth:`left_out_if_less` does."""
        errors = self.left_out_if_less(spec, error, PENALTIES)
        return None if errors is None else self._best(spec, errors)

    @staticmethod
    def _best(spec: ModelSpec, errors: FloatArray) -> tuple[ModelSpec, FloatArray]:
        best = int(np.argmin(errors[predictable(errors.min(axis=1))].mean(axis=0)))
        return replace(spec, penalty=PENALTIES[best]), errors[:, best]

    def saving(self, solution: FullSolution, further: slice) -> tuple[float, FloatArray]:
        """Return by which share unknowns in further columns would reduce the sum of squares, and their values (K,)."""
        return self.savings(solution, {"": further})[""]

    def savings(self, solution: FullSolution, further: Mapping[str, slice]) -> dict[str, tuple[float, FloatArray]]:
        """Return the same of several slices, each by itself: one projection serves all."""
        columns = np.unique(np.concatenate([np.arange(own.start, own.stop) for own in further.values()]))
        left, moment = self._left(solution, columns), self.total[columns] @ solution.summed
        scale = np.sqrt(np.maximum(np.diag(left), TINY))
        left, moment = left / scale[:, None] / scale, moment / scale
        least, out = max(solution.sum_of_squares, _ROUNDING * self.total[VOLTAGE, VOLTAGE], TINY), {}
        for name, own in further.items():
            part = slice(*np.searchsorted(columns, (own.start, own.stop)))
            found = np.linalg.lstsq(left[part, part], moment[part], rcond=1e-9)[0]
            out[name] = float(moment[part] @ found / least), -found / scale[part]
        return out

    def delay(self, solution: FullSolution) -> tuple[float, float, float]:
        """Estimate by how many samples the voltages act later than recorded.

        At constant speed a delay rotates the flux by omega delta: only the reciprocity of the maps, or several speeds,
        separate it from a flux.

        Parameters
        ----------
        solution : FullSolution
            Without a delay.

        Returns
        -------
        delay, sigma : float
            Samples; sigma holds for white residuals.
        squares : float
            Sum of squared residuals with this delay, (Vs)^2.
        """
        found, least, bend = best_delay(self._left(solution, voltage_columns(self.model)))
        sigma = float(np.sqrt(max(least, 0.0) / max(float(self.counts.sum()), 1.0) / max(bend, 1e-300)))
        return found, sigma, least

    def reduced(self, spec: ModelSpec, without: int | None = None) -> Reduced:
        """Eliminate the unknowns of a variant, but for its effects and its delay, over all folds or without one."""
        if without is None and spec in self._reduced:
            return self._reduced[spec]
        known = self._variant(replace(spec, effects=()), without=without)
        columns = Reduced.columns(self.model)
        half = known.half(np.eye(self._others)[:, columns])
        form = known.maps.beside[np.ix_(columns, columns)] - half.T @ half
        reduced = Reduced(self.model, form, half, known.back)
        if without is None:
            self._reduced[spec] = reduced
        return reduced

    def _products(self, t: sparse.csr_array, without: int | None, room: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return T'AT (M, M), and A (summed.size, C) over the columns that are not of the maps.

        A is Z'Z of all folds, or without one. Of T'AT, only the upper triangle holds, and as many columns and rows as
        there is ``room`` for, behind it, are not set.
        """
        others = slice(self._others)
        if without is None:
            return congruent(t, self.total), self.total[:, others]
        triangle, effects, size = self._folds[without], self.model.effects, self.model.summed.size
        beside = self.total[:, others] - columns_of(triangle, size, self._others)
        if self._effects is not None:
            beside[:, effects] = self.total[:, effects] - self._effects[without]
            beside[effects] = beside[others, effects].T
        normal = np.zeros((t.shape[1] + room,) * 2)  # not empty: what is below the diagonal is subtracted, too
        normal_of_difference(t, self.total, triangle, normal[: t.shape[1], : t.shape[1]])
        return normal, beside

    def _squares(self, number: int, residual: FloatArray) -> float:
        """Return the sum of squares of ``Z x`` over a fold, for x (summed.size,)."""
        beside, effects = residual, self.model.effects
        if self._effects is not None:
            beside = residual.copy()
            beside[effects] = 0.0
        square = beside @ linalg.blas.dspmv(len(beside), 1.0, self._folds[number], beside)
        if self._effects is not None:
            square += (beside + residual) @ (self._effects[number] @ residual[effects])
        return max(float(square), 0.0)

    def _left(self, solution: FullSolution, columns: IntArray) -> FloatArray:
        """Return the cross products of columns after projecting out the unknowns of a solution."""
        half = solution.variant.half(np.eye(self._others)[:, columns])
        return np.asarray(self.total[np.ix_(columns, columns)] - half.T @ half)

    @property
    def _others(self) -> int:
        """Number of columns that are not of the maps; these follow."""
        return int(self.model.summed.map.start)

    def _variant(self, spec: ModelSpec, noise: sparse.csr_array | None = None, without: int | None = None) -> Variant:
        """Return a variant, factorized, with the products of additional noise, or without a fold."""
        maps = self._eliminated(ModelSpec(spec.reciprocal, spec.orders, penalty=spec.penalty), noise, without)
        own = own_basis(self.model, spec)
        t = sparse.csr_array(sparse.hstack([maps.t, own]))
        own = own[: self._others]
        penalty = self._penalty(own, 0.0)
        normal = np.asarray(own.T @ (own.T @ maps.beside).T)
        factor = Factor.extended(maps.factor, np.asarray((own.T @ maps.half.T).T), normal, penalty)
        both = sparse.csr_array(sparse.block_diag([maps.penalty, penalty]))
        return Variant(t, own, both, factor, maps)

    def _eliminated(self, spec: ModelSpec, noise: sparse.csr_array | None, without: int | None) -> _Maps:
        """Eliminate map and harmonics; the last results of all folds are kept."""
        plain = noise is None and without is None
        known = self._known.get(spec) if plain else None
        if known is not None and known.effects is self._effects:
            return known
        t = map_basis(self.model, spec)
        if known:
            penalty, (factor, scale), beside = known.penalty, known.factor, self.total[:, : self._others]
        else:
            penalty, (normal, beside) = self._penalty(t, spec.penalty, noise), self._products(t, without)
            factor, scale = factorize(normal, penalty)
            del normal  # which may be large, for several threads
        products = np.asarray(t.T @ beside) / scale[:, None]
        half = linalg.solve_triangular(factor, products, lower=True, overwrite_b=True, check_finite=False)
        maps = _Maps(t, penalty, (factor, scale), half, beside[: self._others].copy(), self._effects)
        if plain:
            self._known[spec] = maps
            for old in list(self._known)[:-_KEPT]:
                del self._known[old]
        return maps

    def _penalty(self, t: sparse.csr_array, weight: float, noise: sparse.csr_array | None = None) -> sparse.csr_array:
        """Return the penalty on unknowns behind columns of the sums, with a weight of the map's roughness."""
        ridge, rough = self._penalties
        columns = self.model.expansion[:, : t.shape[0]] @ t
        total = ridge + weight * rough if noise is None else ridge + weight * rough + noise
        return sparse.csr_array(columns.T @ total @ columns)

    def _voltage(self, spec: ModelSpec) -> FloatArray:
        """Return the combination (summed.size,) of columns that is the integral of the delayed voltage."""
        voltage = np.zeros(self.model.summed.size)
        voltage[VOLTAGE] = 1.0
        voltage[SHIFT] = -delay_shares(spec.delay)
        voltage[self.model.effect("remainder")] = -1.0
        return voltage

    @cached_property
    def _penalties(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """Ridge, and roughness of the map for a weight of 1, both (size, size)."""
        ridge, both = (roughness(self.model, self.total, weight, self._unit) for weight in (0.0, 1.0))
        return ridge, sparse.csr_array(both - ridge)


def predictable(errors: FloatArray) -> BoolArray:
    """Tell (F,) which folds the others can predict, by their squared errors (F,).

    The errors in a region that only one fold visits, such as the ramp from zero to the trajectory, would dominate.
    """
    return np.asarray(errors <= _UNPREDICTABLE * np.median(errors))


@dataclass(frozen=True, eq=False)
class CurrentNoise:
    """White noise of the measured currents and angle and its effect on the regression."""

    variance: float  # of i_d and i_q each, A^2
    windows: Windows  # a subset, evenly over time, whose ends give the currents
    angle_variance: float = 0.0  # of white noise in the angle, rad^2
    interpolation_variance: float = 0.0  # mean square error of an interpolated angle, rad^2

    @cached_property
    def period(self) -> float:
        """Mean sample period, s."""
        return float(self.windows.period.mean())

    @cached_property
    def turn(self) -> float:
        """Electrical angle per sample, rms, rad."""
        turn = self.windows.speed.mean(axis=1) * self.windows.period
        return max(float(np.sqrt(np.mean(turn**2))), TINY)

    def at_most(self, solver: Solver, solution: FullSolution) -> CurrentNoise:
        """Return the noise, reduced to what the residuals of a solution allow."""
        expected = self.explained(solver.model, solution)
        share = min(1.0, solution.residual_rms**2 / max(expected, TINY))
        return replace(self, variance=self.variance * share, angle_variance=self.angle_variance * share)

    def explained(self, model: FullModel, solution: FullSolution) -> float:
        """Return the mean squared residual that it causes through both ends of windows, (Vs)^2."""
        squares = self.at_ends(model, solution.estimate, self.windows)
        return float(squares.sum() / (2 * self.windows.weights.sum()))

    def at_ends(self, model: FullModel, estimate: FloatArray, windows: Windows) -> FloatArray:
        """Return the weighted squared residuals (N,) that it causes through the map at both ends, (Vs)^2.

        An angle that is wrong by delta turns the flux by delta and the currents of the map by -delta.
        """
        i_dq, gamma = windows.i_dq.reshape(-1, 2), estimate[model.map]
        inductances = jacobian(model.flux, gamma, i_dq)
        squares = self.variance * np.square(inductances).reshape(len(windows), -1).sum(axis=1)
        if self.angle_variance:
            turned = model.flux.rows(i_dq).dot(gamma) @ J.T - (inductances @ (i_dq @ J.T)[..., None])[..., 0]
            squares += self.angle_variance * np.square(turned).reshape(len(windows), -1).sum(axis=1)
        return np.asarray(windows.weights * squares)

    def expected(self, model: FullModel, estimate: FloatArray, windows: Windows) -> FloatArray:
        """Return the weighted squared residuals (N,) that it causes, (Vs)^2.

        Besides those at both ends, it acts from sample to sample through the slope h' of the inverter's curve: with the
        variance v, by ``4/9 v T int sum h'^2 dt`` over the phases. Here, h'^2 is h' times its largest value, at zero
        current: most of the integral stems from there.
        """
        step = np.array([max(_NOISE_STEP * np.sqrt(self.variance), float(model.shapes.scales[0]))])
        steepest = (model.shapes(step) @ estimate[model.phase_columns()]).mean() / step[0]
        slopes = 1.5 * (windows.sensed[..., 3].real + windows.sensed[..., 4].imag) @ model.coarse_drop(estimate)
        through_drop = 4 / 9 * windows.period * windows.drop_scale**2 * np.maximum(steepest * slopes, 0.0)
        return np.asarray(self.at_ends(model, estimate, windows) + windows.weights * self.variance * through_drop)

    @classmethod
    def met(
        cls,
        variance: float,
        kept: Sequence[Windows],
        angle_variance: float = 0.0,
        interpolation_variance: float = 0.0,
    ) -> CurrentNoise:
        """Thin out the windows to some 2000: enough for a mean."""
        return cls(variance, Windows.joined(list(kept)).thinned(_THINNED), angle_variance, interpolation_variance)

    def among(self, kept: Sequence[Windows]) -> CurrentNoise:
        """Return the same noise, met by other windows."""
        return CurrentNoise.met(self.variance, kept, self.angle_variance, self.interpolation_variance)


def noise_products(solver: Solver, solution: FullSolution, noise: CurrentNoise, squares: float) -> sparse.csr_array:
    """Return N (size, size), (Vs)^2, see the module.

    Parameters
    ----------
    solution : FullSolution
        Gives the slopes dB gamma of the map.
    squares : float
        Upper bound of the sum of squared residuals that noise at the ends causes, (Vs)^2.
    """
    model, windows, weights = solver.model, noise.windows, noise.windows.weights
    i_dq = windows.i_dq[:, 0]
    slopes = [rows.sparse(model.flux.parameters) for rows in model.flux.slope_rows(i_dq)]
    moved = [(noise.variance, one) for one in slopes]
    if noise.angle_variance:
        turns = sparse.csr_array(sparse.kron(sparse.eye_array(len(i_dq)), J))
        turned = turns @ model.flux.rows(i_dq).sparse(model.flux.parameters)
        for one, way in zip(slopes, J @ i_dq.T, strict=True):
            turned -= sparse.diags_array(np.repeat(way, 2)) @ one
        moved.append((noise.angle_variance, turned))
    products = sum(variance * (one.T @ sparse.diags_array(np.repeat(weights, 2)) @ one) for variance, one in moved)
    gamma = solution.estimate[model.map]
    shown = max(float(gamma @ (products @ gamma)), TINY)
    ends = products * min(float(solver.counts.sum()) / weights.sum(), max(squares, 0.0) / shown)
    in_map = sparse.eye_array(model.flux.parameters, model.size, k=model.map.start)
    return sparse.csr_array(in_map.T @ ends @ in_map)


def correct_attenuation(solver: Solver, solution: FullSolution, noise: CurrentNoise) -> tuple[FullSolution, FloatArray]:
    """Correct the estimate for the attenuation by noise in the currents, ``x + (A + N)^-1 N x``.

    Returns
    -------
    FullSolution, (size, 1 + K) float
        The corrected estimate, and bounds on the remaining errors: the attenuation of the correction itself, and what
        is unknown where noise moves the currents more than the trajectory does, see :func:`_moved_by_noise`.
    """
    products, twice = _with_noise(solver, solution, noise)
    correction = solution.estimate - twice.estimate
    again = twice.response(products @ correction)
    corrected = replace(solution, estimate=solution.estimate + correction)
    return corrected, np.column_stack([again, _moved_by_noise(solution, products)])


def unattenuated(solver: Solver, solution: FullSolution, noise: CurrentNoise) -> FloatArray:
    """Return the estimate (size,) that :func:`correct_attenuation` corrects."""
    _, twice = _with_noise(solver, solution, noise)
    return solution.estimate + (solution.estimate - twice.estimate)


def _with_noise(solver: Solver, solution: FullSolution, noise: CurrentNoise) -> tuple[sparse.csr_array, FullSolution]:
    """Return the products N (size, size) of noise, and the solution with as much of it again."""
    products = noise_products(solver, solution, noise, solution.sum_of_squares)
    return products, solver.solve(solution.spec, products)


def _moved_by_noise(solution: FullSolution, products: sparse.csr_array) -> FloatArray:
    """Return what the correction leaves (size, K) of K directions in which noise moves the currents more than all else.

    Across a ring, all that seems to be known comes from noise, and the estimate x is attenuated to nearly nothing. Of a
    direction with the share s of noise, the true value is ``x / (1 - s)``, and the corrected one ``x + x s / (1 + s)``.
    """
    in_unknowns, largest = sparse.csr_array(solution.basis.T @ products @ solution.basis), np.ones(solution.unknowns)
    for _ in range(_POWERS):  # where noise moves nothing so far, all shares would take seconds for nothing
        grown = solution.gain((in_unknowns @ largest)[:, None])[:, 0]
        size = float(np.linalg.norm(grown))  # of one of length 1
        largest = grown / max(size, TINY)
    if size < _BY_NOISE * _FOUND:
        return np.zeros((solution.basis.shape[0], 0))
    inverse = solution.half_gain(np.eye(solution.unknowns))
    share, direction = linalg.eigh(inverse @ (in_unknowns @ inverse.T), subset_by_value=(_BY_NOISE, np.inf))
    share = np.minimum(share, _MOST_BY_NOISE)
    seen = direction.T @ (inverse @ (solution.basis.T @ (products @ solution.estimate)))  # x s
    return np.asarray(solution.basis @ (inverse.T @ (direction * (seen * 2 * share / (1 - share**2)))))
