"""Search for the effects of a drive: each set follows from one elimination, and data left out confirm the best one.

A beam of sets is searched by the sum of squares that is left, with a price for each effect. About the best set the
columns are linearized again, and the search is repeated until it stays. Each member of the set must then save squared
error on data left out, segment by segment of time. What physics excludes is no set: see :meth:`_Search.allows`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from itertools import count

import numpy as np
from scipy import sparse

from drive_id.core.full.delay import Delay, estimate_delay
from drive_id.core.full.effects.catalogue import CATALOGUE, without
from drive_id.core.full.effects.columns import EffectColumns
from drive_id.core.full.effects.effect import parts
from drive_id.core.full.linearized import (
    DELAY,
    EffectSearch,
    Taken,
    first_columns,
    misfits,
    remains,
    settled,
    settled_about,
    with_hidden_ripple,
)
from drive_id.core.full.model import PENALTIES, FullModel, ModelSpec
from drive_id.core.full.reduced import Reduced, best_delay
from drive_id.core.full.solver import CurrentNoise, FullSolution, Solver, predictable
from drive_id.core.full.standard_errors import SIGNIFICANCE, STUDENT
from drive_id.core.full.window_sums import FOLDS, WindowSums
from drive_id.core.full.windows import MOST_DELAY, Windows
from drive_id.core.numerics.threads import in_threads
from drive_id.types import FloatArray

LEAST_BESIDE = 1e-3
"""Share of the squared residuals that an effect must save beside the one that it comes with."""
_PRICE = 0.01
"""Share of the squared residuals that an effect must save: a systematic misfit lets others save some 0.3 %."""
_LEAST_VOLTAGE = 5e-5
"""Rms that an effect must explain, relative to that of the integrated voltages: at 1e-4, a filter of a slow slotless
machine was missed, 0.6 % of the flux."""
_CERTAIN, _CERTAIN_BESIDE = 2.0, 1.0
"""Standard errors, over segments of time, by which an effect must save as much on data left out, and one that details
another: without it the flux is off (0.14 % at 3.1 of its errors), with it in vain, its errors are larger."""
_FEW, _PER_COLUMN = 4000, 4
"""Windows over which a set is searched first, and the least number for each column of the sums: neighbours overlap, and
all of them confirm the set."""
_MOST_GAIN = 10.0
"""Gain of a segment relative to the median, beyond which it counts no more: where the speed was reversed, one segment
gained 200 times as much as others, and iron loss that saves 94 % of the squares was not confirmed."""
_STRONG = 0.5
"""Share of the squared error on data left out from which on a member is confirmed by its relative gain in each segment:
of six segments of unlike size, a delay that saved 99.9 % was not. Of what saves 9 %, the same confirmed a false iron
loss."""
_WIDE, _DEEP = 5, 6
"""Sets that are extended at a time, and most members of a set."""
_LINEARIZATIONS, _CONFIRMATIONS = 4, 4
"""Most linearizations about the best set, and confirmations after which no other effects are tried: bounds of time."""
_SAME_DELAY = 1e-3
"""Samples by which delays may differ and be one."""
_CLOSE, _INDIFFERENT = 0.05, 0.5 * _PRICE
"""Relative difference of savings, or of what is left, below which two effects explain the residuals equally well: a
misfit of the map decides between the latter."""
_OF_NOISE = 0.1
"""Share of the squared residuals that is noise although it does not explain them. A rival leaves hardly more than that
beyond what may be a misfit: where a delay at two speeds left no more than noise, others that saved 97 to 99.98 % of the
same, and left 2 to 12 times as much, made the errors of a good map 20 to 50 times too large."""
_FAR = 0.03
"""Angle, rad, by which late currents or a late angle turn the flux far enough for a linearization of their own."""
_EVERY_SECOND = -0.25
"""Delay, samples, of a log with every second sample."""
_LATEST = 0.8
"""Of currents at one speed, samples: there, a delay of the voltages looks alike, and is more usual. Early currents look
like early voltages, which logs have that hold every n-th sample."""
_MOST_BY_PENALTY = 0.3
"""Largest relative change of an effect when the largest penalty is used."""
_RIVAL = 0.3
"""Share of a member's saving from which on a rival is linearized as well before it loses: iron loss that moves currents
across a saturating bridge saves half of it at first."""
_OF_MISFIT = 0.5
"""Share of the squared residuals beyond noise that a variation of the DC link must explain: the misfit of a map recurs
with the trajectory and the power, and a part of it looks like theirs."""
_OF_REST = 0.1
"""Share of what noise does not explain beside a set that a member must save to be certain: a map of saturated iron that
is too coarse had a filter of the currents confirmed that saved as much, and R was 4 % off at four standard errors."""
_LATE = {name for name, effect in CATALOGUE.items() if effect.late}
_ROTATING = {DELAY, *(name for name, effect in CATALOGUE.items() if effect.rotates)}
"""Of these, the data hold one at one speed: a delay less a lag of the flux is a rotation, which no map shows."""
_OF_LOG = {name for name, effect in CATALOGUE.items() if effect.of_log}
_TURNING = {DELAY, *(name for name, effect in CATALOGUE.items() if effect.turns)}
_BESIDE = {name: effect.beside for name, effect in CATALOGUE.items() if effect.beside}


@dataclass(frozen=True)
class _Set:
    """A set of effects with a delay."""

    names: frozenset[str]
    delay: float  # samples
    squares: float  # that are left, (Vs)^2
    score: float  # to be minimized
    members: frozenset[str]  # the names, and that of the delay, if it is not the usual one


@dataclass(frozen=True, eq=False)
class _Rules:
    """What is searched, in which data."""

    sums: WindowSums
    plain: ModelSpec  # without effects
    noise: CurrentNoise
    allowed: tuple[str, ...]
    turn: float  # electrical angle per sample, rad; 0: no delay is tried
    one_speed: bool
    parts: int  # of the data
    least: float  # squared residuals that matter to nobody, and what the current does between samples, (Vs)^2
    # by variant and the estimate about which it was linearized first: a search with fewer effects begins alike
    known: dict[tuple[ModelSpec, bytes], EffectSearch] = field(default_factory=dict)

    def among(self, sums: WindowSums) -> _Rules:
        """Return the rules of a search over some of the windows."""
        least = self.least * sums.counts.sum() / max(self.sums.counts.sum(), 1.0)
        return replace(self, sums=sums, least=least, known={})

    def without(self, name: str) -> _Rules:
        """Return the rules of a search without an effect, or a delay."""
        if name == DELAY:
            return replace(self, turn=0.0)
        return replace(self, allowed=tuple(other for other in self.allowed if other != name))

    def variant(self, found: _Set) -> ModelSpec:
        """Return the model with a set of effects."""
        return replace(self.plain, effects=tuple(sorted(found.names)), delay=found.delay)

    def solved(self, solver: Solver, found: _Set) -> FullSolution:
        """Return the fit with a set of effects."""
        return solver.solve(self.variant(found))

    def linearized(self, state: EffectSearch, found: _Set) -> EffectSearch:
        """Return a set, linearized about its fit in a state."""
        about = self.solved(state.solver, found)
        columns = replace(state.found.columns, estimate=about.estimate)
        return self._settled(state, about.spec, columns, about.residual_sigma)

    def carried(self, state: EffectSearch, found: _Set) -> EffectSearch:
        """Return the set of a state over other windows: about the solution itself, the residuals may grow."""
        return self._settled(state, self.variant(found), state.found.columns, state.solution.residual_sigma)

    def _settled(self, state: EffectSearch, spec: ModelSpec, columns: EffectColumns, left: float) -> EffectSearch:
        """Return a variant, linearized until it settles, with a ripple that this uncovers."""
        key = spec, columns.estimate.tobytes()
        known = self.known.pop(key, None) or with_hidden_ripple(
            self.sums, settled(self.sums, spec, columns, left), self.noise
        )
        while len(self.known) >= _LINEARIZATIONS:  # they are large
            del self.known[next(iter(self.known))]
        self.known[key] = known
        return replace(known, found=replace(known.found, delay=state.found.delay))

    def search_about(self, state: EffectSearch) -> _Search:
        """Return the sets about a linearization."""
        explained = max(state.solution.rows, 1.0) * self.noise.explained(state.solver.model, state.solution)
        return _Search(self, state.solver.reduced(self.plain), explained)


@dataclass
class _Search:
    """Sets of effects about one linearization."""

    rules: _Rules
    reduced: Reduced
    explained: float  # squared residuals that noise explains, (Vs)^2

    @property
    def usual(self) -> float:
        """Delay, samples, of a drive without one."""
        return self.rules.plain.delay

    def of(self, names: frozenset[str], delay: float) -> _Set:
        """Return a set with its score."""
        squares, terms = self.reduced.subset(names).squares(delay), 0
        if delay != self.usual:
            terms = 1 if (2 * delay).is_integer() else 2
        score = float(np.log(squares + self.rules.least)) + _PRICE * terms + _prices(names, self.rules.parts)
        return _Set(names, delay, squares, score, names | {DELAY} if terms else names)

    def alike(self, one: _Set, other: _Set) -> bool:
        """Tell whether one set leaves hardly more than another one, whatever their prices."""
        return one.squares - other.squares < _INDIFFERENT * (other.squares + self.rules.least)

    def best(self, names: frozenset[str]) -> _Set | None:
        """Return a set with the delay that suits it, if any is possible."""
        return next(iter(self._best_of([names], 1)), None)

    def _best_of(self, choices: Iterable[frozenset[str]], most: int) -> list[_Set]:
        """Return those possible sets that have the least scores, each with the delay that suits it."""
        sets = [self.of(names, delay) for names in choices for delay in self._delays(names)]
        out: dict[frozenset[str], _Set] = {}
        for each in sorted(sets, key=lambda each: (each.score, sorted(each.names))):
            if each.names not in out and self.allows(each.names, each.delay):
                out[each.names] = each
                if len(out) == most:
                    break
        return list(out.values())

    def _delays(self, names: frozenset[str]) -> Iterator[float]:
        yield self.usual
        if self.rules.turn > 0:
            value = float(np.clip(best_delay(self.reduced.subset(names).left)[0], -MOST_DELAY, MOST_DELAY))
            yield from {value, *Delay(value).between} - {self.usual}

    def allows(self, names: frozenset[str], delay: float) -> bool:
        """Tell whether a set is possible, and more than what the misfit of a map looks like."""
        of_link = [name for name in names if CATALOGUE[name].of_link]
        return self.possible(names, delay) and all(self._explains_misfit(names, name, delay) for name in of_link)

    def possible(self, names: frozenset[str], delay: float) -> bool:
        """Tell whether a set is physically possible, and can be told from others."""
        if any(name in names and other not in names for name, other in _BESIDE.items()):
            return False
        members = names | {DELAY} if delay != self.usual else names
        rotating = members & _ROTATING if self.rules.one_speed else frozenset()
        timed = rotating <= _OF_LOG | {DELAY} and delay > 0 and (2 * delay).is_integer()
        if len(members & _LATE) > 1 or (len(rotating) > 1 and not timed):
            return False
        if self.rules.one_speed and any(CATALOGUE[name].of_speeds for name in names):
            return False
        found, most = self.reduced.subset(names), _LATEST * self.rules.noise.period
        late = names & _LATE & _ROTATING
        if self.rules.one_speed and any(not 0 <= found.value(name, delay)[0] <= most for name in late):
            return False
        return all(_plausible(name, found.value(name, delay), self.rules.noise) for name in names)

    def _explains_misfit(self, names: frozenset[str], name: str, delay: float) -> bool:
        before, after = (self.reduced.subset(each).squares(delay) for each in (frozenset(without(names, name)), names))
        return before - after > _OF_MISFIT * (before - self.explained)

    def run(self) -> _Set:
        """Return the set of the least score."""
        start = self.of(frozenset(), self.usual)
        found, beam = [self.best(start.names) or start], [start]
        for least in self._least_scores():
            if min(each.score for each in found) <= least:
                break
            names = {each.names | {name} for each in beam for name in self.rules.allowed if name not in each.names}
            beam = self._best_of(names, _WIDE)
            found += beam[:1]
        return min(found, key=lambda each: each.score)

    def _least_scores(self) -> FloatArray:
        """Return the scores (D,) that no set of 1 to D members falls below.

        It leaves no less than all effects together with any delay, and pays for its members.
        """
        every, prices = self.reduced.subset(frozenset(self.rules.allowed)), sorted(map(_price, self.rules.allowed))
        squares = max(min(best_delay(every.left)[1], every.squares(self.usual)), 0.0)
        return np.asarray(np.log(squares + self.rules.least) + np.cumsum(prices)[:_DEEP])

    def without(self, found: _Set, member: str) -> _Set:
        """Return a set less one of its members, and what comes beside that only."""
        if member == DELAY:
            return self.of(found.names, self.usual)
        return self.of(frozenset(without(found.names, member)), found.delay)

    def exchanged(self, found: _Set, member: str) -> Iterator[tuple[str, _Set, float]]:
        """Yield the possible sets with another effect instead of a member, its name, and its saving over the member's.

        Those of the same family are not others; a variation of the DC link is one however little it explains.
        """
        rest = self.without(found, member)
        saved = rest.squares - found.squares
        for name in (*self.rules.allowed, DELAY):
            if name in found.members or _family(name) == _family(member):
                continue
            if name == DELAY:
                sets = [self.of(rest.names, delay) for delay in self._delays(rest.names) if delay != self.usual]
            else:
                sets = [self.of(rest.names | {name}, rest.delay)]
            for other in sets:
                if saved > 0 and self.possible(other.names, other.delay):
                    yield name, other, (rest.squares - other.squares) / saved


def search_effects(
    sums: WindowSums,
    solution: FullSolution,
    noise: CurrentNoise,
    allowed: Sequence[str],
    turn: float,
    pole_pairs: int | None = None,
) -> EffectSearch:
    """Find the set of effects, and the delay, that explains the residuals.

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
    plain, model = solution.spec, sums.model
    few = sums.sampled(max(_FEW, _PER_COLUMN * model.summed.size))
    columns = first_columns(sums, solution, noise, pole_pairs)
    plain_fit = settled_about(few, columns, solution)
    own, rows = model.effect("remainder").start, max(plain_fit.solution.rows, 1.0)
    solver, one_speed = plain_fit.solver, columns.steady is not None
    least = _LEAST_VOLTAGE**2 / _PRICE * rows * solver.total_voltage + float(solver.total[own, own])
    rules = _Rules(few, plain, noise, tuple(allowed), turn, one_speed, parts(sums.kept()), least)
    unconfirmed: list[str] = []
    start = _about_decimation(plain_fit, rules)
    if start is not plain_fit:  # the voltages of such a log turn as if by another angle, and its misfit takes anything
        rules = replace(rules, allowed=tuple(name for name in rules.allowed if name not in _OF_LOG))
    start, every = _about_lateness(start, rules), rules.among(sums)
    whole_fit = cache(lambda: plain_fit if few is sums else settled_about(sums, columns, solution))
    for number in count(1):
        state, chosen, search = _about_its_best(start, lambda: plain_fit, rules)
        if few is not sums:
            of_all = replace(every, allowed=rules.allowed, turn=rules.turn)
            state, chosen, search = _over_all(state, chosen, whole_fit, of_all)
        state, chosen = _among_rivals(state, search, chosen, rules)
        weak = _unconfirmed(state, search, chosen)
        if weak is None:
            break
        unconfirmed.append(weak)
        rules = rules.without(weak)
        if number >= _CONFIRMATIONS:  # no new ones from now on, so that it ends soon
            rules = replace(rules, allowed=tuple(sorted(chosen.names - {weak})))
    delay = state.found.delay
    if chosen.delay != plain.delay:
        if np.isnan(delay.sigma):  # of a set that was linearized as a rival
            delay = estimate_delay(state.solver, rules.solved(state.solver, replace(chosen, delay=0.0)), noise)
        value = state.solution.spec.delay  # that of the fit, of which the set's differs by little
        delay = replace(delay, value=value, off=delay.value - value)
    elif turn > 0:
        delay = estimate_delay(state.solver, state.solution, noise)
    search = replace(search, rules=every)  # what was not confirmed is a rival all the same
    taken = tuple(_taken(search, chosen))
    extended = sums if not chosen.names and not remains(state.solver) else state.sums
    undecided = _undecided(search, chosen, max(state.solution.rows, 1.0), unconfirmed)
    return replace(state, sums=extended, found=replace(state.found, taken=taken, delay=delay, undecided=undecided))


