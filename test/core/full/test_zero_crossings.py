"""Short windows between the zero crossings of the currents, and their weights where no curve gives the drop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import reciprocal_flux, record

from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full import selection
from drive_id.core.full.fit import fit_full
from drive_id.core.full.model import RESISTANCE as OF_R
from drive_id.core.full.windows import SHORT_ANGLE, WINDOW_ANGLE, WindowCutter, Windows
from drive_id.core.maps.inverter_curve import CapacitiveShapes
from drive_id.core.result.identify import gather

SETTINGS = FitSettings("full", i_max=300.0, harmonic_orders=(), search_orders=False)
SHAPES = CapacitiveShapes.up_to(300.0)
RESISTANCE, NEAR, STUCK = 0.02, 4.0, 8.0
STUCK_SOMEWHAT = 2.0  # V: leaves 2.8 times the noise at crossings
OFFSET = 3.0  # A: alone, it leaves 3.3 times the noise


def drop(i_abc):
    return 4.0 * np.clip(i_abc / 3.0, -1.0, 1.0)


@pytest.fixture(scope="module")
def good():
    return record(reciprocal_flux, duration=4.0, noise=0.3, drop=drop)


def sticking(good, voltage):
    """Return the same with voltages near zero current that follow the sign of the change of the current, not itself."""
    near = np.abs(good.i_abc) < NEAR
    rises = np.gradient(good.i_abc, axis=0) > 0
    return replace(good, u_abc=good.u_abc + voltage * near * np.where(rises, 1.0, -1.0))


@pytest.fixture(scope="module")
def stuck(good):
    return sticking(good, STUCK)


def fit(samples):
    evidence = gather([samples], SETTINGS)
    return fit_full(evidence.windows.finished(), SETTINGS, evidence.turn, evidence.noise_variance)


@pytest.fixture(scope="module")
def good_fit(good):
    return fit(good)


def test_short_windows_share_the_beginning_and_keep_clear_of_zero(good):
    windows = Windows.joined(list(WindowCutter(SHAPES, segment=0.25).cut(good)))
    long, short = windows.part(~windows.short), windows.part(windows.short)
    alone = Windows.joined(list(WindowCutter(SHAPES).cut(good)))
    np.testing.assert_array_equal(long.i_dq, alone.i_dq)
    np.testing.assert_array_equal(long.shape, alone.shape)
    assert np.isin(short.time, long.time).all()
    turned = np.abs(np.diff(short.turned, axis=1))
    np.testing.assert_allclose(turned, SHORT_ANGLE, atol=0.03)
    np.testing.assert_allclose(np.abs(np.diff(long.turned, axis=1)), WINDOW_ANGLE, atol=0.03)
    balanced = frames.phases(frames.space_vector(good.i_abc))
    for n in range(0, len(short), 37):
        begin = round(short.time[n] / good.sample_period)
        i = balanced[begin : begin + round(short.duration[n] / good.sample_period) + 1]
        crosses = (np.sign(i[1:]) != np.sign(i[:-1])).any()
        assert short.clearance[n] == (0.0 if crosses else pytest.approx(np.abs(i).min(), abs=1e-12))
    crossing = short.clearance == 0
    assert 0.1 < crossing.mean() < 0.6


def test_a_drop_that_follows_the_current_needs_no_weights(good_fit):
    assert np.isnan(good_fit.crossings)


@pytest.mark.accuracy
def test_a_drop_that_does_not_is_kept_out_of_map_and_resistance(good_fit, stuck, monkeypatch):
    found, without = fit(stuck), good_fit
    with monkeypatch.context() as patched:
        patched.setattr(selection, "between_crossings", lambda *_: None)
        spoiled = fit(stuck)
    assert found.crossings > 5
    assert found.assessment.changes[OF_R, -1] != 0, "where the drop is no curve, R depends on the curve's shape"
    phase = np.linspace(0.0, 2 * np.pi, 24)
    rows = without.model.flux.rows(150.0 * np.stack([np.cos(phase), np.sin(phase)], axis=1))
    psi, expected, wrong = (rows.dot(each.solution.estimate[each.model.map]) for each in (found, without, spoiled))
    assert np.abs(psi - expected).max() < 5e-3 * np.abs(expected).max()
    assert np.std(psi - expected) < 0.4 * np.std(wrong - expected)
    assert found.solution.resistance == pytest.approx(RESISTANCE, rel=0.02)
    weights = np.concatenate([windows.weights for windows in found.selection.search.sums.kept()])
    clearance = np.concatenate([windows.clearance for windows in found.selection.search.sums.kept()])
    assert np.mean(weights[clearance > 2 * NEAR]) > 0.5
    assert weights[clearance == 0].max() < 1e-2 * weights[clearance > 2 * NEAR].min()


@pytest.mark.accuracy
def test_an_offset_of_the_currents_that_explains_the_crossings_needs_no_weights(good):
    found = fit(replace(good, i_abc=good.i_abc + OFFSET * frames.phases(np.array([1 + 0.5j]))))
    assert np.isnan(found.crossings)
    assert found.solution.spec.effects == ("current_offset",)


@pytest.mark.accuracy
def test_an_offset_beside_a_drop_that_sticks_does_not_prevent_weights(good):
    both = replace(good, i_abc=good.i_abc + OFFSET * frames.phases(np.array([1 + 0.5j])))
    assert fit(sticking(both, STUCK_SOMEWHAT)).crossings > 2
