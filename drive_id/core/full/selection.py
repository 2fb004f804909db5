"""Model selection of method ``full``: delay, harmonics, smoothness, and whether the maps are reciprocal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.common.origins import ORIGINS
from drive_id.core.fit_settings import MOST_ORDERS, FitSettings
from drive_id.core.full.delay import Delay, DelayJump, delay_jump
from drive_id.core.full.effect_search import (
    LEAST_BESIDE,
    effect_savings,
    plausible_effects,
    search_effects,
    turning,
    with_effects_only,
)
from drive_id.core.full.effects.catalogue import CATALOGUE
from drive_id.core.full.effects.effect import Recorded, parts
from drive_id.core.full.linearized import EffectSearch
from drive_id.core.full.model import PENALTIES, RESISTANCE, FullModel, ModelSpec
from drive_id.core.full.order_search import distinct_orders, explained_shares, significant_orders, unexpected_orders
from drive_id.core.full.resolution import HARMONIC_CELLS, Misfit, misfit_by_cell
from drive_id.core.full.solver import LEAST_SAVED, CurrentNoise, FullSolution, Solver, predictable
from drive_id.core.full.standard_errors import SIGNIFICANCE, changes_by_batch, sigma
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import MOST_DELAY, Windows
from drive_id.core.full.zero_crossings import between_crossings, crossings_exceed
from drive_id.core.maps.flux_models import jacobian
from drive_id.core.maps.inverter_curve import WIDE
from drive_id.types import FloatArray

_CLEAR_GAIN = 0.05
"""Share of the squared error on held-out data that a variant must save: less may be chance."""
_LEAST_COMPENSATED = 0.2
"""Share of the drop from which on lagging columns are taken for a compensation."""
_CURVE_POINTS = 201
"""Over [0, i_max], over which the means of drop and lag are taken."""
LEAST_HEATING = 5.0
"""Least range of magnet temperature for which the magnet's temperature coefficient is estimated, K."""
_SEARCHES = 2
"""Most searches for further harmonics: strong ones hide weak ones."""
_OFFSET = "current_offset"
_FREE_TURN = np.deg2rad(3.0)
"""Electrical angle per sample above which free maps are not tried: what the current does between samples is known to
second order only, and what remains is not reciprocal. Of 224 random drives, free maps won in 14 with reciprocal
machines, 12 of them faster than this, and in 5 with others, 4 of them slower, where they gained 0.03 to 0.06 %."""
_PROMISING = 0.3
"""Share of the residuals' variance that free maps must save over cells of the usual size to be tried over fine ones.
Of the squares, they save 0.09 and 0.25 on reciprocal machines whose details those cells miss, 0.39 where 0.1 % of the
flux is not reciprocal."""
_MOST_LEFT = 0.5
"""Share of the squared residuals that a provisional delay may leave: hard dead time resembles one, but leaves more."""
_MISFIT_WINDOWS = 6000
"""Windows whose residuals are attributed to cells, some 100 for each cell of an axis, and over which free maps must
promise a gain."""
_REFINEMENTS = 4
"""Most divisions of the cells, each to a half or a quarter: from 28 to 0.1 A at i_max = 400 A."""
_LOCAL = 1e-3
"""Misfit of a cell, relative to the integrated voltage, that matters to nobody."""


@dataclass(frozen=True, eq=False)
class Selection:
    """The selected variant, its fit, and the quantities behind the selection."""

    solution: FullSolution
    search: EffectSearch  # the selected effects of real drives
    # share by which free maps, where they are selected, reduce the squared error on held-out data
    advantage: float = np.nan
    # excess of the residuals of windows with a zero crossing, see
    # :func:`~drive_id.core.full.zero_crossings.between_crossings`; NaN where the fit includes them
    crossings: float = np.nan
    jump: DelayJump | None = None  # of the delay of the voltages, which no variant follows: nothing else was selected

    @property
    def solver(self) -> Solver:
        """Of the solution."""
        return self.search.solver


