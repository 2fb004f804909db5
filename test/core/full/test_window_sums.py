"""The accumulated windows: rows against an independent oracle, streaming, merging, storing, thinning."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import BSpline
from synthetic import record

from drive_id.core.full import window_sums
from drive_id.core.full.model import MAGNET, SHIFT, VOLTAGE, FullModel, ModelSpec, basis
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import WindowCutter, Windows
from drive_id.types import Samples

LOW, HIGH = np.array([-310.0, -310.0]), np.array([310.0, 310.0])


@pytest.fixture(scope="module")
def model():
    return FullModel(LOW, HIGH, 300.0, (6,))


@pytest.fixture(scope="module")
def samples():
    return record(duration=1.5, noise=0.3)


def gathered(model, *recordings):
    information = WindowSums(model)
    for samples in recordings:
        information.next_recording()
        information.add(samples)
    return information.finished()


def between(samples, start, end):
    arrays = {name: getattr(samples, name)[start:end] for name in ("stamp", "i_abc", "u_abc", "angle", "speed")}
    return Samples(**arrays, sample_period=samples.sample_period)


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


@pytest.mark.parametrize("reciprocal", [True, False])
def test_design_times_is_the_design_times_a_matrix(model, samples, reciprocal):
    cutter = WindowCutter(model.shapes)
    windows = Windows.joined([*cutter.cut(samples), *cutter.finish()]).part(np.arange(0, 1500, 47))
    windows = dataclasses.replace(windows, heating=np.linspace(-1.0, 40.0, len(windows)))
    for orders in ((), (1, 2), (1, 2, 6)):
        t = basis(model, ModelSpec(reciprocal, orders, per_phase=True, magnet=True, lag=True))
        expected = model.design(windows) @ t.toarray()
        scale = np.abs(expected).max(axis=(0, 1)) + 1e-300
        assert np.abs((model.design_times(windows, t, orders) - expected) / scale).max() < 1e-12


def test_rows_say_what_the_balance_says(model, samples):
    """Any parameters, put into the voltage balance one window at a time, give the rows times the parameters."""
    cutter = WindowCutter(model.shapes)
    windows = Windows.joined([*cutter.cut(samples), *cutter.finish()]).part(np.arange(0, 1500, 47))
    rng = np.random.default_rng(5)
    x = rng.standard_normal(model.size)
    resistance, constant, drops = x[1], x[2] + 1j * x[3], x[model.drops].reshape(-1, 3)
    expected = x[0] * windows.voltage + resistance * windows.current + constant * windows.duration
    expected = expected + windows.shifted @ x[SHIFT]
    per_phase = np.einsum("nsp,sp->np", windows.shape, drops)
    expected = expected + 2 / 3 * per_phase @ np.exp(2j * np.pi / 3 * np.arange(3)) + windows.lag @ x[model.lags]
    expected = expected + windows.crossing * x[model.crossing]
    for end, sign in ((0, -1), (1, 1)):
        i_dq, theta = windows.i_dq[:, end], windows.angle[:, end]
        psi = flux_by_scipy(model.flux, x[model.map], i_dq)
        for order, columns in model.harmonics.items():
            a, b = (flux_by_scipy(model.space(order), half, i_dq) for half in np.split(x[columns], 2))
            psi = psi + a * np.cos(order * theta) + b * np.sin(order * theta)
        expected = expected + sign * np.exp(1j * theta) * psi
    found = model.design(windows) @ x
    np.testing.assert_allclose(found[:, 0] + 1j * found[:, 1], expected, rtol=1e-9, atol=1e-9)


def test_folds_hold_the_cross_products(model, samples):
    information = gathered(model, samples)
    cutter = WindowCutter(model.shapes)
    windows = Windows.joined([*cutter.cut(samples), *cutter.finish()])
    rows = model.design(windows).reshape(-1, model.size)
    np.testing.assert_allclose(information.folds.sum(axis=0), rows.T @ rows, rtol=1e-7, atol=1e-9)
    assert information.counts.sum() == len(rows) == 2 * information.windows
    assert sum(len(kept) for kept in information.kept()) == information.windows


def test_pieces_make_no_difference(model, samples):
    information = WindowSums(model)
    for start in range(0, len(samples) - 1, 3001):
        piece = between(samples, max(start - 1, 0), start + 3001)
        information.add(piece, continues=start > 0)
    whole, parts = gathered(model, samples), information.finished()
    np.testing.assert_allclose(parts.folds, whole.folds, rtol=1e-9, atol=1e-9)


def test_a_snapshot_leaves_the_stream_alone(model, samples):
    information = WindowSums(model)
    information.add(between(samples, 0, 8000))
    before = information.finished()
    folds = before.folds
    information.add(between(samples, 7999, 15000), continues=True)
    np.testing.assert_array_equal(before.folds, folds)
    np.testing.assert_allclose(information.finished().folds, gathered(model, samples).folds, rtol=1e-9, atol=1e-9)


def test_merging_is_accumulating_together(model, samples):
    """Folds and segments, too, in which the deviations are taken."""
    other = record(duration=1.1, speed=-300.0, seed=1)
    merged = gathered(model, samples)
    merged.merge(gathered(model, other))
    merged.merge(gathered(model, samples))
    together = gathered(model, samples, other, samples)
    np.testing.assert_allclose(merged.folds, together.folds, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(merged.counts, together.counts)
    assert merged.windows == together.windows
    for one, two in zip(merged.kept(), together.kept(), strict=True):
        shift = (two.time - one.time) / 0.25
        np.testing.assert_allclose(shift, np.rint(shift), atol=1e-9)
        np.testing.assert_array_equal(one.i_dq, two.i_dq)


@pytest.mark.parametrize("most", [window_sums.MOST_KEPT, 700])
def test_a_state_restores_all_of_it(model, samples, monkeypatch, most):
    monkeypatch.setattr(window_sums, "MOST_KEPT", most)
    information = gathered(model, samples)
    restored = WindowSums(model)
    restored.restore(information.state())
    np.testing.assert_allclose(restored.folds, information.folds, rtol=1e-12, atol=1e-12)
    assert (restored.windows, restored.outside) == (information.windows, information.outside)
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


def test_windows_beyond_the_range_are_counted_and_left_out(samples):
    narrow = FullModel(LOW / 2, HIGH / 2, 300.0, (6,))
    information = gathered(narrow, samples)
    assert information.outside > 0
    assert information.outside + information.windows == gathered(FullModel(LOW, HIGH, 300.0, (6,)), samples).windows


def test_a_basis_selects_the_unknowns(model):
    from drive_id.core.full.model import ModelSpec

    everything = ModelSpec(reciprocal=False, orders=model.all_orders, per_phase=True, crossing=True)
    columns = np.flatnonzero(np.asarray(abs(basis(model, everything)).sum(axis=1)))
    assert set(range(model.size)) - set(columns) == {
        VOLTAGE, *range(SHIFT.start, SHIFT.stop), MAGNET, *range(model.lags.start, model.lags.stop),
        *range(model.effects.start, model.effects.stop),
    }  # fmt: skip
    effects = basis(model, ModelSpec(reciprocal=True, orders=(), effects=("iron_loss", "eccentricity")))
    assert effects.shape[1] == basis(model, ModelSpec(reciprocal=True, orders=())).shape[1] + 9
    one = basis(model, ModelSpec(reciprocal=True, orders=()))
    assert one.shape[1] == 1 + 2 + len(model.shapes.scales) + model.flux.gradient.shape[1] - 1
    assert dataclasses.replace(everything, orders=()).orders == ()