def _about_decimation(first: EffectSearch, rules: _Rules) -> EffectSearch:
    """Linearize about a log with every second sample, if that leaves less: its current decays less between samples.

    About the fit without a delay, what that takes for decay hides the delay.
    """
    if not (rules.turn and remains(first.solver) and misfits(first.solver.model, first.solution, rules.noise)):
        return first
    about = first.solver.solve(replace(rules.plain, delay=_EVERY_SECOND))
    other = settled_about(rules.sums, first.found.columns, about)
    left, by_other = (state.solver.delay(state.solver.solve(rules.plain))[2] for state in (first, other))
    return other if by_other < (1 - _CLOSE) * left else first


def _about_lateness(first: EffectSearch, rules: _Rules) -> EffectSearch:
    """Linearize about currents or an angle that are late, if these alone turn the flux far from the first fit.

    About that fit, other effects would stand for what a large angle changes in second order.
    """
    if rules.one_speed:
        return first
    search, states, least = rules.search_about(first), [first], _FAR * rules.noise.period / rules.noise.turn
    for name in sorted(_LATE.intersection(rules.allowed)):
        best = search.best(frozenset({name}))
        if best and abs(float(search.reduced.subset(best.names).value(name, best.delay)[0])) > least:
            states.append(settled_about(rules.sums, first.found.columns, rules.solved(first.solver, best)))
    return min(states, key=lambda state: state.solution.residual_rms)


