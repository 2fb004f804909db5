"""The compiled kernels against independent versions in numpy."""

from __future__ import annotations

import numpy as np
import numpy_oracles as oracles
import pytest
from scipy import sparse

from drive_id.core.full import model as full_model
from drive_id.core.maps import flux_models
from drive_id.core.maps.flux_models import Polynomial, TensorSpline
from drive_id.core.numerics import bspline, normal_equations, scans
from drive_id.core.numerics.bspline import Axis
from drive_id.core.paper import rows as paper_rows
from drive_id.core.validation import current_simulation

MODEL = TensorSpline(Axis(-10.0, 12.0, 8), Axis(-9.0, 9.0, 7))


def currents(count=500):
    """Return currents within and beyond the model's range, at its edges and at knots."""
    random = np.random.default_rng(5).uniform(-14, 14, (count, 2))
    special = np.array([[-10.0, -9.0], [12.0, 9.0], [-10.0 + 22 / 5, -9.0 + 18 / 4], [np.nan, 0.0], [np.inf, -np.inf]])
    return np.concatenate([random, special])


@pytest.mark.parametrize("order", [(0, 0), (1, 0), (0, 1)])
def test_spline_rows(order):
    i_dq = currents()
    rows = MODEL._rows(i_dq, *order)
    axes = np.array([[MODEL.d.low, MODEL.d.width], [MODEL.q.low, MODEL.q.width]])
    column, value = np.empty_like(rows.column), np.empty_like(rows.value)
    oracles.tensor_rows(i_dq, axes, MODEL.d.count, MODEL.q.count, *order, column, value)
    ours = flux_models.BasisRows(column, value).dense(MODEL.parameters)
    np.testing.assert_allclose(ours, rows.dense(MODEL.parameters), rtol=0, atol=1e-14)


@pytest.mark.parametrize("model", [MODEL, Polynomial(3, 10.0)])
def test_cross_products_of_rows(model):
    random = np.random.default_rng(6)
    t = np.linspace(0, 20, 3001)
    rows = model.rows(np.stack([9 * np.cos(t), 8 * np.sin(1.3 * t)], axis=-1))
    known, half_turn, valid = random.normal(size=(3000, 2, 3)), random.normal(size=3000), random.random(3000) < 0.8
    grams = [np.ones((3 + model.parameters, 3 + model.parameters)) for _ in range(2)]
    for add, gram in zip((paper_rows.add_rows, oracles.add_rows), grams, strict=True):
        add(known, half_turn, valid, rows.column, rows.value, gram)
    np.testing.assert_allclose(grams[1], grams[0], rtol=0, atol=1e-12 * np.abs(grams[0]).max())


@pytest.mark.parametrize("rest", [0, 3, 50])
@pytest.mark.parametrize("count", [0, 1, 400])
def test_rests(rest, count):
    i_dq = np.where(np.random.default_rng(7).random((count, 1)) < 0.2, 5.0, 0.1) * np.ones(2)
    marks = [np.zeros(count, np.bool_) for _ in range(2)]
    ends = [
        mark_rests(i_dq, 1.0, 0.1, 0.65, rest, idle)
        for mark_rests, idle in zip((scans.mark_rests, oracles.mark_rests), marks, strict=True)
    ]
    assert ends[0] == ends[1]
    np.testing.assert_array_equal(*marks)


def test_the_map_that_a_simulation_uses_is_the_spline_continued():
    gamma = np.random.default_rng(8).normal(size=MODEL.parameters)
    axes, table = current_simulation.flux_table(MODEL, [gamma], (1.0, 2.0))
    here, point = np.zeros(33), np.empty(8)
    current_simulation.turn_to(0.0, np.zeros(0), here)
    for i in currents(50)[:50]:
        current_simulation.evaluate(*i, here, axes, table, point)
        inside = np.clip(i, [-10, -9], [12, 9])
        psi = MODEL.rows(inside[None]).dot(gamma)[0] + np.array([1.0, 2.0]) * (i - inside)
        np.testing.assert_allclose(point[2:4], psi, atol=1e-13)
        by_d, by_q = (rows.dot(gamma)[0] for rows in MODEL.slope_rows(inside[None]))
        by_d, by_q = (
            np.array([1.0, 0.0]) if i[0] != inside[0] else by_d,
            np.array([0.0, 2.0]) if i[1] != inside[1] else by_q,
        )
        np.testing.assert_allclose(point[[4, 6]], by_d, atol=1e-12)
        np.testing.assert_allclose(point[[5, 7]], by_q, atol=1e-12)


