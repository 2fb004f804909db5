from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.maps.error_modes import MOST_MODES, error_modes
from drive_id.core.maps.flux_models import BasisRows, TensorSpline
from drive_id.core.numerics.bspline import Axis

SPLINE = TensorSpline(Axis(-10.0, 10.0, 6), Axis(-8.0, 8.0, 5))
D, Q, C = 13, 11, 4


@pytest.fixture
def grid():
    axes = np.meshgrid(np.linspace(-10, 10, D), np.linspace(-8, 8, Q), indexing="ij")
    return np.stack(axes, axis=-1)


def fit(grid, batches, *, widened=1.0, turn=None):
    """Return modes of random changes, and the joint changes of all values by the batches, N x B."""
    rng = np.random.default_rng(7)
    inside = grid[..., 0] ** 2 / 100 + grid[..., 1] ** 2 / 64 <= 1
    changes = rng.normal(size=(SPLINE.parameters, batches))
    others = rng.normal(size=(2 + C, batches)) + 5 * changes[:6]
    rows = SPLINE.rows(grid[inside])
    psi = np.einsum("nap,pb->nab", rows.dense(SPLINE.parameters), changes)
    if turn is not None:
        psi = np.einsum("xa,nab->nxb", turn, psi)
    sigma = np.full((*inside.shape, 2), np.nan)
    sigma[inside] = widened * np.linalg.norm(psi, axis=-1)
    errors = widened * np.linalg.norm(others, axis=1)
    frame = None if turn is None else (lambda flux: flux @ turn.T)
    found = error_modes(changes, rows, sigma, inside, (others, errors), frame)
    joint = np.concatenate([psi[:, 0], psi[:, 1], others])
    return found, joint, inside


def stacked(modes, inside):
    """Return the modes of all values in the order of the joint changes, N x M."""
    numbers = np.concatenate([modes.resistance[None], modes.voltage_error[None], modes.inverter_voltage.T])
    return np.concatenate([modes.psi_d[:, inside].T, modes.psi_q[:, inside].T, numbers])


@pytest.mark.parametrize("turn", [None, np.array([[0.8, -0.6], [0.6, 0.8]])])
def test_few_batches_are_kept_with_all_their_correlations(grid, turn):
    modes, joint, inside = fit(grid, 6, turn=turn)
    assert len(modes) == 6
    found = stacked(modes, inside)
    wanted = joint @ joint.T
    np.testing.assert_allclose(found @ found.T, wanted, atol=1e-5 * np.abs(wanted).max())
    assert not modes.psi_d[:, ~inside].any()


def test_many_batches_keep_each_standard_error_and_nearly_all_correlations(grid):
    modes, joint, inside = fit(grid, 3000, widened=1.2)
    assert len(modes) <= MOST_MODES
    found = stacked(modes, inside)
    sigma = 1.2 * np.linalg.norm(joint, axis=1)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), sigma, rtol=1e-5)
    correlation = joint @ joint.T / np.outer(*[np.linalg.norm(joint, axis=1)] * 2)
    np.testing.assert_allclose(found @ found.T / np.outer(sigma, sigma), correlation, atol=0.15)


def test_modes_hold_the_errors_of_slopes():
    """Fluxes err mostly together, slopes by what is left: modes chosen by the former alone lose part of the latter."""
    spline = TensorSpline(Axis(-10.0, 10.0, 14), Axis(-8.0, 8.0, 14))
    points = np.stack(np.meshgrid(np.linspace(-10, 10, 29), np.linspace(-8, 8, 29), indexing="ij"), axis=-1)
    rows = spline.rows(points.reshape(-1, 2))
    rng = np.random.default_rng(5)
    rough = rng.normal(size=(spline.parameters, 60)) @ rng.normal(size=(60, 400))
    changes = rough + 80.0 * rng.normal(size=400)
    psi = np.einsum("nap,pb->nab", rows.dense(spline.parameters), changes).reshape(29, 29, 2, 400)
    sigma = np.linalg.norm(psi, axis=-1)
    modes = error_modes(changes, rows, sigma, np.ones((29, 29), np.bool_), (np.ones((6, 400)), np.ones(6)))
    for axis in (0, 1):
        wanted = np.linalg.norm(np.diff(psi, axis=axis), axis=-1)
        found = np.linalg.norm(np.diff(np.stack([modes.psi_d, modes.psi_q], axis=-1), axis=1 + axis), axis=0)
        assert np.mean(found**2) > 0.6 * np.mean(wanted**2)


