"""Greedy search for effects of real drives: add the best one until none explains enough of the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drive_id.core.full.between_samples import UNCERTAIN_SHARE
from drive_id.core.full.delay import SPEEDS_APART, Delay, estimate_delay
from drive_id.core.full.effects import EffectColumns
from drive_id.core.full.link_ripple import ripple_frequency
from drive_id.core.full.model import EFFECTS, PENALTIES, VOLTAGE, FullModel, ModelSpec
from drive_id.core.full.solver import LEAST_TOLD, CurrentNoise, FullSolution, Solver, better_on_most_folds, predictable
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import SEARCHED, Windows
from drive_id.types import TINY, FloatArray

DELAY = "voltage_delay"

_LEAST_SAVING = 3e-3
"""Share of the squared residuals that an effect must explain; below 1e-3 for drives that obey the model."""
LEAST_BESIDE = 1e-3
"""The same beside the effect that it comes with."""
_PER_UNKNOWN = 5.0
"""Further share for each unknown, in units of the share of one row."""
_LEAST_VOLTAGE = 5e-5
"""Rms that an effect must explain, relative to that of the integrated voltages."""
_CLOSE = 0.05
"""Relative difference of savings below which two effects explain the residuals equally well, and the share of the
squared residuals by which a wrong effect may seem to explain more than a true delay."""
_MOST_BY_PENALTY = 0.3
"""Largest relative change of an effect when the largest penalty is used."""
_OF_LINK, _OF_MISFIT = ("link_ripple", "link_sag"), 0.5
"""Variations of the DC link, and the share of the squared residuals beyond noise that one must explain: the misfit of a
map recurs with the trajectory and the power, and a part of it looks like theirs."""
_GROWN = 1.03
"""Growth of the residuals at which a linearization is worse than that before; by chance they may grow less."""
_SETTLING, _SETTLED = 5, 0.01
"""Most linearizations, and the relative decrease of the residuals below which they end."""
_AT_ONE_SPEED = {"hysteresis": "iron_loss"}
_TURNING = {DELAY, "current_latency", "angle_latency", "iron_loss", "hysteresis", "coercivity"}
"""All of them turn the flux against the currents: at one speed they resemble one another, and only the bends of the map
tell them apart."""
_RIVAL = 0.3
"""Share of the largest saving from which on a rival is linearized again before it loses: iron loss that moves currents
across a saturating bridge saves half of it at first."""
_LONGEST_LATENCY = 0.8
"""Of angle or currents, sample periods: the columns hold below 1."""
_LARGEST_LAG = 0.2
"""Largest plausible share of the flux that lags behind the current, by eddy currents in magnets and sleeves."""
_TIMING = {DELAY, "current_latency", "angle_latency", "current_rotation"}
"""All of them rotate the flux against the currents, but for the last by the speed: at one speed, the data hold one."""
_BESIDE = {"current_rotation": "current_gains"}
"""Effects that are tried beside another one only: sensors that turn the currents have unequal gains as well."""
_POSITIVE = ("iron_loss", "flux", "link_sag")
_FAMILIES = {"hysteresis": "iron_loss", "coercivity": "iron_loss", "flux_lag": "flux"}


@dataclass(frozen=True)
class Taken:
    """An effect that was taken into the model."""

    name: str  # in ``EFFECTS``, or ``DELAY``
    rivals: tuple[str, ...]  # effects that would have explained nearly as much


@dataclass(frozen=True, eq=False)
class FoundEffects:
    """What a search has found."""

    columns: EffectColumns  # linearized about the estimate
    taken: tuple[Taken, ...] = ()  # in the order in which they were found
    delay: Delay = field(default_factory=Delay)  # of the voltages, if it was requested


@dataclass(frozen=True, eq=False)
class EffectSearch:
    """The solution with the selected effects."""

    sums: WindowSums  # with the columns of all effects if any effect was selected; otherwise without, to save memory
    solver: Solver  # of sums with the columns of all effects
    solution: FullSolution
    found: FoundEffects


def search_effects(
    sums: WindowSums,
    solution: FullSolution,
    noise: CurrentNoise,
    allowed: Sequence[str],
    turn: float,
    pole_pairs: int | None = None,
) -> EffectSearch:
    """Add effects to the model one by one, best first.

    A delay that is no half or whole number of samples may stand for one that is, beside an effect: at one speed, iron
    loss turns the flux as well. Both are tried.

    Parameters
    ----------
    sums : WindowSums
        Without effects.
    solution : FullSolution
        The fit without effects.
    allowed : sequence of str
        Names in ``EFFECTS`` to try.
    turn : float
        Electrical angle per sample, rad; 0 to leave a delay of the voltages as it is.
    pole_pairs : int, optional
        Default: the number at which an eccentric resolver explains most of the residuals.
    """
    columns = _columns(sums, solution, noise, pole_pairs)
    start = _settled(sums, solution.spec, columns)
    search = _greedy(sums, start, noise, allowed, turn)
    delay = replace(search.found.delay, value=search.solution.spec.delay)
    if turn > 0 and delay.value != solution.spec.delay and not (delay.physical or delay.decimation):
        for value in delay.between:
            delayed = _settled(sums, replace(solution.spec, delay=value), columns)
            other = _greedy(sums, delayed, noise, allowed, 0.0, (Taken(DELAY, ()),))
            if other.solution.sum_of_squares < search.solution.sum_of_squares:
                search = replace(other, found=replace(other.found, delay=Delay(value, delay.sigma)))
    return search


def _greedy(
    sums: WindowSums,
    state: EffectSearch,
    noise: CurrentNoise,
    allowed: Sequence[str],
    turn: float,
    taken: tuple[Taken, ...] = (),
) -> EffectSearch:
    """Add effects to those taken one by one, best first, and a delay unless ``turn`` is 0."""
    solver, solution = state.solver, state.solution
    delay = estimate_delay(solver, solution, noise) if turn > 0 else state.found.delay
    one_speed = not several_speeds(noise.windows.speed.mean(axis=1))
    while True:
        timed = one_speed and bool(_TIMING & {each.name for each in taken})
        allowed = [name for name in allowed if not (timed and name in _TIMING)]
        taken_effects = solution.spec.effects
        tried = [name for name in allowed if name not in taken_effects and _BESIDE.get(name) in (None, *taken_effects)]
        savings = effect_savings(solver, solution, tried, noise.period)
        beyond = _beyond(solver.model, solution, noise)
        savings |= {name: 0.0 for name in _OF_LINK if savings.get(name, 0.0) < _OF_MISFIT * beyond}
        if turn > 0 and solution.spec.delay == 0 and not timed:
            if taken:
                delay = estimate_delay(solver, solution, noise)
            if delay.significant(turn):
                delayed = solver.solve(replace(solution.spec, delay=delay.value))
                savings[DELAY] = _saving(solution, delayed)
        best, settled = _best(savings, physical=delay.physical), {}
        if best in _TURNING and sums.model.resolution.halved and not (one_speed and turning(taken)):
            rivals = _rivals(savings, best, one_speed=one_speed)
            settled = _rivals_settled(sums, replace(state, solution=solution), rivals)
            best = _best_predictor(settled, (solver, delayed) if best == DELAY else None) or best
            savings |= {name: _saving(solution, each.solution) for name, each in settled.items()}
        if best is None or not (best == DELAY or _worthwhile(solver, solution, best, savings[best])):
            break
        if best not in (DELAY, *settled) and not _by_data(solver, solution, best):
            allowed = [name for name in allowed if name != best]
            continue
        family = _family(best)
        near = max(savings[best] - max(_CLOSE * savings[best], _LEAST_SAVING), 0.0)
        rivals = tuple(name for name, saving in savings.items() if saving > near and _family(name) != family)
        if best == DELAY:
            solution = delayed
        else:
            spec = _with_effect(solution.spec, best)
            if not better_on_most_folds(*solver.left_out_with_and_without(spec, best).T):
                break
            columns = replace(state.found.columns, estimate=solver.solve(spec).estimate)
            state = _with_hidden_ripple(sums, settled.get(best) or _settled(sums, spec, columns), noise)
            solver, solution = state.solver, state.solution
        taken = (*taken, Taken(best, rivals))
    names = {each.name for each in taken}
    extended = sums if names <= {DELAY} and not _remains(solver) else state.sums
    taken = tuple(replace(each, rivals=tuple(name for name in each.rivals if name not in names)) for each in taken)
    found = FoundEffects(state.found.columns, taken, delay)
    return EffectSearch(extended, solver, solution, found)


def _with_effect(spec: ModelSpec, name: str) -> ModelSpec:
    return replace(spec, effects=(*spec.effects, name))


def _saving(solution: FullSolution, other: FullSolution) -> float:
    """Return by which share another solution reduces the squared residuals."""
    return 1.0 - other.sum_of_squares / solution.sum_of_squares


def turning(taken: Sequence[Taken]) -> set[str]:
    """Return the names of those effects that turn the flux against the currents."""
    return _TURNING & {each.name for each in taken}


def _rivals(savings: dict[str, float], best: str, *, one_speed: bool) -> tuple[str, ...]:
    """Return the effects that turn the flux and save much, perhaps more than their first linearization tells."""
    names = (name for name, saving in savings.items() if name in _TURNING - {DELAY} and saving > _RIVAL * savings[best])
    return tuple(name for name in names if not (one_speed and _AT_ONE_SPEED.get(name) in savings))


def _rivals_settled(sums: WindowSums, state: EffectSearch, names: Sequence[str]) -> dict[str, EffectSearch]:
    """Settle each of several effects beside those of a solution if one moves the current by more than the map bends."""
    specs = {name: _with_effect(state.solution.spec, name) for name in names}
    about = {
        name: replace(state.found.columns, estimate=state.solver.solve(spec).estimate) for name, spec in specs.items()
    }
    kept = sums.kept()
    if not any(about[name].bends(spec, kept) for name, spec in specs.items()):
        return {}
    return {name: _settled(sums, spec, about[name]) for name, spec in specs.items()}


def _best_predictor(settled: dict[str, EffectSearch], delayed: tuple[Solver, FullSolution] | None) -> str | None:
    """Return which effect, or the delay of a solution, predicts data left out best; None if none was settled."""
    fits = {name: (each.solver, each.solution) for name, each in settled.items()}
    if fits and delayed is not None:
        fits[DELAY] = delayed
    errors = {name: solver.left_out(solution.spec)[:, 0] for name, (solver, solution) in fits.items()}
    return min(errors, key=lambda name: float(errors[name][predictable(errors[name])].mean()), default=None)


def _settled(sums: WindowSums, spec: ModelSpec, columns: EffectColumns) -> EffectSearch:
    """Solve about the measured currents or, where effects move them far, about those in the map.

    The latter takes the kept windows only. If these are not all, it must fit clearly better.
    """
    move = columns.bends(spec, sums.kept())
    if move and not sums.thinned:
        return _iterated(sums, spec, columns, move=True)
    start = _iterated(sums, spec, columns)
    moved = _iterated(sums, spec, start.found.columns, move=True) if move else start
    return moved if _GROWN * moved.solution.residual_rms < start.solution.residual_rms else start


def _iterated(sums: WindowSums, spec: ModelSpec, columns: EffectColumns, *, move: bool = False) -> EffectSearch:
    """Solve, and linearize about the solution again, until the residuals settle or grow.

    They grow where an effect moves the current by so much that the linearization fails.
    """
    best: EffectSearch | None = None
    for _ in range(_SETTLING):
        extended = (sums.changed(columns.moved) if move else sums).with_effects(columns)
        solver = Solver.over(extended)
        found = EffectSearch(extended, solver, solver.solve(spec), FoundEffects(columns))
        change = -1.0 if best is None else found.solution.residual_rms / best.solution.residual_rms - 1.0
        if best is not None and change > _GROWN - 1.0:
            return best
        best = found
        if -change < _SETTLED or not (spec.effects or _remains(solver)):
            break
        columns = replace(columns, estimate=found.solution.estimate)
        if "link_ripple" in spec.effects:
            beside = columns.estimate.copy()
            beside[solver.model.effect("link_ripple")] = 0.0
            columns = replace(
                columns, ripple=ripple_frequency(solver.model, beside, extended.kept(), columns.ripple)[0]
            )
    return found


def _with_hidden_ripple(sums: WindowSums, state: EffectSearch, noise: CurrentNoise) -> EffectSearch:
    """Look again for a ripple of the DC link, whose frequency could not be found below a larger effect."""
    model, solution, columns = state.solver.model, state.solution, state.found.columns
    if np.isfinite(columns.link) or "link_ripple" in solution.spec.effects or not _misfits(model, solution, noise):
        return state
    ripple, share = ripple_frequency(model, solution.estimate, state.sums.kept())
    explains = share > _OF_MISFIT * _beyond(model, solution, noise)
    return _settled(sums, solution.spec, replace(columns, ripple=ripple)) if explains else state


def _beyond(model: FullModel, solution: FullSolution, noise: CurrentNoise) -> float:
    """Return the share of the squared residuals that noise does not explain."""
    return float(1.0 - noise.explained(model, solution) / max(solution.residual_rms**2, TINY))


def _misfits(model: FullModel, solution: FullSolution, noise: CurrentNoise) -> bool:
    """Tell whether to look for a ripple of the DC link, which takes as long as all other effects."""
    return solution.residual_rms**2 > LEAST_TOLD**2 * noise.explained(model, solution)


def several_speeds(speeds: FloatArray) -> bool:
    """Tell whether the 5 % of the data at either end have clearly different speeds."""
    low, high = np.quantile(speeds, [0.05, 0.95])
    return bool(high - low > SPEEDS_APART * max(abs(low), abs(high)))


def with_effects_only(sums: WindowSums, search: EffectSearch, effects: tuple[str, ...]) -> EffectSearch:
    """Return the search with some of its effects, solved again."""
    spec, columns = search.solution.spec, replace(search.found.columns, estimate=search.solution.estimate)
    settled = _settled(sums, replace(spec, effects=effects), columns)
    return replace(settled, found=replace(search.found, columns=settled.found.columns))


def plausible_effects(solution: FullSolution, model: FullModel, period: float) -> tuple[str, ...]:
    """Return the effects of a solution with physically possible values; ``period`` is the sample period, s."""
    values = {name: float(solution.estimate[model.effect(name).start]) for name in solution.spec.effects}
    return tuple(name for name, value in values.items() if _plausible(name, value, period))


def effect_savings(solver: Solver, solution: FullSolution, names: Sequence[str], period: float) -> dict[str, float]:
    """Return the share of the squared residuals that each effect saves; 0 where its value is not plausible."""
    if not names:
        return {}
    found = solver.savings(solution, {name: solver.model.effect(name) for name in names})
    return {
        name: saving if _plausible(name, float(value[0]), period) else 0.0 for name, (saving, value) in found.items()
    }


def _plausible(name: str, value: float, period: float) -> bool:
    """Tell whether the value of an effect is physically possible."""
    if name.endswith("_latency"):
        return abs(value) < _LONGEST_LATENCY * period
    if name.startswith("flux_lag_"):
        return 0 <= value < _LARGEST_LAG
    return _family(name) not in _POSITIVE or value >= 0


def _remains(solver: Solver) -> bool:
    """Tell whether the remainder matters without effects: what the current does between samples."""
    own = solver.model.effect("remainder").start
    return bool(solver.total[own, own] > _LEAST_VOLTAGE**2 * solver.total[VOLTAGE, VOLTAGE])


def _family(name: str) -> str:
    """Return the common physical cause of variants of an effect."""
    return _FAMILIES.get(name, name.split("_lag_", maxsplit=1)[0])


def _best(savings: dict[str, float], *, physical: bool) -> str | None:
    """Return the effect that reduces the squared residuals most.

    A physical delay (half or whole samples) is preferred to an effect that saves little more, because columns that
    resemble it also fit the controller's response to noise. Any other delay loses to an effect that is nearly as good.
    """
    if not savings:
        return None
    others = {name: saving for name, saving in savings.items() if name != DELAY}
    best = max(others, key=lambda name: others[name], default=DELAY)
    if DELAY in savings:
        margin = _CLOSE if physical else -_CLOSE * savings[DELAY]
        if best == DELAY or savings[DELAY] + margin > others[best]:
            return DELAY
    for name, preferred in _AT_ONE_SPEED.items():
        if best == name and savings.get(preferred, 0.0) > (1 - 1e-3) * savings[name]:
            best = preferred
    return best


def _worthwhile(solver: Solver, solution: FullSolution, name: str, saving: float) -> bool:
    """Tell whether an effect explains more than chance and what is uncertain of the current between samples do."""
    unknowns = 1 if name == DELAY else EFFECTS[name].stop - EFFECTS[name].start
    rows, own = max(solution.rows, 1.0), solver.model.effect("remainder").start
    uncertain = UNCERTAIN_SHARE**2 * solver.total[own, own] / rows
    least = LEAST_BESIDE if name in _BESIDE else _LEAST_SAVING
    return bool(
        saving > least + _PER_UNKNOWN * unknowns / rows
        and saving * solution.sum_of_squares / rows > _LEAST_VOLTAGE**2 * solver.total_voltage + uncertain
    )


def _by_data(solver: Solver, solution: FullSolution, name: str) -> bool:
    """Tell whether the data, not the roughness penalty, determine an effect; on a ring of currents the penalty may."""
    smoother = solver.solve(replace(solution.spec, penalty=PENALTIES[-1]))
    own = solver.model.effect(name)
    value, by_smoother = (solver.saving(each, own)[1] for each in (solution, smoother))
    squares, change = (float(x @ solver.total[own, own] @ x) for x in (value, by_smoother - value))
    return change < _MOST_BY_PENALTY**2 * squares


def _columns(sums: WindowSums, solution: FullSolution, noise: CurrentNoise, pole_pairs: int | None) -> EffectColumns:
    model, windows = sums.model, Windows.joined(list(sums.kept()))
    known, mean, ripple = np.isfinite(windows.link), np.nan, 0.0
    if known.any():
        voltage = windows.voltage[known]
        mean = float(np.vdot(voltage, windows.link[known]).real / np.vdot(voltage, voltage).real)
    elif _misfits(model, solution, noise):
        ripple = ripple_frequency(model, solution.estimate, [windows])[0]
    columns = EffectColumns(model, solution.estimate, float(windows.heat.max()), mean, pole_pairs, ripple)
    if pole_pairs is not None:
        return columns
    return replace(columns, pole_pairs=columns.likely_pole_pairs(windows.thinned(SEARCHED)))
