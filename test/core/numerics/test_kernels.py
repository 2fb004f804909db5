"""The compiled kernels against independent versions in numpy."""

from __future__ import annotations

import numpy as np
import numpy_oracles as oracles
import pytest
from exact_results import exact_map
from scipy import sparse

from drive_id.core.numerics import normal_equations, scans
from drive_id.core.validation import current_simulation


def test_scans():
    assert scans.all_finite(np.full((3, 2), 1e308))
    assert not scans.all_finite(np.array([[1.0, np.nan]]))
    assert not scans.all_finite(np.array([[np.inf, -np.inf]]))
    assert scans.rising(np.array([1, 2, 3]))
    assert scans.rising(np.array([1]))
    assert not scans.rising(np.array([1, 2, 2]))


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
    psi = np.random.default_rng(8).normal(size=(8, 7, 2))
    flux_map = exact_map(np.linspace(-10, 12, 8), np.linspace(-9, 9, 7), psi)
    (axes, table), (l_d, l_q) = current_simulation.flux_table(flux_map), flux_map.typical_inductances
    here, point = np.zeros(33), np.empty(8)
    current_simulation.turn_to(0.0, np.zeros(0), here)
    for i in np.random.default_rng(5).uniform(-14, 14, (50, 2)):
        current_simulation.evaluate(*i, here, axes, table, point)
        inside = np.clip(i, [-10, -9], [12, 9])
        psi = flux_map.continued(inside) + np.array([l_d, l_q]) * (i - inside)
        np.testing.assert_allclose(point[2:4], psi, atol=1e-12)
        by_d, by_q = flux_map.inductances(*inside).T
        by_d, by_q = (
            np.array([l_d, 0.0]) if i[0] != inside[0] else by_d,
            np.array([0.0, l_q]) if i[1] != inside[1] else by_q,
        )
        np.testing.assert_allclose(point[[4, 6]], by_d, atol=1e-12)
        np.testing.assert_allclose(point[[5, 7]], by_q, atol=1e-12)


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


@pytest.mark.parametrize("selects", [True, False])
def test_a_difference_of_triangles_is_formed_without_the_matrix(selects):
    """Selected columns are taken from the triangle; other combinations need the whole matrix."""
    rng, size = np.random.default_rng(8), 30
    total, part = (half + half.T for half in rng.standard_normal((2, size, size)))
    triangle = normal_equations.triangle_of(part)
    t = np.eye(size)[:, [0, 3, 4, *range(9, 29)]] if selects else rng.standard_normal((size, 11))
    out = np.full((len(t.T) + 2,) * 2, np.nan)
    normal_equations.normal_of_difference(sparse.csr_array(t), total, triangle, out[:-2, :-2])
    upper = np.triu_indices(len(t.T))
    np.testing.assert_allclose(out[upper], (t.T @ (total - part) @ t)[upper], rtol=1e-12, atol=1e-12)
    assert np.isnan(out[-2:]).all()
    assert np.isnan(out[:, -2:]).all()
    for count in (1, 7, size):
        np.testing.assert_array_equal(normal_equations.columns_of(triangle, size, count), part[:, :count])


def test_equations_solved_for_penalties_on_some_unknowns():
    rng, first = np.random.default_rng(9), 4
    root, moment = rng.standard_normal((40, 9)), rng.standard_normal(9)
    penalties = [np.diag(np.append(weight * rng.random(first), np.ones(5))) for weight in (0.1, 3.0)]
    upper = np.triu(root.T @ root)
    others = normal_equations.Eliminated.of(upper, moment, sparse.csr_array(penalties[0]), first)
    for penalty in penalties:
        expected = np.linalg.solve(root.T @ root + penalty, moment)
        np.testing.assert_allclose(others.solved(sparse.csr_array(penalty)), expected, rtol=1e-9)


def test_a_factor_of_two_blocks_is_that_of_the_whole():
    rng = np.random.default_rng(7)
    root, right = rng.standard_normal((40, 9)), rng.standard_normal((9, 3))
    normal, penalty = root.T @ root, sparse.csr_array(sparse.diags_array(rng.random(9)))
    whole, split = normal + penalty.toarray(), 6
    first, scale = normal_equations.factorize(normal[:split, :split], penalty[:split, :split])
    half = np.linalg.solve(first, normal[:split, split:] / scale[:, None])
    factor = normal_equations.Factor.extended(
        (first, scale), half, normal[split:, split:], sparse.csr_array(penalty[split:, split:])
    )
    np.testing.assert_allclose(factor.inverse(), np.linalg.inv(whole), rtol=1e-9)
    np.testing.assert_allclose(factor.back(factor.half(right)), np.linalg.solve(whole, right), rtol=1e-9)
    np.testing.assert_allclose(factor.half(right).T @ factor.half(right), right.T @ np.linalg.solve(whole, right))
    scaled = whole / factor.scale / factor.scale[:, None]
    np.testing.assert_allclose(factor.diagonal, np.diag(np.linalg.cholesky(scaled)), rtol=1e-9)


def test_quadratic_forms_of_sparse_rows_are_those_of_dense_ones():
    rng = np.random.default_rng(4)
    root, rows = rng.standard_normal((9, 9)), sparse.random_array((30, 9), density=0.4, rng=rng, format="csr")
    given = rows.indptr.astype(np.int32), rows.indices.astype(np.int32), rows.data
    expected = np.einsum("nk,kl,nl->n", rows.toarray(), root + root.T, rows.toarray())
    np.testing.assert_allclose(normal_equations.quadratic_forms(*given, root + root.T), expected, atol=1e-12)