def _about_its_best(
    state: EffectSearch, first: Callable[[], EffectSearch], rules: _Rules, chosen: _Set | None = None
) -> tuple[EffectSearch, _Set, _Search]:
    """Linearize about the best set, and search again, until it stays.

    Parameters
    ----------
    state : EffectSearch
        Linearized about ``chosen``, or about another fit.
    first : callable
        Returns the fit without effects.
    """
    plain = rules.plain
    chosen = chosen or _Set(frozenset(), plain.delay, np.inf, np.inf, frozenset())
    for _ in range(_LINEARIZATIONS):
        search = rules.search_about(state)
        best = search.run()
        if best.delay != plain.delay:
            delay = estimate_delay(state.solver, rules.solved(state.solver, replace(best, delay=0.0)), rules.noise)
            if not delay.significant(rules.turn):
                rules = rules.without(DELAY)
                search = rules.search_about(state)
                best = search.run()
            else:
                physical = (2 * best.delay).is_integer() and abs(best.delay - delay.value) < delay.tolerance
                best = best if physical else replace(best, delay=delay.value)
                state = replace(state, found=replace(state.found, delay=delay))
        same = best.members == chosen.members and abs(best.delay - chosen.delay) < _SAME_DELAY
        chosen = best
        if same:
            break
        if not best.members:
            state = first()
            continue
        state = rules.linearized(state, best)
    if not chosen.members:
        state = first()
    return state, chosen, search


