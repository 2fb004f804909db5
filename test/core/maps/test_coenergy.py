"""Spaces of co-energy gradients against scipy's B-splines, finite differences, and their defining property."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from drive_id.core.maps.coenergy import GradientSpline, SplineBasis, bent_edges
from drive_id.errors import ConfigurationError

RNG = np.random.default_rng(3)
LOW, HIGH = np.array([-310.0, -250.0]), np.array([290.0, 300.0])


@pytest.fixture(params=[2, 3, 4])
def space(request):
    return GradientSpline.within(LOW, HIGH, 7, request.param)


def currents(count=60):
    return RNG.uniform(LOW, HIGH, (count, 2))


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_a_basis_is_that_of_scipy(degree):
    basis = SplineBasis(bent_edges(-310.0, 290.0, 9), degree)
    x = np.concatenate([RNG.uniform(-310, 290, 200), basis.edges])
    first, values = basis.values(x)
    dense = np.zeros((len(x), basis.count))
    dense[np.arange(len(x))[:, None], first[:, None] + np.arange(degree + 1)] = values
    np.testing.assert_allclose(dense, BSpline.design_matrix(x, basis.knots, degree).toarray(), atol=1e-14)
    np.testing.assert_allclose(values.sum(axis=1), 1.0)
    coefficients = RNG.standard_normal(basis.count)
    slope = BSpline(basis.knots, coefficients, degree).derivative()
    first, slopes = basis.slopes(x[:200])
    found = np.einsum("nk,nk->n", slopes, coefficients[first[:, None] + np.arange(degree + 1)])
    np.testing.assert_allclose(found, slope(x[:200]), rtol=1e-9, atol=1e-12)
    lower = BSpline(basis.knots[1:-1], basis.derivative() @ coefficients, degree - 1)
    np.testing.assert_allclose(lower(x[:200]), slope(x[:200]), rtol=1e-9, atol=1e-12)


def test_a_gradient_is_that_of_the_co_energy(space):
    count = len(space.d) - 1 + space.degree
    w = RNG.standard_normal((count, count))
    knots_d, knots_q = (SplineBasis(edges, space.degree).knots for edges in (space.d, space.q))
    i_dq = currents()

    def co_energy(i):
        along_d = BSpline.design_matrix(i[:, 0], knots_d, space.degree)
        along_q = BSpline.design_matrix(i[:, 1], knots_q, space.degree)
        return np.einsum("na,ab,nb->n", along_d.toarray(), w, along_q.toarray())

    psi = space.rows(i_dq).dot(space.gradient @ w.ravel())
    step = 1e-3
    inner = np.clip(i_dq, LOW + step, HIGH - step)
    psi = space.rows(inner).dot(space.gradient @ w.ravel())
    for axis, direction in enumerate(np.eye(2)):
        numeric = (co_energy(inner + step * direction) - co_energy(inner - step * direction)) / (2 * step)
        np.testing.assert_allclose(psi[:, axis], numeric, rtol=1e-5, atol=1e-7)


def test_gradients_are_reciprocal_and_free_maps_are_not(space):
    gradient = space.gradient
    i_dq = currents()
    by_d, by_q = space.slope_rows(i_dq)
    gamma = gradient @ RNG.standard_normal(gradient.shape[1])
    np.testing.assert_allclose(by_d.dot(gamma)[:, 1], by_q.dot(gamma)[:, 0], atol=1e-13)
    free = RNG.standard_normal(space.parameters)
    assert np.abs(by_d.dot(free)[:, 1] - by_q.dot(free)[:, 0]).max() > 1e-3


def test_slopes_are_those_of_the_rows(space):
    gamma, step = RNG.standard_normal(space.parameters), 1e-4
    i_dq = np.clip(currents(), LOW + step, HIGH - step)
    for rows, direction in zip(space.slope_rows(i_dq), np.eye(2), strict=True):
        sides = [space.rows(i_dq + sign * step * direction).dot(gamma) for sign in (1, -1)]
        np.testing.assert_allclose(rows.dot(gamma), (sides[0] - sides[1]) / (2 * step), rtol=1e-4, atol=1e-6)


def test_roughness_is_zero_for_a_constant_and_positive_otherwise(space):
    p = space.roughness
    assert np.abs(p @ np.ones(space.parameters)).max() < 1e-12
    gamma = RNG.standard_normal(space.parameters)
    assert gamma @ (p @ gamma) > 0


def test_currents_beyond_the_range_count_as_on_its_edge(space):
    gamma = RNG.standard_normal(space.parameters)
    beyond = np.array([[400.0, 10.0], [-400.0, 400.0]])
    np.testing.assert_array_equal(space.rows(beyond).dot(gamma), space.rows(np.clip(beyond, LOW, HIGH)).dot(gamma))
    assert space.contains(beyond).tolist() == [False, False]
    assert space.contains(currents()).all()


def test_cells_are_finer_at_zero_current():
    edges = bent_edges(-300.0, 300.0, 16)
    widths = np.diff(edges)
    assert edges[0] == -300.0
    assert edges[-1] == 300.0
    np.testing.assert_allclose(widths, widths[::-1])
    assert widths[0] / widths[8] == pytest.approx(np.cosh(2.0), rel=0.15)


@pytest.mark.parametrize(("low", "high", "cells"), [(1.0, 1.0, 4), (0.0, np.inf, 4), (0.0, 1.0, 0)])
def test_an_empty_range_is_refused(low, high, cells):
    with pytest.raises(ConfigurationError, match="give low < high"):
        bent_edges(low, high, cells)
