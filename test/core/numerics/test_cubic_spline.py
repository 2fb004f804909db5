"""Splines as dense matrices, and the closing of a mask, against scipy, which they spare the start of a program."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.interpolate import BSpline, make_interp_spline

from drive_id.core.maps.coverage import _dilated
from drive_id.core.numerics.bspline import basis_matrix, interpolation_matrix


@given(seed=st.integers(0, 10**6), inner=st.integers(0, 12))
def test_basis(seed, inner):
    random = np.random.default_rng(seed)
    knots = np.sort(random.uniform(-3, 7, inner + 8))
    points = np.append(random.uniform(knots[3], knots[-4], 100), [knots[3], knots[-4], *knots[3:-4]])
    expected = BSpline.design_matrix(points, knots, 3).toarray()
    np.testing.assert_allclose(basis_matrix(points, knots), expected, atol=1e-13)


@pytest.mark.parametrize("count", [4, 5, 6, 40])
def test_interpolation(count):
    random = np.random.default_rng(count)
    nodes = np.cumsum(random.uniform(0.5, 1.5, count))
    values, points = random.normal(size=(count, 3)), np.append(random.uniform(nodes[0], nodes[-1], 200), nodes)
    expected = make_interp_spline(nodes, values, k=3)(points)
    np.testing.assert_allclose(interpolation_matrix(nodes, points) @ values, expected, atol=1e-12)


@given(seed=st.integers(0, 10**6), radii=st.tuples(st.floats(1, 9), st.floats(1, 9)), share=st.floats(0, 1))
def test_dilation(seed, radii, share):
    random = np.random.default_rng(seed)
    reach = [int(radius) for radius in radii]
    mask = np.pad(random.random(random.integers(1, 20, 2)) < share**2, [(r, r) for r in reach])
    grid = np.ogrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1]
    ball = (grid[0] / radii[0]) ** 2 + (grid[1] / radii[1]) ** 2 <= 1.0
    np.testing.assert_array_equal(_dilated(mask, ball), ndimage.binary_dilation(mask, structure=ball))