def select(sums: WindowSums, settings: FitSettings, turn: float, noise: CurrentNoise) -> Selection:
    """Select and fit a variant of the model, see :func:`~drive_id.core.full.fit.fit_full`.

    Its sums cover other harmonics when the residuals show harmonics that were not among the candidates.
    """
    if settings.maps == "free":
        sums = sums.freed(sums.model.orders)
    crossings, solver = np.nan, Solver.over(sums)
    start = _aligned(sums, solver, settings, turn)
    if (first := jump_left(sums, start)) is not None:
        candidate = _candidate(sums, _undelayed(solver, start, settings), settings, turn, noise)
        search = candidate.search
        if (jump := jump_left(search.sums, search.solution)) is not None:
            return Selection(
                search.solution, search, jump=first if np.isfinite(first.drift) else replace(jump, drift=np.nan)
            )
    bounded = noise.at_most(solver, start)  # fast currents look like noise to their differences
    sums, solver, start = _resolved(sums, solver, start, bounded)
    # without a motion of the rotor, only windows near zero current tie the map to its value there
    between = between_crossings(sums, solver, start, noise) if ORIGINS[settings.method].turning else None
    if between and not (
        _offset_explains(sums, solver, start, noise) or _free_maps_explain(sums, solver, start, settings, turn, noise)
    ):
        sums, crossings = between
        noise = noise.among(sums.kept())
        solver = Solver.over(sums)
        start = _aligned(sums, solver, settings, turn)
    start = _undelayed(solver, start, settings)
    del solver
    candidate = _candidate(sums, start, settings, turn, noise)
    known = sums.model.orders
    for _ in range(_SEARCHES if settings.search_orders else 0):
        found, solution = candidate.search.sums, candidate.search.solution
        new = unexpected_orders(sums.model, solution.estimate, found.kept(), known)
        new = tuple(order for order in new if order in distinct_orders((*known, order), turn))
        if not new:
            break
        caused = [CATALOGUE[name].harmonic for name in solution.spec.effects]
        others = tuple(order for order in new if order not in caused)
        new, before = others or new, None if others else (sums, candidate)
        sums = sums.over(replace(sums.model, orders=(*solution.spec.orders, *new)[:MOST_ORDERS]))
        known = (*known, *new)
        del candidate, found, solution  # their matrices are large
        solver = Solver.over(sums)
        start = _undelayed(solver, _aligned(sums, solver, settings, turn), settings)
        del solver
        candidate = _candidate(sums, start, settings, turn, noise)
        if before and not _clearly_better(candidate.search.solver, before[1].error, candidate.error):
            sums, candidate = before  # effects cause what there is
            break
        before = None
    if candidate.search.found.taken:  # what they explain may have hidden where the cells are too coarse
        candidate = _with_finer_cells(sums, candidate, settings, turn, bounded)
    return replace(_with_free_maps(sums, candidate, settings, turn, noise), crossings=crossings)


def jump_left(sums: WindowSums, solution: FullSolution) -> DelayJump | None:
    """Return the jump of the delay of the voltages that a solution leaves, if there is one."""
    windows = Windows.joined(list(sums.kept()))
    return delay_jump(windows, sums.model.residuals(windows, solution.estimate))


def _with_finer_cells(
    sums: WindowSums, candidate: _Candidate, settings: FitSettings, turn: float, noise: CurrentNoise
) -> _Candidate:
    """Return the candidate over finer cells if held-out data gain by them, else this one.

    Cells are divided once where the map bends, if there is an effect that turns the flux: only there iron loss differs
    from a delay, and coarse cells decide wrongly. Then cells are divided where the residuals exceed noise.
    """
    bent = False
    for _ in range(_REFINEMENTS):
        search = candidate.search
        solution, resolution = search.solution, search.solver.model.resolution
        turned, cells = turning(search.found.taken), resolution
        if turned and not bent:
            cells = resolution.where_bent(*_bends(search.solver.model, solution))
        by_misfit = cells is resolution
        if by_misfit:
            misfit = _misfit(search.sums, solution, noise, search.solver.total_voltage)
            cells = cells.finer(misfit) if misfit.shows else cells
        if cells is resolution or not solution.spec.reciprocal:
            break
        finer = sums.over(replace(sums.model, cells=cells))
        if by_misfit and not _gain(finer, candidate):
            break
        solver, delay = Solver.over(finer), 0.0 if settings.calibrate_delay else settings.voltage_delay
        spec = replace(solution.spec, effects=(), delay=delay)
        found = _candidate(finer, solver.solve(spec), settings, turn, noise)
        better = _saves if turned != turning(found.search.found.taken) else _clearly_better
        if better(solver, candidate.error, found.error):
            candidate = found
        elif by_misfit:
            break
        bent = True
    return candidate


