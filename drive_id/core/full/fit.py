"""The fit of method ``full``: selected model, corrected estimate, covariance of the estimate, passive maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full.between_samples import UNCERTAIN_SHARE
from drive_id.core.full.delay import HALF, Delay, DelayJump
from drive_id.core.full.effects.catalogue import CATALOGUE, without
from drive_id.core.full.effects.effect import Fitted
from drive_id.core.full.lack_of_fit import LackOfFit
from drive_id.core.full.linearized import DELAY, EffectSearch, FoundEffects, with_columns
from drive_id.core.full.model import RESISTANCE, FullModel, ModelSpec
from drive_id.core.full.selection import Selection, effects_to_try, jump_left, select, tested_causes
from drive_id.core.full.solver import (
    LEAST_TOLD,
    CurrentNoise,
    FullSolution,
    Solver,
    correct_attenuation,
    unattenuated,
)
from drive_id.core.full.standard_errors import SIGNIFICANCE, residual_statistics, sigma
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import MOST_DELAY, Windows
from drive_id.core.maps.flux_models import BasisRows, jacobian, positive_definite
from drive_id.core.maps.inverter_curve import WIDE
from drive_id.core.numerics.normal_equations import quadratic_forms
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.types import TINY, FloatArray

_SLOPE_STEP = 0.02
"""Relative to i_max, over which the slope of the drop is taken: wider than the noise, narrower than the step."""
_ALIKE = 1e-3
"""Of the largest, below which a variance of the unknowns of an effect, relative to their own, is not known."""
_MOST_BY_ONE = 0.5  # share of the map's variance from which on an open effect is its cause
_BY_SHAPE = 2.0
"""Standard errors by which R must change with the shape of the curve to be uncertain by that.

With only what exceeds them, 95 % of 159 random drives have R within 1.96 standard errors. What is within them widens
the errors of clean drives up to sixtyfold.
"""
_BEND = 0.1
"""Of the drop at i_max, the standard deviation of the wide shapes of real inverters: R changes by as much as the data
leave of that. The logarithm of on-state drops bends by 5 %; what random drives needed was 14 and 21 %."""
_PASSIVE_POINTS = 41
"""Per axis, at which passivity is tested: two to three for each usual cell."""
_STIFFER, _ROUNDS = 10.0, 7
"""Factor by which the roughness penalty grows in each round, and most rounds: seven decades end in a map with constant
inductances."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Assessment:
    """What the windows tell of a fit besides the estimate: the influence of each batch of time, and what is left."""

    # (size, B), first-order change of the estimate when each batch's residuals are left out; then the bias by the
    # penalties, what current noise leaves of its bias, what is uncertain of the current between samples, of a delay,
    # and of an effect that is neither found nor excluded, the changes by the lack of fit and by rivals of effects, and
    # last the change with the shapes of the inverter's curve. ``changes @ changes.T`` is the covariance of the
    # estimate, consistent for heteroscedastic and autocorrelated residuals, biases included.
    changes: FloatArray
    # (B,), of these: "noise" of the batches, "bias", "misfit", "open" of a delay, an effect or its rival, and "curve"
    sources: tuple[str, ...]
    misfit: LackOfFit  # residuals beyond noise
    speeds: FloatArray  # (N,), electrical speeds of windows, rad/s
    drop_slope: float  # mean slope of the inverter's curve over the measured currents, ohm
    turn: float  # median angle, rad, and duration, s, of a window
    duration: float
    # largest mean square residual of a batch of time over the median of all batches; those at which current noise
    # causes larger ones, as at large inductances or near zero current, have less weight
    outlying: float
    outlying_share: float  # rms residual of that batch over the rms of the integrated voltages
    outlying_time: float  # time of that batch, gaps not counted, s
    # mean square residual of the windows that are not kept over that of the kept ones, from which all else is judged
    unseen: float
    # (size,), by effect: how the estimate changes, other than by effects, with that rival in its place that changes the
    # map most
    by_rivals: dict[str, FloatArray]
    open: str  # effect, or delay, from which most of the map's variance stems, for the data leave it open; else empty
    jump: DelayJump | None = None  # where the delay of the voltages changes


