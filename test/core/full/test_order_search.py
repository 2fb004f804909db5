"""Harmonics that are not among the candidates: what finds them, and what a fit makes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drive_id.bench.machines import MACHINES
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full import order_search
from drive_id.core.full.order_search import explained_shares, unexpected_orders
from drive_id.core.result.identify import gather, identify, score
from drive_id.fitting.simulated import run_experiment

UNUSUAL = (6, 0.015, 0.01), (30, 0.0, 0.006)


@pytest.fixture(scope="module")
def simulation():
    machine = replace(MACHINES["spm"], harmonics=UNUSUAL).to_map()
    return run_experiment(machine, SimulationSettings(current_noise=2e-3), seconds=3.0)


@pytest.fixture(scope="module")
def windows(simulation):
    return gather([simulation.samples], FitSettings("full")).windows.finished()


def with_harmonic(model, orders, amplitude):
    """Return parameters that put e^{j theta} cos(h theta) times a constant into the residuals."""
    residual = np.zeros(model.size)
    for order in orders:
        space, start = model.harmonic, model.harmonics[order].start
        residual[start : start + space.parameters] = amplitude  # B-splines sum to one
    return residual


def test_a_share_is_that_of_the_residual(windows, monkeypatch):
    """A residual of one harmonic alone is explained by that one, and by no other."""
    monkeypatch.setattr(order_search, "HIGHEST_ORDER", 24)
    residual = with_harmonic(windows.model, [12], 0.01)
    shares = explained_shares(windows.model, residual, windows.kept())
    assert shares[11] == pytest.approx(1.0, abs=1e-9)
    assert np.delete(shares, 11).max() < 0.1
    assert unexpected_orders(windows.model, residual, windows.kept(), ()) == (12,)
    assert unexpected_orders(windows.model, residual, windows.kept(), (6, 12)) == ()


def test_no_order_shows_as_another_because_windows_are_left_out(windows, monkeypatch):
    """At even distances, some numbers of windows show most of the sixth harmonic as another one."""
    residual = with_harmonic(windows.model, [6], 0.01)
    for most in range(500, 1500, 100):
        monkeypatch.setattr("drive_id.core.full.windows.SEARCHED", most)
        assert np.delete(explained_shares(windows.model, residual, windows.kept()), 5).max() < 0.15


def test_the_strongest_comes_first(windows, monkeypatch):
    monkeypatch.setattr(order_search, "HIGHEST_ORDER", 30)
    model = windows.model
    residual = with_harmonic(model, [6], 0.01) + with_harmonic(model, [18], 0.02)
    assert unexpected_orders(model, residual, windows.kept(), ()) == (18, 6)


@pytest.mark.accuracy
def test_an_order_that_nobody_asked_for_is_found_and_fitted(simulation):
    settings = FitSettings("full", i_max=simulation.truth.i_max)
    found = identify([simulation.samples], settings)
    without = identify([simulation.samples], replace(settings, search_orders=False))
    assert [harmonic.order for harmonic in found.flux_map.harmonics] == [6, 30]
    assert [harmonic.order for harmonic in without.flux_map.harmonics] == [6]
    error, larger = (max(score(one, simulation.truth)) for one in (found, without))
    assert error < min(1e-3, 0.9 * larger)


def test_windows_serve_another_model(windows, simulation):
    """While all windows are kept, asking them for other orders equals accumulating for these from the start."""
    other = windows.over(replace(windows.model, orders=(6, 30)))
    direct = gather([simulation.samples], FitSettings("full", harmonic_orders=(6, 30))).windows.finished()
    assert other.windows == direct.windows
    np.testing.assert_array_equal(other.counts, direct.counts)
    np.testing.assert_allclose(other.folds, direct.folds, rtol=1e-12, atol=1e-12)