def _taken(search: _Search, chosen: _Set) -> Iterator[Taken]:
    """Yield the members of a set, that which saves most first, with those that would explain nearly as much, likewise.

    They leave no more beyond the set than its misfit may be. A delay is one of these if it turns the voltages by an
    angle that matters. What comes beside another effect has none: that one tells it.
    """
    saved = {member: search.without(chosen, member).squares - chosen.squares for member in chosen.members}
    misfit = max(chosen.squares - search.explained, 0.0)
    for member in sorted(saved, key=lambda name: -saved[name]):
        rivals = {
            name: share
            for name, other, share in search.exchanged(chosen, member)
            if (share > 1 - _CLOSE or search.alike(other, chosen))
            and other.squares - chosen.squares < misfit + _OF_NOISE * (chosen.squares + search.rules.least)
            and member not in _BESIDE
            and (name != DELAY or Delay(other.delay, 0.0).significant(search.rules.turn))
        }
        yield Taken(member, tuple(sorted(rivals, key=lambda name: (-rivals[name], name))))


def _undecided(search: _Search, chosen: _Set, rows: float, unconfirmed: Sequence[str]) -> tuple[str, ...]:
    """Return the effects of which it is open whether the drive has them: a misfit of the map may save as much.

    Of those beside a set, they are all that data left out did not confirm, and the other one that would save most, if
    it is more than noise lets them; of the set, those that save little beside what is left.
    """
    of_noise, saved = chosen.squares / rows, dict[str, float]()
    for name in search.rules.allowed:
        if name not in chosen.names and search.possible(names := chosen.names | {name}, chosen.delay):
            by_chance = CATALOGUE[name].width + SIGNIFICANCE * np.sqrt(2 * CATALOGUE[name].width)  # chi-squared
            saved[name] = (chosen.squares - search.of(names, chosen.delay).squares) / (by_chance * of_noise)
    open_ = [name for name in saved if saved[name] > 1.0]
    first = [name for name in unconfirmed if name in open_]
    others = sorted(set(open_).difference(first), key=lambda name: -saved[name])[:1]
    least = chosen.squares + _OF_REST * (chosen.squares - search.explained)
    weak = sorted(name for name in chosen.names if search.without(chosen, name).squares < least)
    return (*first, *others, *weak)