def _gain(finer: WindowSums, candidate: _Candidate) -> bool:
    """Tell whether finer cells promise a gain on held-out data with the effects as they are: a search takes long."""
    search = candidate.search
    solver = Solver.over(search.linearized(finer))
    return solver.left_out_if_less(search.solution.spec, candidate.error) is not None


def _resolved(
    sums: WindowSums, solver: Solver, solution: FullSolution, noise: CurrentNoise
) -> tuple[WindowSums, Solver, FullSolution]:
    """Return sums, solver and solution with finer cells where residuals exceed noise and held-out data gain by them.

    The cells of the map are divided first, then those of the harmonics as well.
    """
    spec, error = solution.spec, None
    for _ in range(_REFINEMENTS):
        cells = sums.model.resolution
        misfit = _misfit(sums, solution, noise, solver.total_voltage)
        if not misfit.shows:
            break
        if error is None:
            spec, error = solver.best_penalty(spec)
        local = cells.finer(misfit)
        tried = [] if local is cells else [local]  # as many as there may be
        tried += [replace(local, harmonic=2 * HARMONIC_CELLS)] if cells.harmonic == HARMONIC_CELLS else []
        for candidate in tried:
            finer = sums.over(replace(sums.model, cells=candidate))
            other = Solver.over(finer)
            if (better := other.better_penalty(spec, error)) is None:
                continue
            found, by_finer = better
            if _clearly_better(solver, error, by_finer):
                sums, solver, spec, error, solution = finer, other, found, by_finer, other.solve(found)
                break
        else:
            break
    return sums, solver, solution


def _bends(model: FullModel, solution: FullSolution) -> list[FloatArray]:
    """Return by how much L_dd changes over each cell along i_d, and L_qq along i_q, relative to the largest of each."""
    cells = model.resolution
    grid = np.stack(np.meshgrid(cells.d, cells.q, indexing="ij"), axis=-1)
    inductances = jacobian(model.flux, solution.estimate[model.map], grid.reshape(-1, 2)).reshape(*grid.shape, 2)
    inductances[np.hypot(*np.moveaxis(grid, -1, 0)) > model.i_max] = np.nan
    changes = []
    for axis in (0, 1):
        own = np.moveaxis(inductances[..., axis, axis], axis, 0)
        changes.append(np.nan_to_num(np.abs(np.diff(own, axis=0))).max(axis=1) / np.nanmax(np.abs(own)))
    return changes


def _misfit(sums: WindowSums, solution: FullSolution, noise: CurrentNoise, total_voltage: float) -> Misfit:
    model, windows = sums.model, Windows.joined(list(sums.kept())).thinned(_MISFIT_WINDOWS)
    squares = np.square(model.residuals(windows, solution.estimate)).sum(axis=1)
    expected = noise.expected(model, solution.estimate, windows)
    return misfit_by_cell(model.resolution, windows.i_dq, squares, expected, _LOCAL**2 * total_voltage)


def _clearly_better(solver: Solver, error: FloatArray, other: FloatArray) -> bool:
    """Tell whether squared errors (F,) on data left out are clearly smaller than others.

    Clearly means more than noise does, in all folds but one, and by more than a negligible voltage. A fold that the
    others cannot predict is one of them: what it loses is not made up by what another one gains.
    """
    return _saves(solver, error, other) and bool(np.sum(other < error) >= len(error) - 1)


def _saves(solver: Solver, error: FloatArray, other: FloatArray) -> bool:
    """Tell whether squared errors (F,) on data left out are smaller by more than noise and a negligible voltage."""
    folds = predictable(error)
    return _shows(solver, error, other) and bool(1.0 - other[folds].sum() / error[folds].sum() > _CLEAR_GAIN)


def _shows(solver: Solver, error: FloatArray, other: FloatArray | float = 0.0) -> bool:
    """Tell whether squared errors (F,) on data left out exceed others, by default none, by a voltage that matters."""
    return bool((error - other)[predictable(error)].mean() > LEAST_SAVED**2 * solver.total_voltage)


