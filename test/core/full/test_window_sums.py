"""The accumulated windows: rows against an independent oracle, streaming, merging, storing, thinning."""

from __future__ import annotations

import dataclasses
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from full_design import basis, design
from scipy.interpolate import BSpline
from synthetic import record

from drive_id.core.full import window_sums
from drive_id.core.full.model import CONSTANT, EFFECT_COLUMNS, MAGNET, SHIFT, VOLTAGE, FullModel, ModelSpec
from drive_id.core.full.solver import Solver
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import WindowCutter, Windows, kept_of
from drive_id.core.numerics.normal_equations import triangle_of
from drive_id.core.numerics.threads import interruptible

LOW, HIGH = np.array([-310.0, -310.0]), np.array([310.0, 310.0])


@pytest.fixture(scope="module")
def free():
    return FullModel(LOW, HIGH, 300.0, (2, 6))


@pytest.fixture(scope="module", params=["free", "reciprocal"])
def model(free, request):
    return dataclasses.replace(free, reciprocal=request.param == "reciprocal")


@pytest.fixture(scope="module")
def samples():
    return record(duration=1.5, noise=0.3)


def gathered(model, *recordings):
    information = WindowSums(model)
    for samples in recordings:
        information.next_recording()
        information.add(samples)
    return information.finished()


def flux_by_scipy(space, gamma, i_dq):
    """Evaluate a map of the space by scipy's splines."""
    high, low = space.degree, space.degree - 1

    def matrix(x, edges, degree):
        knots = np.concatenate([np.full(degree, edges[0]), edges, np.full(degree, edges[-1])])
        return BSpline.design_matrix(x, knots, degree).toarray()

    out = []
    for (degree_d, degree_q), coefficients in zip(((low, high), (high, low)), np.split(gamma, 2), strict=True):
        d, q = matrix(i_dq[:, 0], space.d, degree_d), matrix(i_dq[:, 1], space.q, degree_q)
        out.append(np.einsum("na,ab,nb->n", d, coefficients.reshape(d.shape[1], q.shape[1]), q))
    return out[0] + 1j * out[1]


def some_windows(model, samples):
    cutter = WindowCutter(model.shapes)
    return Windows.joined([*cutter.cut(samples), *cutter.finish()]).part(np.arange(0, 1500, 47))


@pytest.mark.parametrize("reciprocal", [True, False])
def test_design_times_is_the_design_times_a_matrix(free, samples, reciprocal):
    model, windows = free, some_windows(free, samples)
    windows = dataclasses.replace(windows, heating=np.linspace(-1.0, 40.0, len(windows)))
    for orders in ((), (2,), (2, 6)):
        t = basis(model, ModelSpec(reciprocal, orders, per_phase=True, magnet=True, lag=True))
        expected = design(model, windows) @ t.toarray()
        scale = np.abs(expected).max(axis=(0, 1)) + 1e-300
        assert np.abs((model.design_times(windows, t, orders) - expected) / scale).max() < 1e-12


def test_rows_say_what_the_balance_says(model, samples):
    """Any parameters, put into the voltage balance one window at a time, give the rows times the parameters."""
    windows = some_windows(model, samples)
    rng = np.random.default_rng(5)
    x = rng.standard_normal(model.size)
    resistance, constant, drops = x[1], x[2] + 1j * x[3], x[model.drops].reshape(-1, 3)
    expected = x[0] * windows.voltage + resistance * windows.current + constant * windows.duration
    ahead = windows.held * np.exp(1j * windows.speed * windows.period[:, None]) * windows.period[:, None]
    expected = expected + windows.shifted @ x[SHIFT][:-1] + (ahead[:, 1] - ahead[:, 0]) * x[SHIFT][-1]
    per_phase = np.einsum("nsp,sp->np", windows.shape, drops)
    expected = expected + 2 / 3 * per_phase @ np.exp(2j * np.pi / 3 * np.arange(3)) + windows.lag @ x[model.lags]
    expected = expected + windows.crossing * x[model.crossing]
    for end, sign in ((0, -1), (1, 1)):
        i_dq, theta = windows.i_dq[:, end], windows.angle[:, end]
        psi = flux_by_scipy(model.flux, x[model.map], i_dq)
        for order, columns in model.harmonics.items():
            a, b = (flux_by_scipy(model.harmonic, half, i_dq) for half in np.split(x[columns], 2))
            psi = psi + a * np.cos(order * theta) + b * np.sin(order * theta)
        expected = expected + sign * np.exp(1j * theta) * psi
    found = design(model, windows) @ x
    np.testing.assert_allclose(found[:, 0] + 1j * found[:, 1], expected, rtol=1e-9, atol=1e-9)