def _over_all(
    state: EffectSearch, chosen: _Set, first: Callable[[], EffectSearch], rules: _Rules
) -> tuple[EffectSearch, _Set, _Search]:
    """Repeat a search over few windows over those of the rules, from where it ended."""
    state = rules.carried(state, chosen) if chosen.members else first()
    return _about_its_best(state, first, rules, chosen)


def _among_rivals(state: EffectSearch, search: _Search, chosen: _Set, of_few: _Rules) -> tuple[EffectSearch, _Set]:
    """Linearize about sets with another effect that turns the flux, too, and return what predicts data left out best.

    Only where such an effect moves currents by more than the map bends over, so that the columns about another set tell
    little of it.
    """
    if not state.solver.model.resolution.halved:
        return state, chosen
    others = [
        other
        for member in sorted(chosen.members & _TURNING)
        for name, other, share in search.exchanged(chosen, member)
        if name in _TURNING and share > _RIVAL
    ]
    rules, kept = search.rules, search.rules.sums.kept()
    fits = {each: rules.solved(state.solver, each) for each in (*others, chosen)}
    columns = state.found.columns
    if not any(replace(columns, estimate=fits[each].estimate).bends(fits[each].spec, kept) for each in others):
        return state, chosen
    states = {each: settled_about(of_few.sums, columns, fit) for each, fit in fits.items()}
    errors = {each: one.solver.left_out(one.solution.spec)[:, 0] for each, one in states.items()}
    best = min(errors, key=lambda each: float(errors[each][predictable(errors[each])].mean()))
    return (state if best is chosen else rules.carried(states[best], best)), best