def _first_spec(sums: WindowSums, settings: FitSettings, turn: float) -> ModelSpec:
    """Return the variant with all candidate harmonics and no effects."""
    model = sums.model
    distinct = distinct_orders(model.orders, turn)
    orders = tuple(order for order in model.orders if order in distinct)
    heating = np.concatenate([windows.magnet_heating for windows in sums.kept()])
    return ModelSpec(
        settings.maps != "free",
        orders,
        per_phase=settings.per_phase_inverter,
        penalty=PENALTIES[-2],
        magnet=bool(np.ptp(heating) > LEAST_HEATING),
        delay=0.0 if settings.calibrate_delay else settings.voltage_delay,
    )


def _offset_explains(sums: WindowSums, solver: Solver, start: FullSolution, noise: CurrentNoise) -> bool:
    """Tell whether an offset of the currents, which shifts the step of the drop, explains the misfit at zero crossings.

    Short windows hardly determine an offset, and are not used then. An offset that is found but leaves the crossings as
    they are is no reason: noise that the drop turns into voltage may exceed that at the ends there.
    """
    found = search_effects(sums, start, noise, [_OFFSET], turn=0.0, pole_pairs=1)
    if not found.solution.spec.effects:
        return False
    short = Windows.joined(sums.kept_short())
    by_offset = replace(short, effects=found.found.columns(short))
    return _calms_crossings((solver, start, short), (found.solver, found.solution, by_offset), noise)


def _free_maps_explain(
    sums: WindowSums, solver: Solver, start: FullSolution, settings: FitSettings, turn: float, noise: CurrentNoise
) -> bool:
    """Tell whether maps that are not reciprocal explain the misfit at zero crossings, which is then all over."""
    if settings.maps != "auto" or not _may_be_free(start.spec, turn):
        return False
    freed = Solver.over(sums.freed(start.spec.orders))
    free, short = freed.solve(replace(start.spec, reciprocal=False)), Windows.joined(sums.kept_short())
    return _calms_crossings((solver, start, short), (freed, free, short), noise)


_Fit = tuple[Solver, FullSolution, Windows]
"""Of the sums, and short windows to judge it by."""


