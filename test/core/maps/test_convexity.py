"""Hessians of co-energy splines against finite differences and scipy; the barrier method against multipliers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.optimize import nnls

from drive_id.core.maps.coenergy import GradientSpline
from drive_id.core.maps.convexity import HessianForms, barrier_minimum

LOW, HIGH = np.array([-3.0, -1.5]), np.array([2.0, 4.0])


def space(cells=3):
    return GradientSpline.within(LOW, HIGH, cells, 4).potential


def hessian(potential, w, i):
    """Return the Hessians (N, 2, 2) by scipy's splines."""
    net = w.reshape(potential.d.count, potential.q.count)

    def along(basis, x, order):
        spline = BSpline(basis.knots, np.eye(basis.count), 4)
        return spline.derivative(order)(x) if order else spline(x)

    def entry(order_d, order_q):
        return np.einsum("na,ab,nb->n", along(potential.d, i[:, 0], order_d), net, along(potential.q, i[:, 1], order_q))

    cross = entry(1, 1)
    return np.array([[entry(2, 0), cross], [cross, entry(0, 2)]]).transpose(2, 0, 1)


def test_the_coefficients_enclose_the_hessian_and_meet_it_at_the_corners():
    rng, potential = np.random.default_rng(1), space()
    forms, w = HessianForms.of(potential), rng.standard_normal(potential.parameters)
    bounds = forms.hessians(w)
    found = hessian(potential, w, rng.uniform(LOW, HIGH, (4000, 2)))
    for entry, values in zip(bounds, (found[:, 0, 0], found[:, 0, 1], found[:, 1, 1]), strict=True):
        assert entry.min() <= values.min() < values.max() <= entry.max()
        assert values.max() - values.min() > 0.3 * (entry.max() - entry.min())
    corner = hessian(potential, w, np.array([LOW, HIGH]))
    np.testing.assert_allclose(bounds[:, 0, 0], corner[0][[0, 0, 1], [0, 1, 1]], rtol=1e-9)
    np.testing.assert_allclose(bounds[:, -1, -1], corner[1][[0, 0, 1], [0, 1, 1]], rtol=1e-9)
    assert forms.least_eigenvalue(w) <= np.linalg.eigvalsh(found).min()


def test_the_bound_is_exact_for_a_paraboloid_and_tight_with_many_cells():
    coarse = HessianForms.of(space(2))
    assert coarse.least_eigenvalue(-1.7 * coarse.half_square) == pytest.approx(-1.7)
    potential = space(20)
    forms = HessianForms.of(potential)
    centres = [
        np.mean([basis.knots[1 + k : 1 + k + basis.count] for k in range(4)], axis=0)
        for basis in (potential.d, potential.q)
    ]
    w = np.cosh(0.5 * (centres[0][:, None] + 0.3 * centres[1])).ravel() + 0.1 * forms.half_square
    axes = [np.linspace(low, high, 120) for low, high in zip(LOW, HIGH, strict=True)]
    i = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    assert forms.least_eigenvalue(w) == pytest.approx(np.linalg.eigvalsh(hessian(potential, w, i)).min(), rel=0.02)


def test_derivatives_by_the_coefficients():
    rng, potential = np.random.default_rng(2), space(2)
    forms = HessianForms.of(potential)
    shape = forms.hessians(np.zeros(potential.parameters)).shape
    weights, root = rng.standard_normal(shape), rng.standard_normal((3, *shape))
    columns = np.array([forms.hessians(unit) for unit in np.eye(potential.parameters)])
    np.testing.assert_allclose(forms.pulled(weights), np.einsum("pkdq,kdq->p", columns, weights), atol=1e-9)
    square = np.einsum("rkdq,rmdq->kmdq", root, root)
    expected = np.einsum("pkdq,kmdq,omdq->po", columns, square, columns, optimize=True)
    np.testing.assert_allclose(forms.curvature(square), expected, atol=1e-9 * np.abs(expected).max())


def test_the_minimum_has_multipliers():
    """At the minimum of a convex problem, the gradient is a non-negative sum of those of the binding constraints."""
    rng, potential = np.random.default_rng(3), space(2)
    forms, count = HessianForms.of(potential), potential.parameters
    root = rng.standard_normal((count, count))
    normal, wanted = root @ root.T / count + 0.1 * np.eye(count), 0.6 * rng.standard_normal(count)
    least = 0.2
    assert forms.least_eigenvalue(wanted) < -1
    found = barrier_minimum(normal, normal @ wanted, forms, wanted, 1.0, least, 1e-9)
    assert forms.least_eigenvalue(found) > least
    a, b, c = forms.hessians(found)
    values, vectors = np.linalg.eigh(np.array([[a, b], [b, c]]).transpose(2, 3, 0, 1))
    binding = np.argwhere(values[..., 0] - least < 1e-4)
    assert 3 < len(binding) < forms.matrices / 2
    columns = []
    for d, q in binding:
        x, y = vectors[d, q, :, 0]
        weights = np.zeros((3, *a.shape))
        weights[:, d, q] = x**2, 2 * x * y, y**2
        columns.append(forms.pulled(weights))
    gradient = normal @ (found - wanted)
    _, rest = nnls(np.array(columns).T, gradient)
    assert rest < 1e-3 * np.linalg.norm(gradient)


def test_a_start_that_is_convex_and_best_stays():
    potential = space(1)
    forms = HessianForms.of(potential)
    best = 2.0 * forms.half_square
    found = barrier_minimum(np.eye(len(best)), best, forms, 3.0 * forms.half_square, 1.0, 0.1, 1e-10)
    np.testing.assert_allclose(found, best, atol=1e-4)