@pytest.mark.parametrize("degree", [0, 1, 3, 4])
def test_splines_on_bent_cells(degree):
    edges = np.array([-3.0, -1.0, -0.25, 0.5, 2.0, 4.0])
    knots = np.concatenate([np.full(degree, edges[0]), edges, np.full(degree, edges[-1])])
    x = np.concatenate([np.random.default_rng(3).uniform(-4.0, 5.0, 200), edges])
    found = []
    for evaluate in (bspline.spline_values, oracles.spline_values):
        cell, w = np.empty(len(x), np.int64), np.empty((len(x), degree + 1))
        evaluate(x, knots, degree, cell, w)
        found.append((cell, w))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-13, atol=1e-15)


def test_products_and_ends_of_windows():
    rng = np.random.default_rng(4)
    cells, factors = rng.integers(0, 3, (2, 50)), rng.standard_normal((2, 50, 3))
    tables = []
    for multiply in (bspline.tensor_products, oracles.tensor_products):
        column, value = np.empty((50, 2, 9), np.int32), np.empty((50, 2, 9))
        multiply(cells[0], factors[0], cells[1], factors[1], 6, 0, column[:, 0], value[:, 0])
        multiply(cells[1], factors[1], cells[0], factors[0], 6, 36, column[:, 1], value[:, 1])
        tables.append((column, value))
    np.testing.assert_array_equal(tables[0][0], tables[1][0])
    np.testing.assert_allclose(tables[0][1], tables[1][1], rtol=1e-15)
    turn, factor = rng.standard_normal((50, 2)), rng.standard_normal((2, 50))
    t = sparse.random_array((150, 40), density=0.05, format="csr", rng=rng)
    before = rng.standard_normal((50, 2, 40))
    forms = [before.copy(), before.copy()]
    for add, out in zip((full_model.add_end, oracles.add_end), forms, strict=True):
        add(*tables[0], turn, np.array([0, 72]), factor, t.indptr, t.indices, t.data, out)
    np.testing.assert_allclose(forms[0], forms[1], rtol=1e-12, atol=1e-12)


def test_blocks_of_a_triangle():
    rng = np.random.default_rng(5)
    root, before = rng.standard_normal((4, 4)), rng.standard_normal((9, 9))
    columns, total = np.array([1, 2, 5, 8]), before + before.T
    triangle = normal_equations.triangle_of(total)
    normal_equations.add_triangle(root @ root.T, columns, triangle)
    total[np.ix_(columns, columns)] += root @ root.T
    np.testing.assert_allclose(normal_equations.unpacked(triangle, 9), total, rtol=1e-14)


@pytest.mark.parametrize("size", [1, 255, 257, 700])
def test_a_triangle_is_unpacked_to_the_symmetric_matrix(size):
    half = np.random.default_rng(size).standard_normal((size, size))
    matrix = half + half.T
    np.testing.assert_array_equal(normal_equations.unpacked(normal_equations.triangle_of(matrix), size), matrix)


@pytest.mark.parametrize("weight", [1.0, -0.5])
def test_a_congruent_matrix_by_selection_and_by_products(weight):
    """Columns of T with one entry select; those with several, or none, do not."""
    rng = np.random.default_rng(6)
    half = rng.standard_normal((14, 14))
    several, one = np.kron(np.eye(2), np.ones((3, 1))), weight * np.eye(8, 7, k=-1)
    t = sparse.csr_array(sparse.block_diag([one, several, np.zeros((0, 1))]))
    expected = t.toarray().T @ (half + half.T) @ t.toarray()
    np.testing.assert_allclose(normal_equations.congruent(t, half + half.T), expected, rtol=1e-12, atol=1e-12)
    whole = sparse.csr_array(rng.standard_normal((14, 5)))
    expected = whole.toarray().T @ (half + half.T) @ whole.toarray()
    np.testing.assert_allclose(normal_equations.congruent(whole, half + half.T), expected, rtol=1e-12, atol=1e-12)


def test_the_inverse_comes_from_the_factor():
    rng = np.random.default_rng(7)
    root = rng.standard_normal((40, 9))
    penalty = sparse.csr_array(sparse.diags_array(rng.random(9)))
    whole = root.T @ root + penalty.toarray()
    inverse = normal_equations.inverse_of(*normal_equations.factorize(root.T @ root, penalty))
    np.testing.assert_allclose(inverse, np.linalg.inv(whole), rtol=1e-9)