def test_folds_hold_the_cross_products(model, samples):
    information = gathered(model, samples)
    cutter = WindowCutter(model.shapes)
    windows = Windows.joined([*cutter.cut(samples), *cutter.finish()])
    rows = design(model, windows).reshape(-1, model.size) @ model.expansion
    np.testing.assert_allclose(information.folds.sum(axis=0), rows.T @ rows, rtol=1e-7, atol=1e-9)
    assert information.counts.sum() == len(rows) == 2 * information.windows
    assert sum(len(kept) for kept in information.kept()) == information.windows


def test_the_columns_of_the_sums_are_those_of_reciprocal_maps(model, samples):
    windows = some_windows(model, samples)
    expected = (design(model, windows).reshape(-1, model.size) @ model.expansion).reshape(len(windows), 2, -1)
    ((rows, columns),) = model.nonzero_columns(windows)  # one group: in order
    np.testing.assert_allclose(rows.reshape(len(windows), 2, -1), expected[:, :, columns], rtol=0, atol=1e-13)
    assert np.all(np.diff(columns) > 0)
    assert not np.delete(expected, columns, axis=2).any()
    spec = ModelSpec(reciprocal=True, orders=(2, 6), per_phase=True, lag=True, effects=("iron_loss",))
    own, on_all = basis(model, spec), basis(dataclasses.replace(model, reciprocal=False), spec)
    np.testing.assert_allclose(own.toarray(), on_all.toarray(), rtol=0, atol=1e-15)


def test_free_maps_need_sums_over_free_columns(free, samples):
    reciprocal = gathered(dataclasses.replace(free, reciprocal=True), samples)
    with pytest.raises(ValueError, match="freed"):
        Solver.over(reciprocal).solve(ModelSpec(reciprocal=False, orders=(6,)))
    expected = gathered(free, samples)
    np.testing.assert_allclose(reciprocal.freed(free.orders).folds, expected.folds, rtol=1e-12, atol=1e-12)
    assert reciprocal.unit == pytest.approx(expected.unit, rel=1e-10)
    with_sixth_only = reciprocal.freed((6,))
    assert with_sixth_only.model.orders == (6,)
    spec = ModelSpec(reciprocal=False, orders=(6,))
    one, other = (Solver.over(sums).solve(spec) for sums in (with_sixth_only, expected))
    assert one.resistance == pytest.approx(other.resistance, rel=1e-7)


@pytest.mark.parametrize("spec", [ModelSpec(True, (6,)), ModelSpec(True, (2, 6), delay=0.3, magnet=True)])
def test_a_reciprocal_fit_does_not_depend_on_the_columns_of_the_sums(free, samples, spec):
    solvers = [Solver.over(gathered(dataclasses.replace(free, reciprocal=own), samples)) for own in (True, False)]
    one, other = (solver.solve(spec) for solver in solvers)
    np.testing.assert_allclose(one.estimate, other.estimate, rtol=0, atol=1e-6 * np.abs(other.estimate).max())
    assert one.sum_of_squares == pytest.approx(other.sum_of_squares, rel=1e-7)
    errors = [solver.left_out(spec, (1e-4, 1e-2)) for solver in solvers]
    np.testing.assert_allclose(*errors, rtol=1e-6)


