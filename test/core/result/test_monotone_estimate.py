"""Maps made monotone on request: where they move, what is said of it, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import record, saturating_flux

from drive_id.core.fit_settings import FitSettings
from drive_id.core.maps.flux_models import positive_definite
from drive_id.core.methods.paper import PAPER_METHODS
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identify import gather
from drive_id.core.result.monotone_estimate import made_monotone
from drive_id.errors import UnexplainedError


@pytest.fixture(scope="module")
def samples():
    return record(duration=2.0, noise=0.3)


@pytest.fixture(scope="module")
def estimated(samples):
    evidence = gather([samples], FitSettings(method="joint", monotone=True, grid_points=19))
    inside = evidence.inside()
    return evidence, PAPER_METHODS["joint"].conclude(evidence, inside), inside


def of_map(estimate, sigma=None, **changes):
    """Return the estimate with other fluxes, and with one standard error, Wb."""
    found = estimate.flux_map
    if sigma is not None:
        changes |= dict.fromkeys(("sigma_d", "sigma_q"), np.where(found.inside, sigma, np.nan))
    return replace(estimate, flux_map=replace(found, **changes))


def test_the_setting_gives_a_monotone_map_near_the_estimate(samples, estimated):
    evidence, estimate, inside = estimated
    drive = conclude(evidence, [samples])
    flux_map = drive.flux_map
    (said,) = (sentence for sentence in drive.statements if "monotone" in sentence)
    assert "standard errors" in said
    assert not any("monotone" in warning for warning in drive.report.warnings)
    moved = np.abs(flux_map.psi - estimate.flux_map.psi)[inside]
    assert (moved / estimate.flux_map.sigmas[inside]).max() < 3
    np.testing.assert_array_equal(flux_map.sigma_d, estimate.flux_map.sigma_d)
    grid = flux_map.grid()
    for psi, axis in ((flux_map.psi_d, 0), (flux_map.psi_q, 1)):
        assert (np.diff(psi, axis=axis) > 0).all()
    stored = flux_map.inductances(*np.random.default_rng(1).uniform(-250, 250, (2, 5000)))
    stored = stored[np.isfinite(stored).all(axis=(1, 2))]
    assert len(stored) > 2000
    assert np.linalg.eigvalsh((stored + stored.swapaxes(1, 2)) / 2).min() > 0
    error = np.abs(flux_map.psi[inside] - saturating_flux(grid[inside]))
    assert np.median(error) < 3e-3
    assert np.isfinite([drive.report.mad_d, drive.report.mad_q]).all()


def test_a_map_that_the_data_fold_is_moved_with_a_warning(estimated):
    _, estimate, inside = estimated
    grid = estimate.flux_map.grid()
    bump = 0.03 * np.exp(-((grid[..., 0] - 60) ** 2 + grid[..., 1] ** 2) / (2 * 35.0**2))
    folded = of_map(estimate, psi_d=estimate.flux_map.psi_d + bump, sigma=1e-4)
    assert np.diff(folded.flux_map.psi_d, axis=0).min() < 0
    found = made_monotone(folded)
    assert np.diff(found.flux_map.psi_d, axis=0).min() > 0
    (warning,) = (sentence for sentence in found.warnings if "monotone" in sentence)
    assert "contradict" in warning
    assert "was made monotone" in found.statements[-1]
    assert positive_definite(found.flux_map.inductances(*grid[inside].T)).all()
    moved = np.abs(found.flux_map.psi - folded.flux_map.psi)[inside]
    assert f"{moved.max():.3g} Wb" in found.statements[-1]


def test_unknown_standard_errors_judge_nothing(estimated):
    estimate = estimated[1]
    found = made_monotone(of_map(estimate, sigma=np.inf))
    assert "Without standard errors" in found.statements[-1]
    assert found.warnings == estimate.warnings


def test_a_map_far_from_any_monotone_one_is_refused(estimated):
    estimate = estimated[1]
    turned = of_map(estimate, psi_d=-estimate.flux_map.psi_d, psi_q=-estimate.flux_map.psi_q)
    with pytest.raises(UnexplainedError, match=r"psi_d does not rise .* set monotone to false"):
        made_monotone(turned)
