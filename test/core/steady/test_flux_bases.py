"""Bases of reciprocal maps and the drop of the inverter, against quadrature and difference quotients."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from drive_id.core.steady.flux_bases import AffineBasis, CoEnergyBasis, affine_rows, linearized

BASIS = CoEnergyBasis(50.0, 4, 1.5)


def test_maps_are_reciprocal_and_symmetric_about_the_d_axis():
    rng = np.random.default_rng(2)
    gamma, i_dq = rng.standard_normal(BASIS.parameters), rng.uniform(-45, 45, (50, 2))
    psi, inductance = linearized(BASIS, gamma, i_dq)
    scale = np.abs(inductance).max()
    np.testing.assert_allclose(inductance[:, 0, 1], inductance[:, 1, 0], atol=1e-5 * scale)
    mirrored = BASIS.rows(i_dq * [1, -1]) @ gamma
    np.testing.assert_allclose(mirrored, psi * [1, -1], atol=1e-12 * np.abs(psi).max())


def test_affine_machines_are_not_penalized_and_all_else_is():
    sites = np.random.default_rng(3).uniform(-50, 50, (300, 2))
    rows, wanted = BASIS.rows(sites).reshape(600, -1), affine_rows(sites)[..., :3].reshape(600, 3)
    affine, *_ = np.linalg.lstsq(rows, wanted, rcond=None)[:2]
    np.testing.assert_allclose(rows @ affine, wanted, atol=1e-9)
    eigenvalues = np.linalg.eigvalsh(BASIS.penalty)
    assert np.abs(BASIS.penalty @ affine).max() < 1e-8 * eigenvalues[-1] * np.abs(affine).max()
    assert (eigenvalues[3:] > 1e-8 * eigenvalues[-1]).all()
    assert BASIS.free == 3


def test_the_penalty_is_the_integral_of_squared_third_derivatives():
    """Against scipy's splines and a midpoint rule."""
    gamma = np.random.default_rng(4).standard_normal(BASIS.parameters)
    basis = BASIS._axis
    net = (BASIS._even @ gamma).reshape(basis.count, basis.count)
    x = np.linspace(-50, 50, 4001)[:-1] + 50 / 4000
    along = [BSpline(basis.knots, np.eye(basis.count), 4).derivative(k)(x) if k else
             BSpline(basis.knots, np.eye(basis.count), 4)(x) for k in range(4)]  # fmt: skip
    total = 0.0
    for k, weight in enumerate((1, 3, 3, 1)):
        gram_d, gram_q = (part.T @ part * (x[1] - x[0]) for part in (along[3 - k], along[k]))
        total += weight * np.sum((gram_d @ net @ gram_q) * net)
    assert gamma @ BASIS.penalty @ gamma == pytest.approx(total, rel=1e-3)


def test_an_odd_part_adds_two_coefficients():
    assert AffineBasis(odd=True).parameters == AffineBasis().parameters + 2
    odd = CoEnergyBasis(50.0, 4, 1.5, odd=True)
    assert (odd.parameters, odd.free) == (BASIS.parameters + 2, 5)
