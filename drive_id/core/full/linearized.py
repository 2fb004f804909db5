"""Effects in a fit: what was found, and the columns of effects linearized about the fit until both agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drive_id.core.full.delay import Delay, several_speeds
from drive_id.core.full.effects.catalogue import CATALOGUE
from drive_id.core.full.effects.columns import EffectColumns
from drive_id.core.full.effects.effect import divided
from drive_id.core.full.link_ripple import ripple_frequency
from drive_id.core.full.model import VOLTAGE, FullModel, ModelSpec
from drive_id.core.full.solver import LEAST_TOLD, CurrentNoise, FullSolution, Solver
from drive_id.core.full.winding_heat import WindingHeat
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import SEARCHED, Windows
from drive_id.types import TINY

DELAY = "voltage_delay"
_LEAST_VOLTAGE = 5e-5
"""Rms of a remainder that matters, relative to that of the integrated voltages."""
_TRIED = 0.1
"""Share of the squared residuals beyond noise that a ripple beside other effects must explain to be tried: they may
stand for a part of it."""
_GROWN = 1.03
"""Growth of the residuals at which a linearization is worse than that before; by chance they may grow less."""
_ATTUNED = {name for name, effect in CATALOGUE.items() if effect.attuned}
_SETTLING, _SETTLED = 5, 0.01
"""Most linearizations, and the relative decrease of the residuals below which they end."""


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
    undecided: tuple[str, ...] = ()  # effects, taken or not, of which it is open whether the drive has them


@dataclass(frozen=True, eq=False)
class EffectSearch:
    """The solution with the selected effects."""

    sums: WindowSums  # with the columns of all effects if any effect was selected; otherwise without, to save memory
    solver: Solver  # of sums with the columns of all effects
    solution: FullSolution
    found: FoundEffects

    def linearized(self, sums: WindowSums) -> WindowSums:
        """Return other sums with the columns of the effects, and with currents in the map, as here."""
        return with_columns(sums, self.found.columns, move=self.sums.kept()[0].moved is not None)


def first_columns(
    sums: WindowSums, solution: FullSolution, noise: CurrentNoise, pole_pairs: int | None
) -> EffectColumns:
    """Return the columns about a fit without effects; default of the pole pairs: those that explain most."""
    model, windows = sums.model, Windows.joined(list(sums.kept()))
    mean, ripple = sums.mean_link, 0.0
    if np.isnan(mean) and misfits(model, solution, noise):
        ripple = ripple_frequency(model, solution.estimate, [windows])[0]
    recordings = [windows.time[windows.recording == number] for number in range(windows.recording.max() + 1)]
    spans = np.array([[time.min(initial=np.inf), time.max(initial=-np.inf)] for time in recordings])
    columns = EffectColumns(model, solution.estimate, float(windows.heat.max()), mean, spans, pole_pairs, ripple)
    speeds = windows.speed.mean(axis=1)
    steady = None if several_speeds(speeds) else float(speeds.mean())
    columns = replace(columns, divided=divided([windows]), steady=steady)
    if pole_pairs is not None:
        return columns
    return replace(columns, pole_pairs=columns.likely_pole_pairs(windows.thinned(SEARCHED)))


def settled(sums: WindowSums, spec: ModelSpec, columns: EffectColumns, left: float = np.inf) -> EffectSearch:
    """Solve about the measured currents or, where effects move them far, about those in the map.

    The latter takes the kept windows only. If these are not all, it must fit clearly better. ``left``: the residuals'
    sigma of the variant about another linearization, which gave the estimate of the columns.
    """
    move = columns.bends(spec, sums.kept())
    if move and not sums.thinned:
        return _iterated(sums, spec, columns, left, move=True)
    start = _iterated(sums, spec, columns, left)
    moved = _iterated(sums, spec, start.found.columns, move=True) if move else start
    return moved if _GROWN * moved.solution.residual_rms < start.solution.residual_rms else start


def settled_about(sums: WindowSums, columns: EffectColumns, about: FullSolution) -> EffectSearch:
    """Solve the variant of a fit about that fit, see :func:`settled`."""
    return settled(sums, about.spec, replace(columns, estimate=about.estimate), about.residual_sigma)


def _iterated(
    sums: WindowSums, spec: ModelSpec, columns: EffectColumns, left: float = np.inf, *, move: bool = False
) -> EffectSearch:
    """Solve, and linearize about the solution again, until the residuals settle or grow.

    They grow where an effect moves the current by so much that the linearization fails.
    """
    best: EffectSearch | None = None
    columns = replace(columns, delay=spec.delay)
    if not _ATTUNED.isdisjoint(spec.effects):
        left = np.inf  # their columns depend on more than the estimate
    for _ in range(_SETTLING):
        extended = with_columns(sums, columns, move=move)
        solver = Solver.over(extended)
        found = EffectSearch(extended, solver, solver.solve(spec), FoundEffects(columns))
        change, left = found.solution.residual_sigma / left - 1.0, found.solution.residual_sigma
        if best is not None and change > _GROWN - 1.0:
            return best
        best = found
        if -_SETTLED < change < _GROWN - 1.0 or not (spec.effects or remains(solver)):
            break
        columns = replace(columns, estimate=found.solution.estimate)
        columns = _attuned(columns, solver.model, spec, extended.kept())
    return found


def with_columns(sums: WindowSums, columns: EffectColumns, *, move: bool) -> WindowSums:
    """Return sums with the columns of effects; ``move``: over the currents in the map, see ``EffectColumns.moved``."""
    return (sums.changed(columns.moved) if move else sums).with_effects(columns)


def _attuned(columns: EffectColumns, model: FullModel, spec: ModelSpec, kept: Sequence[Windows]) -> EffectColumns:
    """Return the columns with the frequency of a ripple, or the time constant of heating, that explains most."""
    if "link_ripple" in spec.effects:
        beside = columns.estimate.copy()
        beside[model.effect("link_ripple")] = 0.0
        columns = replace(columns, ripple=ripple_frequency(model, beside, kept, columns.ripple)[0])
    if "copper_heating" in spec.effects:
        winding = columns.winding or WindingHeat.of(Windows.joined(list(kept)))
        columns = replace(columns, winding=winding.fitted(model, columns.estimate, kept, columns.divided))
    return columns


def with_hidden_ripple(sums: WindowSums, state: EffectSearch, noise: CurrentNoise) -> EffectSearch:
    """Look again for a ripple of the DC link, whose frequency could not be found below a larger effect."""
    model, solution, columns = state.solver.model, state.solution, state.found.columns
    if np.isfinite(columns.link) or "link_ripple" in solution.spec.effects or not misfits(model, solution, noise):
        return state
    ripple, share = ripple_frequency(model, solution.estimate, state.sums.kept())
    explains = share > _TRIED * beyond_noise(model, solution, noise)
    return settled(sums, solution.spec, replace(columns, ripple=ripple)) if explains else state


def beyond_noise(model: FullModel, solution: FullSolution, noise: CurrentNoise) -> float:
    """Return the share of the squared residuals that noise does not explain."""
    return float(1.0 - noise.explained(model, solution) / max(solution.residual_rms**2, TINY))


def misfits(model: FullModel, solution: FullSolution, noise: CurrentNoise) -> bool:
    """Tell whether to look for what takes as long as all effects: a ripple of the DC link, a decimated log."""
    return solution.residual_rms**2 > LEAST_TOLD**2 * noise.explained(model, solution)


def remains(solver: Solver) -> bool:
    """Tell whether the remainder matters without effects: what the current does between samples."""
    own = solver.model.effect("remainder").start
    return bool(solver.total[own, own] > _LEAST_VOLTAGE**2 * solver.total[VOLTAGE, VOLTAGE])
