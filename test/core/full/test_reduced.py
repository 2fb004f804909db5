"""One elimination for every set of effects, against a fit of each set by itself."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from synthetic import record

from drive_id.core.full.effect_search import held_out
from drive_id.core.full.effects.columns import EffectColumns
from drive_id.core.full.model import FullModel, ModelSpec, roughness
from drive_id.core.full.solver import Solver
from drive_id.core.full.winding_heat import WindingHeat
from drive_id.core.full.window_sums import FOLDS, WindowSums

LOW, HIGH = np.array([-310.0, -310.0]), np.array([310.0, 310.0])
SETS = [
    ((), 0.0),
    (("iron_loss",), 0.0),
    (("copper_heating", "current_gains"), 0.5),
    (("angle_latency", "iron_loss", "resolver_second"), -1.37),
]


@pytest.fixture(scope="module")
def fitted():
    """Sums with the columns of all effects, and a variant without any."""
    sums = WindowSums(FullModel(LOW, HIGH, 300.0, (6,), reciprocal=True))
    sums.next_recording()
    sums.add(record(duration=2.6, noise=0.3))
    sums = sums.finished()
    plain = ModelSpec(True, (6,), penalty=1e-4)
    estimate = Solver.over(sums).solve(plain).estimate
    heat = float(max(windows.heat.max() for windows in sums.kept()))
    sums = sums.with_effects(EffectColumns(sums.model, estimate, heat, np.nan, np.array([[0.0, 4.0]]), 4))
    return sums, Solver.over(sums), plain


@pytest.mark.parametrize(("names", "delay"), SETS)
def test_a_set_is_the_fit_with_its_effects(fitted, names, delay):
    sums, solver, plain = fitted
    reduced = solver.reduced(plain)
    found, fit = reduced.subset(frozenset(names)), solver.solve(replace(plain, effects=names, delay=delay))
    for name in names:
        wanted = fit.estimate[solver.model.effect(name)]
        assert found.value(name, delay) == pytest.approx(wanted, rel=1e-4, abs=1e-7 * np.abs(wanted).max())
    estimate = reduced.estimate(found, delay)
    np.testing.assert_allclose(estimate, fit.estimate, rtol=0, atol=1e-4 * np.abs(fit.estimate).max())
    penalty = roughness(solver.model, solver.total, plain.penalty, sums.unit)
    penalized = fit.summed @ (solver.total @ fit.summed) + fit.estimate @ (penalty @ fit.estimate)
    assert found.squares(delay) == pytest.approx(penalized, rel=1e-4)


def test_a_column_that_is_left_out_changes_the_estimate_by_what_the_fit_with_it_takes(fitted):
    _, solver, plain = fitted
    without, found = solver.solve(plain), solver.solve(replace(plain, effects=("iron_loss",)))
    column = solver.model.effect("iron_loss").start
    change, left = solver.by_column(without, column)
    value, expected = found.estimate[column], without.estimate - found.estimate
    expected[column] = 0.0
    np.testing.assert_allclose(value * change, expected, rtol=0, atol=1e-3 * np.abs(expected).max())
    squares = [solver.reduced(plain).subset(frozenset(names)).squares(0.0) for names in ((), ("iron_loss",))]
    assert value**2 * left == pytest.approx(squares[0] - squares[1], rel=1e-3)


def test_segments_left_out_add_up_to_folds_left_out(fitted):
    sums, solver, plain = fitted
    errors = held_out(sums, solver, plain, [(frozenset(names), delay) for names, delay in SETS])
    number = [fold for fold in range(FOLDS) for other in sums.kept_folds() if other == fold]
    for k, (names, delay) in enumerate(SETS):
        by_fold = solver.left_out(replace(plain, effects=names, delay=delay))[:, 0] * sums.counts
        added = np.bincount(number, weights=errors[:, k], minlength=FOLDS)
        np.testing.assert_allclose(added, by_fold, rtol=1e-3)


@pytest.mark.parametrize(("constant", "growth"), [(np.inf, 0.0), (np.inf, 0.3), (2.0, 0.0), (5.0, 0.45)])
def test_the_course_of_a_winding_is_that_of_its_differential_equation(constant, growth):
    """Its windows come in two recordings with a pause of 3 s each; half of those of the second are new."""

    def power(t):
        return 900.0 * (1 + 0.8 * np.sin(2 * np.pi * 1.1 * t)) * (0.5 + 0.5 * (t < 4.0))

    def paused(clock):
        return power(np.where(clock < 4.0, clock, clock - 3.0)) * ((clock < 4.0) | (clock > 7.0))

    time = np.arange(0.0, 10.0, 0.004)
    gaps = 3.0 * (time >= 4.0)
    heat = np.concatenate([[0.0], np.cumsum(power(time[:-1] + 0.002) * 0.004)])

    def course(by_rise):
        def slope(t, y):
            return paused(t) * (1 + by_rise * y) - y / constant

        return solve_ivp(slope, (0.0, 13.0), [0.0], t_eval=time + gaps + 0.002, max_step=0.1, rtol=1e-7).y[0]

    truth = course(0.0)
    for _ in range(6):  # the growth holds for the largest rise, which it changes
        truth = course(growth / truth.max())
    twice = np.tile(time, 2) + np.repeat([0.0, 100.0], len(time))
    recording = np.repeat([0, 1], len(time))
    known = (np.arange(2 * len(time)) % 7 == 0) & (twice < 105.0)
    both = np.tile(gaps, 2)
    found = WindingHeat(recording[known], twice[known], both[known], np.tile(heat, 2)[known], constant, growth=growth)

    class Windows(SimpleNamespace):
        def __len__(self):
            return len(self.time)

    windows = Windows(
        recording=recording, time=twice, gaps=both, heat=np.tile(heat, 2), duration=np.full(len(twice), 0.004)
    )
    rise = found(windows)
    np.testing.assert_allclose(rise, np.tile(truth, 2) / truth.max(), atol=0.01)