def test_sums_over_either_columns_can_be_merged(free, samples):
    """The result has the reciprocal columns, whichever comes first."""
    reciprocal = dataclasses.replace(free, reciprocal=True)
    expected = gathered(reciprocal, samples, samples)
    for first, second in ((free, reciprocal), (reciprocal, free)):
        merged = gathered(first, samples)
        other = gathered(second, samples)
        merged.merge(other)
        assert merged.model.reciprocal
        assert other.model is second
        scale = np.abs(expected.folds).max()
        np.testing.assert_allclose(merged.folds, expected.folds, rtol=0, atol=1e-12 * scale)
        assert merged.unit == pytest.approx(expected.unit, rel=1e-10)


def test_effects_beside_the_folds_are_as_good_as_within(model, samples):
    rng = np.random.default_rng(3)
    sums = gathered(model, samples)
    mixing = rng.standard_normal((3, EFFECT_COLUMNS)) + 1j * rng.standard_normal((3, EFFECT_COLUMNS))
    extended = sums.with_effects(
        lambda windows: np.stack([windows.voltage.conj(), windows.held[:, 1], windows.slope[:, 0]], axis=1) @ mixing
    )
    rows = np.concatenate(
        [
            model.design_times(windows, model.expansion, model.orders).reshape(-1, model.summed.size)
            for windows in extended.kept()
        ]
    )
    np.testing.assert_allclose(extended.folds.sum(axis=0), rows.T @ rows, rtol=1e-7, atol=1e-7)
    spec = ModelSpec(True, (6,), effects=("iron_loss",))
    within = Solver(model, [triangle_of(fold) for fold in extended.folds], extended.counts, unit=extended.unit)
    one, other = (solver.solve(spec) for solver in (Solver.over(extended), within))
    np.testing.assert_allclose(one.estimate, other.estimate, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(sums.folds[:, :, model.effects], 0.0)
    saved = within.savings(other, {name: model.effect(name) for name in ("hysteresis", "voltage_gains")})
    for name, (share, values) in saved.items():
        alone, alone_values = within.saving(other, model.effect(name))
        assert share == pytest.approx(alone, rel=1e-6)
        np.testing.assert_allclose(values, alone_values, rtol=1e-5)


def test_effects_of_all_windows_follow_from_the_kept_ones(free, samples, monkeypatch):
    """A sixth of a short recording hardly visits some columns; what it says of all must stay of the right size."""
    model = dataclasses.replace(free, reciprocal=True)

    def squares(most):
        monkeypatch.setattr(window_sums, "MOST_KEPT", most)
        extended = gathered(model, samples).with_effects(
            lambda windows: np.repeat(windows.voltage[:, None].conj(), EFFECT_COLUMNS, axis=1)
        )
        return np.diag(extended.folds.sum(axis=0))[model.effects]

    whole = squares(100_000)
    assert np.all(np.abs(np.log(squares(300) / whole)) < np.log(3))


def test_memory_does_not_grow_with_the_recording(free, samples, monkeypatch):
    monkeypatch.setattr(window_sums, "MOST_KEPT", 700)
    monkeypatch.setattr(window_sums, "_DUE", 5)  # reached by three passes, as in any long recording
    monkeypatch.setattr("drive_id.core.full.model._GROUP", 128)

    def peak(passes):
        """In one thread: how much two threads hold at a time differs by 5 % from run to run."""
        sums = WindowSums(dataclasses.replace(free, reciprocal=True))
        tracemalloc.start()
        for _ in range(passes):
            sums.next_recording()
            sums.add(samples)
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    with interruptible(lambda: None, alone=True):
        peak(3)  # what is computed once and kept
        few = peak(3)
        assert peak(9) < 1.05 * few


@pytest.mark.parametrize("most", [7, 64, 5000])
def test_groups_hold_all_windows_once(model, samples, monkeypatch, most):
    """And their windows share columns: that is what they are for."""
    cutter = WindowCutter(model.shapes)
    windows = Windows.joined([*cutter.cut(samples), *cutter.finish()])
    in_order = [windows.part(slice(start, start + most)) for start in range(0, len(windows), most)]
    before = [len(columns) for part in in_order for _, columns in model.nonzero_columns(part)]
    monkeypatch.setattr("drive_id.core.full.model._GROUP", most)
    groups = list(model.nonzero_columns(windows))
    assert max(len(rows) for rows, _ in groups) <= 2 * most
    duration = [rows.reshape(-1, 2, len(columns))[:, 0, columns == CONSTANT.start].ravel() for rows, columns in groups]
    np.testing.assert_array_equal(np.sort(np.concatenate(duration)), np.sort(windows.duration))
    if most == 64:
        assert np.mean([len(columns) for _, columns in groups]) < np.mean(before)


def test_pieces_make_no_difference(model, samples):
    """Prompt products leave nothing to a snapshot."""
    whole, later, prompt = gathered(model, samples), WindowSums(model), WindowSums(model)
    for start in range(0, len(samples) - 1, 3001):
        piece = samples.part(max(start - 1, 0), min(start + 3001, len(samples)))
        later.add(piece, continues=start > 0)
        prompt.add(piece, continues=start > 0, prompt=True)
    assert later._due
    assert not prompt._due
    for parts in (later, prompt):
        np.testing.assert_allclose(parts.finished().folds, whole.folds, rtol=1e-9, atol=1e-9)


def test_a_snapshot_leaves_the_stream_alone(model, samples):
    information = WindowSums(model)
    information.add(samples.part(0, 8000))
    before = information.finished()
    folds = before.folds
    information.add(samples.part(7999, 15000), continues=True)
    np.testing.assert_array_equal(before.folds, folds)
    np.testing.assert_allclose(information.finished().folds, gathered(model, samples).folds, rtol=1e-9, atol=1e-9)


def test_merging_is_accumulating_together(model, samples):
    """Folds and segments, too, in which the deviations are taken."""
    other = replace(record(duration=1.1, speed=-300.0, seed=1), turned=frozenset({"currents"}))
    merged = gathered(model, samples)
    merged.merge(gathered(model, other))
    merged.merge(gathered(model, samples))
    together = gathered(model, samples, other, samples)
    np.testing.assert_allclose(merged.folds, together.folds, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(merged.counts, together.counts)
    assert merged.windows == together.windows
    assert (merged.turned, together.turned) == (None, None)  # the second recording tells, the others do not
    for one, two in zip(merged.kept(), together.kept(), strict=True):
        shift = (two.time - one.time) / 0.25
        np.testing.assert_allclose(shift, np.rint(shift), atol=1e-9)
        np.testing.assert_array_equal(one.i_dq, two.i_dq)


@pytest.mark.cases
@pytest.mark.parametrize("most", [window_sums.MOST_KEPT, 700])
def test_a_state_restores_all_of_it(model, samples, monkeypatch, most):
    monkeypatch.setattr(window_sums, "MOST_KEPT", most)
    information = gathered(model, replace(samples, turned=frozenset({"currents"})))
    restored = WindowSums(model)
    restored.restore(information.state())
    np.testing.assert_allclose(restored.folds, information.folds, rtol=1e-12, atol=1e-12)
    assert (restored.windows, restored.outside) == (information.windows, information.outside)
    assert restored.turned == information.turned
    assert [len(kept) for kept in restored.kept()] == [len(kept) for kept in information.kept()]
    for one in (restored, information):
        one.add(samples)
    np.testing.assert_allclose(
        restored.finished().folds.sum(axis=0), information.finished().folds.sum(axis=0), rtol=1e-9, atol=1e-9
    )


def test_few_windows_are_kept_of_a_long_recording(model, samples, monkeypatch):
    monkeypatch.setattr(window_sums, "MOST_KEPT", 700)
    information = gathered(model, samples)
    assert sum(len(kept) for kept in information.kept()) <= 700
    times = [kept.time[0] for kept in information.kept()]
    assert max(times) > 0.7


def test_the_mean_link_is_that_over_time_whatever_windows_are_kept(free, samples, monkeypatch):
    """Fluxes scale with it: their windows and voltages repeat with the trajectory, as a variation of the link may."""
    monkeypatch.setattr(window_sums, "MOST_KEPT", 300)
    link = np.linspace(396.0, 408.0, len(samples))
    link[-len(link) // 4 :] = np.nan
    known = dataclasses.replace(samples, dc_link_voltage=link)
    wanted = float(np.nanmean(link))
    once = gathered(free, known)
    assert once.mean_link == pytest.approx(wanted, rel=1e-9)
    other = gathered(free, dataclasses.replace(samples, dc_link_voltage=np.full(len(link), 300.0)), samples)
    other.merge(once)
    restored = WindowSums(free)
    restored.restore(other.state())
    count = np.isfinite(link).sum()
    for sums in (other, restored, restored.over(free), restored.finished()):
        assert sums.mean_link == pytest.approx((count * wanted + len(link) * 300.0) / (count + len(link)), rel=1e-9)
    assert np.isnan(gathered(free, samples).mean_link)


@pytest.mark.parametrize("every", [2, 4, 8])
def test_what_is_kept_of_the_segments_is_not_in_step_with_any_period(every):
    """The mean of a wave over the kept segments is that over a lot as large, whatever its frequency."""
    numbers = np.arange(4000)
    kept, some = numbers[kept_of(numbers, every)], numbers[kept_of(numbers, 2 * every)]
    assert np.isin(some, kept).all()
    assert len(kept) == pytest.approx(4000 / every, rel=0.1)
    assert np.bincount(kept % window_sums.FOLDS).min() > 0.7 * len(kept) / window_sums.FOLDS
    turns = np.linspace(2e-3, 0.5, 2000)  # per segment
    assert np.abs(np.exp(2j * np.pi * np.outer(turns, kept)).mean(axis=1)).max() < 4 / np.sqrt(len(kept))


def test_samples_of_the_windows_are_even(model, samples):
    """Of each segment, in its fold, and not in step with it: their mean products are those of all."""
    sums = WindowSums(model)
    sums.add(samples)
    sums = sums.finished()
    some = sums.sampled(sums.windows // 3)
    assert some.windows == pytest.approx(sums.windows / 3, rel=0.05)
    assert some.kept_folds() == sums.kept_folds()
    for one, every in zip(
        np.diagonal(some.folds, axis1=1, axis2=2), np.diagonal(sums.folds, axis1=1, axis2=2), strict=True
    ):
        assert 3 * one[VOLTAGE] == pytest.approx(every[VOLTAGE], rel=0.1)
    assert sums.sampled(sums.windows) is sums


def test_windows_beyond_the_range_are_counted_and_left_out(samples):
    narrow = FullModel(LOW / 2, HIGH / 2, 300.0, (6,))
    information = gathered(narrow, samples)
    assert information.outside > 0
    assert information.outside + information.windows == gathered(FullModel(LOW, HIGH, 300.0, (6,)), samples).windows


def test_a_basis_selects_the_unknowns(free):
    model = free
    everything = ModelSpec(reciprocal=False, orders=model.orders, per_phase=True, wide=2, crossing=True)
    columns = np.flatnonzero(np.asarray(abs(basis(model, everything)).sum(axis=1)))
    assert set(range(model.size)) - set(columns) == {
        VOLTAGE, *range(SHIFT.start, SHIFT.stop), MAGNET, *range(model.lags.start, model.lags.stop),
        *range(model.effects.start, model.effects.stop),
    }  # fmt: skip
    effects = basis(model, ModelSpec(reciprocal=True, orders=(), effects=("iron_loss", "eccentricity")))
    assert effects.shape[1] == basis(model, ModelSpec(reciprocal=True, orders=())).shape[1] + 9
    one = basis(model, ModelSpec(reciprocal=True, orders=()))
    assert one.shape[1] == 1 + 2 + model.shapes.usual + model.flux.gradient.shape[1] - 1
    assert dataclasses.replace(everything, orders=()).orders == ()