def _unconfirmed(state: EffectSearch, search: _Search, chosen: _Set) -> str | None:
    """Return the member of a set that data left out, or data alone, confirm least; None if all are confirmed."""
    if not chosen.members:
        return None
    plain = search.rules.plain
    if chosen.names:
        smooth = state.solver.reduced(replace(plain, penalty=PENALTIES[-1])).subset(chosen.names)
    for name in sorted(chosen.names):
        own, rough = state.solver.model.effect(name), search.reduced.subset(chosen.names).value(name, chosen.delay)
        change = smooth.value(name, chosen.delay) - rough
        squares, moved = (float(x @ state.solver.total[own, own] @ x) for x in (rough, change))
        if moved > _MOST_BY_PENALTY**2 * squares:
            return name
    members = sorted(chosen.members)
    sets = [chosen, *(search.without(chosen, member) for member in members)]
    errors = held_out(state.sums, state.solver, plain, [(each.names, each.delay) for each in sets])
    errors = errors[predictable(errors[:, 0])]
    gains = errors[:, 1:] - errors[:, :1]
    share = gains.sum(axis=0) / errors[:, 1:].sum(axis=0)
    most = _MOST_GAIN * np.median(np.abs(gains), axis=0)  # a segment that gains far more makes the mean no less certain
    alike = gains / np.maximum(errors[:, 1:] + errors[:, :1], 1e-300)
    gains = np.where(share > _STRONG, alike, np.clip(gains, -most, most))
    certain = gains.mean(axis=0) / np.maximum(gains.std(axis=0) / np.sqrt(len(gains)), 1e-300)
    least = [_CERTAIN_BESIDE if member in _BESIDE else _CERTAIN for member in members]
    unsure = certain < np.array(least) * (1.0 + STUDENT / max(len(gains) - 1, 1))
    weak = np.flatnonzero((share < [_price(member) for member in members]) | unsure)
    return members[min(weak, key=lambda k: share[k])] if len(weak) else None


