"""Residuals beyond current noise: none on a drive that obeys the model, told and counted on one that does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import reciprocal_flux, record

from drive_id.core.fit_settings import FitSettings
from drive_id.core.frames import PHASE_SHIFTS
from drive_id.core.full.fit import fit_full
from drive_id.core.methods import full
from drive_id.core.result.identify import gather, identify

SETTINGS = FitSettings("full", i_max=300.0, search_orders=False)


@pytest.fixture(scope="module")
def good():
    return record(reciprocal_flux, duration=4.0, noise=1.0)


@pytest.fixture(scope="module")
def bad(good):
    """The same with a voltage of the tenth order in the rotor's frame, which no part of the model explains."""
    u_s = 1.5 * np.cos(10 * good.angle) * np.exp(1j * good.angle)
    return replace(good, u_abc=good.u_abc + (u_s[:, None] * np.exp(-1j * PHASE_SHIFTS)).real)


def fit(samples):
    evidence = gather([samples], SETTINGS)
    return fit_full(evidence.windows.finished(), SETTINGS, evidence.turn, evidence.noise_variance)


@pytest.mark.accuracy
def test_noise_explains_the_residuals_of_a_drive_that_obeys_the_model(good):
    misfit = fit(good).assessment.misfit
    assert misfit.ratio == pytest.approx(1.0, abs=0.1)
    assert misfit.changes.shape[1] == 0


@pytest.mark.accuracy
def test_what_repeats_over_the_rotor_position_widens_the_standard_errors(good, bad, monkeypatch):
    fits = []

    def kept(*given, **named):
        fits.append(fit_full(*given, **named))
        return fits[-1]

    monkeypatch.setattr(full, "fit_full", kept)
    one, other = (identify([samples], SETTINGS) for samples in (good, bad))
    _, found = fits
    misfit = found.assessment.misfit
    assert misfit.ratio > 1.3
    in_map = np.square(found.assessment.changes[found.model.map]).sum(axis=1)
    repeating = np.square(misfit.changes[found.model.map]).sum(axis=1)
    assert np.median(repeating / in_map) > 0.05
    inside = one.flux_map.inside & other.flux_map.inside
    assert np.median(other.flux_map.sigma_d[inside] / one.flux_map.sigma_d[inside]) > 2
    assert not any("as current noise explains" in warning for warning in one.report.warnings)
    assert sum("as current noise explains" in warning for warning in other.report.warnings) == 1