@pytest.mark.parametrize("steep", [0.3, 1.0])
def test_waves_hold_what_smooth_modes_lack_of_the_errors_of_slopes(steep):
    """The standard errors of inductances are those that are given, and those of the fluxes do not change by it."""
    spline = TensorSpline(Axis(-10.0, 10.0, 6), Axis(-8.0, 8.0, 6))
    points = np.stack(np.meshgrid(np.linspace(-10, 10, 41), np.linspace(-8, 8, 41), indexing="ij"), axis=-1)
    inside = np.hypot(points[..., 0] / 10, points[..., 1] / 8) <= 1
    rows, slopes = spline.rows(points[inside]), spline.slope_rows(points[inside])
    own = BasisRows(
        *(np.stack([getattr(r, n)[:, k] for k, r in enumerate(slopes)], axis=1) for n in ("column", "value"))
    )
    step = points[1, 1] - points[0, 0]
    per_step = BasisRows(own.column, own.value * step[:, None])
    changes = np.random.default_rng(3).normal(size=(spline.parameters, 9))
    sigma = np.full((41, 41, 2), np.nan)
    sigma[inside] = 1.3 * np.linalg.norm(rows.dot(changes), axis=-1)
    wanted = steep * 0.6 * sigma[inside]  # 0.6 rad per step, of which waves can hold 0.7
    others = (np.ones((6, 9)), np.full(6, 3.0))
    modes = error_modes(changes, rows, sigma, inside, others, slopes=(per_step, wanted))
    within = np.hypot(points[..., 0] / 9, points[..., 1] / 7.2) <= 1
    for axis, psi in enumerate((modes.psi_d, modes.psi_q)):
        np.testing.assert_allclose(np.linalg.norm(psi, axis=0)[inside], sigma[inside, axis], rtol=1e-5)
        found = np.linalg.norm(np.gradient(psi, axis=axis + 1), axis=0)[within]
        ratio = found / _on(inside, wanted[:, axis])[within]
        assert 0.8 < np.median(ratio) < 1.1
    assert np.linalg.norm(modes.resistance) == pytest.approx(3.0)


def _on(inside, values):
    out = np.ones(inside.shape)
    out[inside] = values
    return out


def test_unknown_errors_have_no_modes(grid):
    inside = np.ones((D, Q), np.bool_)
    rows = SPLINE.rows(grid.reshape(-1, 2))
    sigma = np.full((D, Q, 2), np.inf)
    changes = np.full((SPLINE.parameters, 1), np.inf)
    assert error_modes(changes, rows, sigma, inside, (np.ones((6, 1)), np.ones(6))) is None
    sigma, changes = np.ones((D, Q, 2)), np.ones((SPLINE.parameters, 1))
    assert error_modes(changes, rows, sigma, inside, (np.ones((6, 1)), np.ones(6))) is not None


def test_fine_grids_get_fewer_modes():
    axis = np.linspace(-8, 8, 700)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    changes = np.random.default_rng(1).normal(size=(SPLINE.parameters, 40))
    inside, sigma = np.ones((700, 700), np.bool_), np.ones((700, 700, 2))
    modes = error_modes(changes, SPLINE.rows(points), sigma, inside, (np.ones((6, 40)), np.ones(6)))
    assert len(modes) == 8
    np.testing.assert_allclose(np.linalg.norm(modes.psi_q, axis=0), 1.0, rtol=1e-5)