@dataclass(frozen=True, eq=False, kw_only=True)
class FullFit:
    """The fitted model."""

    model: FullModel
    solution: FullSolution
    selection: Selection  # the selected model and its alternatives
    assessment: Assessment  # of the windows of this fit, or of an earlier one, see :func:`fit_again`

    @property
    def spec(self) -> ModelSpec:
        """The selected variant of the model."""
        return self.solution.spec

    @property
    def total_voltage(self) -> float:
        """Mean square of the integrated voltages, (Vs)^2."""
        return self.selection.solver.total_voltage

    @property
    def crossings(self) -> float:
        """Excess of the residuals near zero crossings, see :class:`~drive_id.core.full.selection.Selection`."""
        return self.selection.crossings

    @property
    def steady(self) -> float | None:
        """The one speed of all data, rad/s electrical; None where there are several."""
        return self.selection.search.found.columns.steady

    @property
    def shared_resistance(self) -> float:
        """Largest change of R with another curve of the inverter that the data leave open, ohm."""
        return float(abs(self.assessment.changes[RESISTANCE, -1]))

    def met(self, effect: str, column: int) -> bool:
        """Tell whether the data have any of a column of an effect."""
        at = self.model.effect(effect).start + column
        return bool(self.selection.solver.total[at, at] > 0)

    def sigma(self, column: int) -> float:
        """Return the standard error of one entry of the estimate."""
        return float(sigma(self.assessment.changes[column]))

    def white_sigma(self, rows: BasisRows) -> tuple[FloatArray, FloatArray]:
        """Return two standard errors (N, 2) of the forms ``rows`` of the map's parameters under white residuals.

        The first also holds the error by the penalty, which is taken for a prior (Wahba 1983, Nychka 1988): the
        covariance ``C = (Z'Z + P)^-1``. The second is the spread by the residuals alone: ``C - C P C``.
        """
        own, covariances = self._white_covariances
        forms = sparse.csr_array(rows.sparse(self.model.flux.parameters) @ own)
        of_form = forms.indptr.astype(np.int32), forms.indices.astype(np.int32), forms.data
        variances = (np.maximum(quadratic_forms(*of_form, each), 0.0).reshape(-1, 2) for each in covariances)
        first, second = (self.solution.residual_rms * np.sqrt(each) for each in variances)
        return first, second

    @cached_property
    def _white_covariances(self) -> tuple[sparse.csr_array, tuple[FloatArray, FloatArray]]:
        """The map's parameters by its unknowns (P, K), and C and ``C - C P C``, (K, K), of the latter."""
        found, in_map = self.solution, self.solution.basis[self.model.map]
        first, last = np.flatnonzero(np.asarray(abs(in_map).sum(axis=0)))[[0, -1]]
        own = slice(int(first), int(last) + 1)
        columns = np.ascontiguousarray(found.white_covariance[:, own])
        both = columns[own]
        return in_map[:, own], (both, both - columns.T @ (found.variant.penalty @ columns))


@dataclass(frozen=True, eq=False)
class EarlierFit:
    """Selection and results of a fit, without its sums, for a later fit of the same samples and further ones."""

    model: FullModel  # of its sums
    # whether its currents were those in the map, see :meth:`~drive_id.core.full.effects.EffectColumns.moved`
    moved: bool
    # whether its sums held the columns of effects, or the remainder alone, see :mod:`drive_id.core.full.effects`
    extended: bool
    spec: ModelSpec
    found: FoundEffects
    assessment: Assessment

    @classmethod
    def of(cls, fit: FullFit) -> EarlierFit | None:
        """Return the earlier fit of a fit; None if that used other sums (free maps or short windows)."""
        if np.isfinite(fit.crossings) or not fit.spec.reciprocal:
            return None
        search = fit.selection.search
        return cls(
            model=fit.model,
            moved=search.sums.kept()[0].moved is not None,
            extended=search.sums.effects is not None,
            spec=fit.spec,
            found=search.found,
            assessment=fit.assessment,
        )