def _calms_crossings(before: _Fit, after: _Fit, noise: CurrentNoise) -> bool:
    """Tell whether residuals at zero crossings exceed the others in one fit, and do not in another one."""
    return any(
        crossings_exceed(*before, expected_by) and not crossings_exceed(*after, expected_by)
        for expected_by in (noise.at_ends, noise.expected)
    )


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A variant with its effects, and its squared errors (F,) on data left out, (Vs)^2."""

    search: EffectSearch
    error: FloatArray


def _candidate(
    sums: WindowSums, start: FullSolution, settings: FitSettings, turn: float, noise: CurrentNoise
) -> _Candidate:
    """Detect effects or a delay, then the harmonics, then the penalty, from a solution with all harmonics."""
    allowed = effects_to_try(sums, settings) if start.spec.reciprocal else ()
    calibrated = settings.calibrate_delay and start.spec.reciprocal
    search = search_effects(sums, start, noise, allowed, turn if calibrated else 0.0, settings.pole_pairs or None)
    while True:
        solver, solution = search.solver, search.solution
        if any(CATALOGUE[name].moves_steps for name in solution.spec.effects):
            solution = solver.solve(replace(solution.spec, crossing=False))
            solution = _with_early_steps(solver, solution, LEAST_BESIDE)
        significant = significant_orders(solver.model, solution, noise.windows.i_dq[:, 0])
        spec, error = solver.best_penalty(replace(solution.spec, orders=significant))
        final = solver.solve(spec)
        plausible = plausible_effects(final, solver.model, noise)
        if plausible == spec.effects:
            wide = _with_wide_curve(search, final)
            if wide is not final:
                spec, error = solver.best_penalty(wide.spec)
                final = solver.solve(spec)
            return _Candidate(replace(search, solution=final), error)
        search = with_effects_only(sums, replace(search, solution=solution), plausible)


def _with_free_maps(
    sums: WindowSums, candidate: _Candidate, settings: FitSettings, turn: float, noise: CurrentNoise
) -> Selection:
    """Select free maps if they predict data left out clearly better than the best reciprocal variant."""
    search, error = candidate.search, candidate.error
    spec = search.solution.spec
    if not (settings.maps == "auto" and _may_be_free(spec, turn) and _shows(search.solver, error)):
        return Selection(search.solution, search)
    free = replace(spec, reciprocal=False, delay=0.0 if settings.calibrate_delay else spec.delay)
    if not _promise(search.sums, spec, free):
        return Selection(search.solution, search)
    freed = search.sums.freed(spec.orders)
    solver = Solver.over(freed)
    if freed.windows != sums.windows:
        error = solver.left_out(spec)[:, 0]
    advantage = _advantage(solver, free, error)
    if free.effects:  # which may only have stood for what reciprocal maps cannot follow
        without = replace(free, effects=())
        alone = _advantage(solver, without, error)
        if not np.isnan(alone) and not alone < advantage - _CLEAR_GAIN * (1 - alone):
            free, advantage = without, alone
    if np.isnan(advantage):
        return Selection(search.solution, search)
    orders = _first_spec(search.sums, settings, turn).orders
    freed = search.sums.freed(search.sums.model.orders)
    if search.sums.effects is None:
        freed = freed.with_effects(search.found.columns)
    search = replace(search, sums=freed, solver=Solver.over(freed))
    everything = search.solver.solve(replace(free, orders=orders, crossing=False))
    everything = _with_early_steps(search.solver, everything)  # a misfit of the maps hides them
    significant = significant_orders(freed.model, everything, noise.windows.i_dq[:, 0])
    spec = search.solver.best_penalty(replace(everything.spec, orders=significant))[0]
    return Selection(search.solver.solve(spec), search, advantage)


def _promise(sums: WindowSums, spec: ModelSpec, free: ModelSpec) -> bool:
    """Tell whether free maps leave clearly less of some windows, over cells of the usual size.

    They take most of a fit's time and memory, over fine cells above all, and what is not reciprocal is no finer than
    what is. In the variance of windows that are fitted they gain about twice as much as for data left out.
    """
    model = replace(sums.model, orders=spec.orders, reciprocal=False, cells=None)
    solver = Solver.over(sums.over(model, {0: Windows.joined(sums.kept()).thinned(_MISFIT_WINDOWS)}))
    fits = [solver.solve(replace(each, penalty=PENALTIES[0])) for each in (spec, free)]
    left, by_free = (fit.sum_of_squares / max(fit.rows - fit.unknowns, 1.0) for fit in fits)
    least = _PROMISING if sums.model.resolution.finer_than_usual else _CLEAR_GAIN
    return by_free < (1.0 - least) * left


def _may_be_free(spec: ModelSpec, turn: float) -> bool:
    """Tell whether free maps are tried: a large delay can mimic any misfit."""
    return turn < _FREE_TURN and abs(spec.delay) < MOST_DELAY


def _aligned(sums: WindowSums, solver: Solver, settings: FitSettings, turn: float) -> FullSolution:
    """Solve with a provisional delay of half or whole samples, where there is one.

    Voltages that are a sample off miss the steps of the drop, which looks like a compensation, like hard dead time, and
    like a map that is too coarse.
    """
    spec = _first_spec(sums, settings, turn)
    solution = _compensated(solver, spec)
    if settings.calibrate_delay and abs(solver.delay(solution)[0]) > 0.25:  # nearer to half a sample than to none
        plain = solver.solve(spec)
        delayed = replace(spec, delay=Delay(solver.delay(plain)[0]).nearest)
        if solver.solve(delayed).sum_of_squares < _MOST_LEFT * plain.sum_of_squares:
            return _compensated(solver, delayed)
    return solution


def _undelayed(solver: Solver, solution: FullSolution, settings: FitSettings) -> FullSolution:
    """Solve without the provisional delay, which competes with the effects, and with early steps, if there are any."""
    delay = 0.0 if settings.calibrate_delay else settings.voltage_delay
    if solution.spec.delay != delay:
        solution = solver.solve(replace(solution.spec, delay=delay))
    return _with_early_steps(solver, solution)


def _compensated(solver: Solver, spec: ModelSpec) -> FullSolution:
    """Solve; include the remainder of an inverter compensation if one is detected."""
    solution = solver.solve(spec)
    if solver.saving(solution, solver.model.lags)[0] > _CLEAR_GAIN:
        lagged = solver.solve(replace(spec, lag=True))
        if compensates(solver.model, lagged):
            return lagged
    return solution


def _with_early_steps(solver: Solver, solution: FullSolution, least: float = 0.0) -> FullSolution:
    """Fit the time by which the drop's steps come early, if it saves more than the share ``least`` of the squares.

    A late step is not caused by the inverter.
    """
    saving, value = solver.saving(solution, slice(solver.model.crossing, solver.model.crossing + 1))
    if value[0] <= 0 or saving < least:
        return solution
    return solver.solve(replace(solution.spec, crossing=True))


def _with_wide_curve(search: EffectSearch, solution: FullSolution) -> FullSolution:
    """Add wide shapes to the inverter's curve, as many as change R by more than noise does.

    R takes a part of a drop that still bends at large currents. Which part depends on the shapes. Near zero current,
    the curve amplifies noise, which is not white then.
    """
    for wide in range(1, WIDE + 1):
        wider = search.solver.solve(replace(solution.spec, wide=wide))
        white = np.sqrt(abs(wider.variance_of_resistance - solution.variance_of_resistance))
        least = abs(wider.resistance - solution.resistance) / SIGNIFICANCE
        if least >= white:
            one, two = (changes_by_batch(search.sums, each, RESISTANCE) for each in (solution, wider))
            if least >= sigma(two - one):
                solution = wider
    return solution


def effects_to_try(sums: WindowSums, settings: FitSettings) -> tuple[str, ...]:
    """Return the effects that can be estimated from these data."""
    kept = sums.kept()
    known = Recorded(
        runs=1 + max(int(windows.run.max()) for windows in kept),
        parts=parts(kept),
        link=any(np.isfinite(windows.link).any() for windows in kept),
        temperatures=bool(settings.temperatures),
        pole_pairs=settings.pole_pairs > 0,
        sensors=settings.calibrate_currents,
        turned=sums.turned,
    )
    turning = ORIGINS[settings.method].turning
    return tuple(name for name, effect in CATALOGUE.items() if effect.possible(known) and (turning or effect.at_rest))


def compensates(model: FullModel, solution: FullSolution) -> bool:
    """Tell whether the lag columns describe an inverter compensation rather than noise near zero current.

    A drive that compensates the share k of a drop D by the currents one sample earlier leaves the drop (1 - k) D and
    the lag k D, positive like the drop. Both are compared as means over positive currents.
    """
    current = model.i_max * np.linspace(0.0, 1.0, _CURVE_POINTS)
    lag = (model.shapes.coarse(current) @ solution.estimate[model.lags]).mean()
    drop = (model.shapes(current) @ solution.estimate[model.phase_columns()]).mean()
    return bool(lag > _LEAST_COMPENSATED * (lag + abs(drop)))


def _advantage(solver: Solver, spec: ModelSpec, error: FloatArray) -> float:
    """Return by which share free maps reduce the squared errors (F,) on data left out; NaN unless they do clearly.

    Stops early when the first two folds show no gain.
    """
    found = solver.better_penalty(spec, error)
    if found is None or not _clearly_better(solver, error, other := found[1]):
        return np.nan
    folds = predictable(error)
    return 1.0 - float(other[folds].sum() / error[folds].sum())


def tested_causes(
    sums: WindowSums, solver: Solver, solution: FullSolution, effects: Sequence[str], noise: CurrentNoise
) -> dict[str, float]:
    """Return the share of the squared residuals that each possible cause would explain.

    Keys are the names of ``effects`` that are not in the solution, ``devices`` for drops that differ between the
    phases, and ``harmonic h`` for the rotor-position harmonic that explains most.
    """
    model, kept = sums.model, sums.kept()
    causes = effect_savings(solver, solution, [name for name in effects if name not in solution.spec.effects], noise)
    causes["devices"] = solver.saving(solution, slice(model.drops.start, model.drops.start + 3 * model.shapes.usual))[0]
    shares = explained_shares(model, solution.estimate, kept)
    causes[f"harmonic {1 + int(shares.argmax())}"] = float(shares.max())
    return causes