def held_out(
    sums: WindowSums, solver: Solver, plain: ModelSpec, sets: Sequence[tuple[frozenset[str], float]]
) -> FloatArray:
    """Return the squared residuals (S, P) of kept segments, predicted without their fold, of P sets, (Vs)^2.

    Parameters
    ----------
    solver : Solver
        Of these sums.
    plain : ModelSpec
        Without effects and delay.
    """
    model, folds = solver.model, sums.kept_folds()

    def of_fold(fold: int) -> list[FloatArray]:
        own = [windows for windows, number in zip(sums.kept(), folds, strict=True) if number == fold]
        if not own:
            return []
        reduced = solver.reduced(plain, without=fold)
        estimates = np.stack([reduced.estimate(reduced.subset(names), delay) for names, delay in sets], axis=1)
        orders = [order for order, columns in model.harmonics.items() if estimates[columns].any()]
        left = model.design_times(Windows.joined(own), sparse.csr_array(estimates), orders)
        edges = np.cumsum([0, *map(len, own[:-1])])
        return list(np.add.reduceat(np.square(left).sum(axis=1), edges, axis=0))

    return np.array([row for rows in in_threads(of_fold, range(FOLDS)) for row in rows])


@lru_cache(maxsize=1 << 14)
def _prices(names: frozenset[str], divided: int) -> float:
    """Return the prices of effects, in so many parts of the data."""
    of_parts = max(divided - 2, 0) * sum(CATALOGUE[name].price_of_part for name in sorted(names))
    return float(sum(map(_price, sorted(names))) + of_parts)


def _price(name: str) -> float:
    """Return the share of squared residuals, or squared errors on data left out, that an effect must save."""
    if name in _BESIDE:
        return LEAST_BESIDE
    return _PRICE + (CATALOGUE[name].price if name in CATALOGUE else 0.0)


def turning(taken: Sequence[Taken]) -> set[str]:
    """Return the names of those effects that turn the flux against the currents."""
    return _TURNING & {each.name for each in taken}


def with_effects_only(sums: WindowSums, search: EffectSearch, effects: tuple[str, ...]) -> EffectSearch:
    """Return the search with some of its effects, solved again."""
    spec, columns = search.solution.spec, replace(search.found.columns, estimate=search.solution.estimate)
    found = settled(sums, replace(spec, effects=effects), columns)
    return replace(found, found=replace(search.found, columns=found.found.columns))


def plausible_effects(solution: FullSolution, model: FullModel, noise: CurrentNoise) -> tuple[str, ...]:
    """Return the effects of a solution with physically possible values."""
    values = {name: solution.estimate[model.effect(name)] for name in solution.spec.effects}
    return tuple(name for name, value in values.items() if _plausible(name, value, noise))


def effect_savings(
    solver: Solver, solution: FullSolution, names: Sequence[str], noise: CurrentNoise
) -> dict[str, float]:
    """Return the share of the squared residuals that each effect saves; 0 where its value is not plausible."""
    if not names:
        return {}
    found = solver.savings(solution, {name: solver.model.effect(name) for name in names})
    return {name: saving if _plausible(name, value, noise) else 0.0 for name, (saving, value) in found.items()}


def _plausible(name: str, value: FloatArray, noise: CurrentNoise) -> bool:
    """Tell whether the values (K,) of an effect are physically possible."""
    return CATALOGUE[name].plausible(value, noise.turn, noise.period)


def _family(name: str) -> str:
    """Return the common physical cause of variants of an effect."""
    return CATALOGUE[name].family if name in CATALOGUE else name