def fit_again(sums: WindowSums, earlier: EarlierFit, noise: CurrentNoise) -> FullFit:
    """Solve the variant selected by an earlier fit, on sums over its samples and further ones.

    Standard errors, lack of fit and outliers are those of the earlier fit, because they require the windows themselves.
    """
    model = replace(sums.model, orders=earlier.model.orders, cells=earlier.model.cells)
    if model.cells is not None or model.orders != sums.model.orders:
        sums = sums.over(model)
    if earlier.extended:
        sums = with_columns(sums, earlier.found.columns, move=earlier.moved)
    solver = Solver.over(sums)
    plain = solver.solve(earlier.spec)
    search = EffectSearch(sums, solver, plain, earlier.found)
    selection = Selection(plain, search)
    solution, _ = correct_attenuation(solver, plain, noise)
    return FullFit(model=sums.model, solution=solution, selection=selection, assessment=earlier.assessment)


@one_blas_thread()
def fit_full(
    sums: WindowSums,
    settings: FitSettings,
    turn: float,
    variance: float,
    earlier: EarlierFit | None = None,
    *,
    angle_variance: float = 0.0,
    interpolation_variance: float = 0.0,
) -> FullFit:
    """Select a model and fit it.

    Parameters
    ----------
    sums : WindowSums
        Finished.
    turn : float
        Angle turned per sample, rms, rad.
    variance : float
        Of white noise in i_d and i_q each, A^2.
    earlier : EarlierFit, optional
        Fit of most of these samples, whose selection is reused, see :func:`fit_again`.
    angle_variance : float
        Of white noise in the angle, rad^2.
    interpolation_variance : float
        Mean square error of interpolated angles, rad^2.
    """
    noise = CurrentNoise.met(variance, sums.kept(), angle_variance, interpolation_variance)
    if earlier is not None and not settings.passive_maps:
        return fit_again(sums, earlier, noise)
    selection = select(sums, settings, turn, noise)
    noise = noise.among(selection.search.sums.kept())
    judged = _judged(selection, noise, passive=settings.passive_maps)
    misfit, jump = _causes(selection, judged, settings, noise)
    assessment = _assessment(selection, judged, misfit, jump)
    return FullFit(
        model=selection.search.sums.model, solution=judged.solution, selection=selection, assessment=assessment
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Judged:
    """A solution, corrected, and all that its errors stem from."""

    uncorrected: FullSolution
    solution: FullSolution
    changes: FloatArray  # as in Assessment
    sources: tuple[str, ...]
    energy: FloatArray  # (B,), of the residuals of each batch of time, and when that is, s
    times: FloatArray
    misfit: LackOfFit
    by_rivals: dict[str, FloatArray]
    by_open: dict[str, FloatArray]  # changes by what the data leave open


def _judged(selection: Selection, noise: CurrentNoise, *, passive: bool) -> _Judged:
    """Correct the selected solution and judge it, without effects that are not significant by all its errors.

    What these would change is an error: that they are not significant does not show that there are none.
    """
    sums, solver, uncorrected = selection.search.sums, selection.solver, selection.solution
    crossed = bool(np.isfinite(selection.crossings))
    left_out: dict[str, FloatArray] = {}
    while True:
        corrected, by_noise = correct_attenuation(solver, uncorrected, noise)
        solution = enforce_passivity(solver, corrected) if passive else corrected
        batches, energy, times, misfit = residual_statistics(sums, solution, noise)
        by_delay = _by_delay(solver, uncorrected, selection)
        biases = (solver.shrinkage(solution), by_noise, UNCERTAIN_SHARE * solver.by_remainder(solution))
        within = [("noise", batches), ("bias", np.column_stack(biases)), ("open", by_delay), ("misfit", misfit.changes)]
        own = np.column_stack([changes for _, changes in within])
        weak = _weakest(sums.model, solution, own)  # another model moves an effect: it does not show that there is none
        if weak is None:
            break
        effects = without(solution.spec.effects, weak)
        with_weak, uncorrected = uncorrected, solver.solve(replace(solution.spec, effects=effects))
        left_out[weak] = with_weak.estimate - uncorrected.estimate
    by_rivals = _with_rivals(solver, uncorrected, selection)
    undecided = _with_undecided(solver, corrected, selection, noise)
    by_curve = _among_curves(solver, solution, batches, crossed)
    expected = _as_expected(solver, solution, selection, batches)
    by_open = {DELAY: by_delay} | undecided | expected | left_out
    every = [change for some in (undecided, expected, left_out, by_rivals) for change in some.values()]
    open_effects = np.column_stack([np.zeros(sums.model.size), *every])
    columns = [(name, np.column_stack([each])) for name, each in (*within, ("open", open_effects), ("curve", by_curve))]
    return _Judged(
        uncorrected=uncorrected, solution=solution, changes=np.hstack([each for _, each in columns]),
        sources=tuple(name for name, each in columns for _ in each.T), energy=energy, times=times,
        misfit=misfit, by_rivals=by_rivals, by_open=by_open,
    )  # fmt: skip


def _causes(
    selection: Selection, judged: _Judged, settings: FitSettings, noise: CurrentNoise
) -> tuple[LackOfFit, DelayJump | None]:
    """Return the lack of fit with its likely causes, and where the delay of the voltages changes."""
    sums, solver, misfit, found = selection.search.sums, selection.solver, judged.misfit, judged.solution.spec
    if selection.jump is not None:
        return misfit, selection.jump
    if misfit.ratio > LEAST_TOLD or not found.reciprocal:
        spec = selection.search.solution.spec
        expected = tuple(order for order in spec.orders if order in settings.harmonic_orders)
        reciprocal = solver.solve(replace(spec, effects=found.effects, orders=expected))
        # pole pairs that are not given are those that explain most, which is enough for a cause
        known = replace(settings, pole_pairs=selection.search.found.columns.pole_pairs or 1)
        tried = effects_to_try(sums, known)
        causes = tested_causes(sums, solver, reciprocal, tried, noise)
        misfit = replace(misfit, causes=causes)
    return misfit, jump_left(sums, judged.solution) if misfit.ratio > LEAST_TOLD else None


def _assessment(selection: Selection, judged: _Judged, misfit: LackOfFit, jump: DelayJump | None) -> Assessment:
    """Return what the windows tell of a judged solution."""
    sums, energy, kept = selection.search.sums, judged.energy, selection.search.sums.kept()
    turns = [np.angle(np.exp(1j * np.diff(windows.angle, axis=1)[:, 0])) / windows.duration for windows in kept]
    speeds = np.concatenate(turns)
    durations = np.concatenate([windows.duration for windows in kept])
    return Assessment(
        changes=judged.changes,
        sources=judged.sources,
        misfit=misfit,
        speeds=speeds,
        drop_slope=_drop_slope(sums.model, judged.solution, kept),
        turn=float(np.median(np.abs(speeds) * durations)),
        duration=float(np.median(durations)),
        outlying=float(energy.max() / max(np.median(energy), TINY)),
        outlying_share=float(np.sqrt(energy.max() / max(selection.solver.total_voltage, TINY))),
        outlying_time=float(judged.times[energy.argmax()]),
        unseen=_unseen(sums, judged.uncorrected),
        by_rivals=judged.by_rivals,
        open=_open(judged.changes[sums.model.map], judged.by_open, sums.model.map),
        jump=jump,
    )


def _open(changes: FloatArray, by_effect: dict[str, FloatArray], columns: slice) -> str:
    """Return the effect whose change (size,) is most of the variance of the map, from changes (M, B) of it all."""
    most = _MOST_BY_ONE * float(np.sum(changes**2))
    return next((name for name, change in by_effect.items() if np.sum(change[columns] ** 2) > most), "")


def _unseen(sums: WindowSums, solution: FullSolution) -> float:
    """Return the mean square residual of the windows that are not kept over that of the kept ones; 1 if all are."""
    if not sums.thinned:
        return 1.0
    kept = Windows.joined(sums.kept())
    seen, rows = float(np.sum(sums.model.residuals(kept, solution.estimate) ** 2)), 2 * len(kept)
    return (solution.sum_of_squares - seen) / (solution.rows - rows) / max(seen / rows, TINY)


def _by_delay(solver: Solver, solution: FullSolution, selection: Selection) -> FloatArray:
    """Return the change (size,) of the estimate by the error of a delay that is no certain half or whole sample.

    That is a standard error beyond the estimate, from which the nearest one may be off. At a constant speed it turns
    all fluxes, and the residuals hardly change. A delay that was not taken is one of none, unless the data leave room
    for half a sample: for more than that it does not count. Late currents or a late angle stand for it.
    """
    delay, found = Delay(solution.spec.delay, 0.0), selection.search.found.delay
    taken, late = delay.value == found.value, any(CATALOGUE[name].late for name in solution.spec.effects)
    if np.isnan(found.sigma) or (found.certain and (delay.physical or not taken)) or (late and not taken):
        return np.zeros(solver.model.size)
    step = found.off + np.copysign(found.sigma, found.off) if taken else min(found.sigma, HALF)
    other = float(np.clip(delay.value + step, -MOST_DELAY, MOST_DELAY))
    return solver.solve(replace(solution.spec, delay=other)).estimate - solution.estimate


def _with_undecided(
    solver: Solver, solution: FullSolution, selection: Selection, noise: CurrentNoise
) -> dict[str, FloatArray]:
    """Return the change (size,) of the estimate with or without each effect of which it is open whether it is there.

    Both are corrected for noise, which feigns a filter of the currents.
    """
    model, spec, out = solver.model, solution.spec, {}
    for name in selection.search.found.undecided if spec.reciprocal else ():
        effects = without(spec.effects, name) if name in spec.effects else tuple(sorted((*spec.effects, name)))
        other = solver.solve(replace(spec, effects=effects))
        out[name] = unattenuated(solver, other, noise) - solution.estimate
        out[name][model.effect(name)] = 0.0
    return out


def _as_expected(
    solver: Solver, solution: FullSolution, selection: Selection, batches: FloatArray
) -> dict[str, FloatArray]:
    """Return the change (size,) of the estimate by each effect that is expected, less where the data determine it.

    A trajectory that visits each current once, such as a grid in rows, cannot tell what varies with time from the map.
    """
    model, spec, out = solver.model, solution.spec, {}
    magnet = float(np.linalg.norm(model.flux.rows(np.zeros((1, 2))).dot(solution.estimate[model.map])))
    link = bool(np.isfinite(selection.search.found.columns.link))
    values = {name: solution.estimate[model.effect(name)] for name in spec.effects}
    fitted = Fitted(values, solution.resistance, magnet, link)
    for name, effect in CATALOGUE.items() if spec.reciprocal else ():
        if name not in spec.effects and (size := effect.expected(fitted)):
            change, left = solver.by_column(solution, model.effect(name).start)
            certain = _grown(solution, batches) * solution.residual_rms / np.sqrt(left)
            out[name] = np.asarray(change * size * certain / np.hypot(size, certain))
    return out


def _grown(solution: FullSolution, batches: FloatArray) -> float:
    """Return by what factor the errors of R by batches (size, B) exceed those by white residuals, at least 1."""
    return max(1.0, float(sigma(batches)[RESISTANCE]) / max(float(np.sqrt(solution.variance_of_resistance)), TINY))


def _with_rivals(solver: Solver, solution: FullSolution, selection: Selection) -> dict[str, FloatArray]:
    """Return the changes (size,) of the estimate with a rival in place of each effect that has any.

    Which of them the drive has is open, and so is what the others have taken.
    """
    model, spec, out = solver.model, solution.spec, {}
    for taken in selection.search.found.taken if spec.reciprocal else ():
        others = without(spec.effects, taken.name)
        delay = 0.0 if taken.name == DELAY else spec.delay
        changes = []
        for rival in taken.rivals if taken.name in (*spec.effects, DELAY) else ():
            effects = others if rival == DELAY else tuple(sorted((*others, rival)))
            alone = solver.solve(replace(spec, effects=effects, delay=delay))
            if rival == DELAY:
                alone = solver.solve(replace(alone.spec, delay=solver.delay(alone)[0]))
            change = alone.estimate - solution.estimate
            change[model.effects] = 0.0
            changes.append(change)
        if changes:
            out[taken.name] = max(changes, key=lambda change: float(np.linalg.norm(change[model.map])))
    return out


def _among_curves(solver: Solver, solution: FullSolution, batches: FloatArray, crossed: bool) -> FloatArray:
    """Return the change (size,) of the estimate with another curve of the inverter that moves R most, if beyond noise.

    Selecting a curve does not show that it is true, and R takes the difference. From one shape to the next, R may stand
    still by accident: all of them count. Where zero crossings disturb, the drop is no curve: they count also within
    noise. That is as much larger than of white residuals as the changes (size, B) by batches are. Beyond it, a curve
    counts as far as the data, not what is known of inverters, decide on its wide shapes.
    """
    spec, out = solution.spec, np.zeros_like(solution.estimate)
    grown = _grown(solution, batches)
    for wide in set(range(WIDE + 1)) - {spec.wide}:
        other = solver.solve(replace(spec, wide=wide))
        change = other.estimate - solution.estimate
        noise = np.sqrt(abs(other.variance_of_resistance - solution.variance_of_resistance))
        ratio = abs(change[RESISTANCE]) / max(grown * noise, TINY)
        if not (spec.wide or crossed):
            shapes = other.estimate[solver.model.phase_columns()].mean(axis=1)
            uncertain = np.abs(shapes[-WIDE:]).max() / max(ratio * abs(shapes.sum()), TINY)
            change = change * (ratio > _BY_SHAPE) / (1 + (uncertain / _BEND) ** 2)
        if abs(change[RESISTANCE]) > abs(out[RESISTANCE]):
            out = change
    return out


def _weakest(model: FullModel, solution: FullSolution, changes: FloatArray) -> str | None:
    """Return the least significant effect, or None if all are: by one of its unknowns, or by all of them together."""
    ratios = {}
    for name in solution.spec.effects:
        own = model.effect(name)
        errors = np.maximum(sigma(changes[own]), TINY)
        relative, alike = solution.estimate[own] / errors, changes[own] / errors[:, None]
        together = float(relative @ np.linalg.pinv(alike @ alike.T, rcond=_ALIKE, hermitian=True) @ relative)
        by_chance = np.count_nonzero(relative) - 1  # more than a single unknown
        ratios[name] = float(np.sqrt(max(np.max(relative**2), together - by_chance)))
    weakest = min(ratios, key=lambda name: ratios[name], default=None)
    return weakest if weakest is not None and ratios[weakest] < SIGNIFICANCE else None


def _drop_slope(model: FullModel, solution: FullSolution, kept: Sequence[Windows]) -> float:
    i_abc = np.concatenate([frames.to_abc(windows.i_dq[:, 0], windows.angle[:, 0]) for windows in kept])
    heights = solution.estimate[model.phase_columns()].mean(axis=1)
    step = _SLOPE_STEP * model.i_max
    sides = [(model.shapes(i_abc + sign * step) @ heights).mean() for sign in (1, -1)]
    return float(sides[0] - sides[1]) / (2 * step)


def enforce_passivity(solver: Solver, solution: FullSolution) -> FullSolution:
    """Increase the roughness penalty tenfold until the inductance matrix is positive definite on the whole disc.

    A passive solution is returned unchanged. After a bounded number of rounds, the solution is returned even if it is
    not passive; the review then warns.
    """
    model = solver.model
    axes = [np.linspace(low, high, _PASSIVE_POINTS) for low, high in zip(model.low, model.high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    i_dq = grid[np.hypot(*grid.T) <= model.i_max]
    for _ in range(_ROUNDS):
        if positive_definite(jacobian(model.flux, solution.estimate[model.map], i_dq)).all():
            break
        solution = solver.solve(replace(solution.spec, penalty=_STIFFER * solution.spec.penalty))
    return solution
