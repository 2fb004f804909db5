"""Fine cells where the map has details that the usual ones do not resolve, and bands where no cells would do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import record

from drive_id.core.fit_settings import FitSettings
from drive_id.core.full import selection
from drive_id.core.full.fit import EarlierFit, fit_full
from drive_id.core.full.lack_of_fit import missed_flux
from drive_id.core.result.identify import gather, identify

SETTINGS = FitSettings("full", i_max=300.0, maps="reciprocal", search_orders=False, harmonic_orders=())


def smooth_flux(i_dq):
    """Return the gradient of 0.08 i_d + 30 sqrt(1 + 0.6 x^2 + 1.3 y^2), x and y being currents over 300 A, in Wb."""
    x, y = i_dq[..., 0] / 300, i_dq[..., 1] / 300
    root = np.sqrt(1 + 0.6 * x**2 + 1.3 * y**2)
    return np.stack([0.08 + 0.06 * x / root, 0.13 * y / root], axis=-1)


def detailed_flux(i_dq):
    """Add the gradient of a co-energy that waves with a period of 130 A; the widest of the usual cells have 73 A."""
    k = 2 * np.pi / 130.0
    x, y = k * i_dq[..., 0], k * i_dq[..., 1]
    return smooth_flux(i_dq) + 2e-3 * np.stack([-np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)], axis=-1)


def whirling_flux(i_dq):
    """Add a flux that is no gradient, too small for the choice of free maps."""
    return smooth_flux(i_dq) + 1.5e-4 * np.stack([np.sin(i_dq[..., 1] / 60), -np.sin(i_dq[..., 0] / 60)], axis=-1)


def gathered(flux, noise=0.1):
    return gather([record(flux, duration=6.0, noise=noise)], SETTINGS)


def fitted(evidence, earlier=None):
    return fit_full(evidence.windows.finished(), SETTINGS, evidence.turn, evidence.noise_variance, earlier)


def error(fit, flux):
    """Return the rms error of the map within the disc, Wb."""
    axis = np.linspace(-285.0, 285.0, 61)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    i_dq = grid[np.hypot(*grid.T) <= 285.0]
    found = fit.model.flux.rows(i_dq).dot(fit.solution.estimate[fit.model.map])
    return np.sqrt(np.mean((found - flux(i_dq)) ** 2))


@pytest.fixture(scope="module")
def detailed():
    return gathered(detailed_flux)


@pytest.fixture(scope="module")
def fine(detailed):
    return fitted(detailed)


@pytest.fixture(scope="module")
def smooth():
    return fitted(gathered(smooth_flux))


@pytest.mark.accuracy
def test_fine_cells_are_used_where_they_are_needed(detailed, fine, monkeypatch):
    assert fine.model.resolution.finer_than_usual
    monkeypatch.setattr(selection, "_REFINEMENTS", 0)
    usual = fitted(detailed)
    assert not usual.model.resolution.finer_than_usual
    assert error(fine, detailed_flux) < 0.5 * error(usual, detailed_flux)
    assert fine.solution.residual_rms < 0.7 * usual.solution.residual_rms


@pytest.mark.accuracy
def test_free_maps_over_fine_cells_are_tried_where_usual_ones_promise_a_gain(fine):
    def whirling(i_dq):
        return detailed_flux(i_dq) + 3.0 * (whirling_flux(i_dq) - smooth_flux(i_dq))

    for fit, promising in ((fine, False), (fitted(gathered(whirling)), True)):
        assert fit.model.resolution.finer_than_usual
        free = replace(fit.spec, reciprocal=False)
        assert selection._promise(fit.selection.search.sums, fit.spec, free) == promising


@pytest.mark.accuracy
def test_a_later_fit_keeps_the_cells(detailed, fine):
    again = fitted(detailed, EarlierFit.of(fine))
    assert again.model.resolution is fine.model.resolution
    np.testing.assert_allclose(again.solution.estimate, fine.solution.estimate, atol=1e-6)


def test_a_smooth_map_keeps_the_usual_cells(smooth):
    assert not smooth.model.resolution.finer_than_usual


@pytest.mark.accuracy
def test_noise_forbids_fine_cells():
    assert not fitted(gathered(detailed_flux, noise=10.0)).model.resolution.finer_than_usual


@pytest.mark.accuracy
def test_bands_include_what_the_model_cannot_follow(smooth):
    assert not smooth.assessment.misfit.missed.any()
    found = identify([record(whirling_flux, duration=4.0, noise=0.1)], SETTINGS).flux_map
    grid = found.grid()
    inside = found.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= 285.0)
    true = whirling_flux(grid[inside])
    d = np.abs(found.psi_d[inside] - true[:, 0]) < 1.96 * found.sigma_d[inside]
    q = np.abs(found.psi_q[inside] - true[:, 1]) < 1.96 * found.sigma_q[inside]
    assert np.mean([d, q]) > 0.85  # 0.73 without


def test_the_missed_flux_is_that_of_simulated_residuals():
    """Residuals ``h x + noise`` in 144 cells: noise alone gives nothing, a flux gives its mean square."""
    rng = np.random.default_rng(5)
    h, count = 1.0, 80

    def facts(size):
        x = size * rng.standard_normal((144, 1, 2))
        residual = h * x + rng.standard_normal((144, count, 2))
        sums = (h * residual).sum(axis=1)
        return np.column_stack(
            [np.full(144, count), np.full(144, count * h**2), sums, (residual**2).sum(axis=(1, 2))]
        ), x

    assert not any(missed_flux(facts(0.0)[0]).any() for _ in range(20))
    found, x = facts(0.5)
    assert missed_flux(found).mean(axis=(0, 1)) == pytest.approx(np.mean(x**2, axis=(0, 1)), rel=0.25)
    found[:, 0] = 1.0  # too few windows
    assert not missed_flux(found).any()
