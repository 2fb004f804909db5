"""The mask of a map and the covered share of the disc, against counts by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, spatial

from drive_id.core.maps.coverage import Visits, _dilated, disc_coverage, enclosed

AXIS = np.linspace(-10, 10, 21)


def at(*points, times=1):
    visits = Visits(AXIS, AXIS)
    visits.add(np.repeat(np.array(points, float), times, axis=0))
    return visits


def test_what_data_enclose_is_their_convex_hull():
    d, q = np.meshgrid(AXIS, AXIS, indexing="ij")
    ring = (np.hypot(d, q) <= 8.0) & (np.hypot(d, q) >= 6.0)
    np.testing.assert_array_equal(enclosed(ring), np.hypot(d, q) <= 8.0)
    half = ring & (q < 0)
    assert not enclosed(half)[q > 0].any()
    for few in (np.zeros_like(ring), (d == 1) & (q == 2), (d == 1) & (np.abs(q) < 3)):
        np.testing.assert_array_equal(enclosed(few), few)


@pytest.mark.parametrize("share", [0.01, 0.05, 0.3])
def test_the_hull_is_that_of_qhull(share):
    rng = np.random.default_rng(6)
    compared = 0
    for _ in range(60):
        mask = rng.random(rng.integers(3, 40, 2)) < share
        points = np.argwhere(mask)
        if len(points) < 3 or np.linalg.matrix_rank(points - points[0]) < 2:
            continue
        hull = spatial.Delaunay(points[spatial.ConvexHull(points).vertices])
        within = hull.find_simplex(np.argwhere(np.ones_like(mask)), tol=1e-9) >= 0
        np.testing.assert_array_equal(enclosed(mask), within.reshape(mask.shape) | mask)
        compared += 1
    assert compared > 20


def test_each_sample_counts_at_its_nearest_node():
    visits = at((0.4, 0.0), (0.6, 0.0), (-10.4, 10.4), (9.6, -9.6))
    assert visits.count.sum() == 4
    assert visits.count[10, 10] == 1
    assert visits.count[11, 10] == 1
    assert visits.count[0, 20] == 1
    assert visits.count[20, 0] == 1


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 1000), d=st.integers(2, 70), low=st.sampled_from([-1.0, -313.7, 0.1]))
def test_visits_are_numpys_histogram(seed, d, low):
    rng = np.random.default_rng(seed)
    visits = Visits(np.linspace(low, low + 7.3, d), np.linspace(-2, 2, 9))
    edges = [
        np.append(axis - (axis[1] - axis[0]) / 2, axis[-1] + (axis[1] - axis[0]) / 2)
        for axis in (visits.i_d, visits.i_q)
    ]
    i_dq = np.stack([rng.uniform(low - 1, low + 8, 400), rng.normal(size=400)], axis=-1)
    i_dq[: d + 1, 0], i_dq[d : d + 10, 1] = edges[0], edges[1][: len(i_dq[d : d + 10])]
    i_dq = np.vstack([i_dq, [[np.inf, 0.0], [0.0, -1e300]]])
    visits.add(i_dq)
    np.testing.assert_array_equal(visits.count, np.histogram2d(*i_dq.T, bins=edges)[0])


def test_samples_off_the_grid_are_left_out():
    assert at((10.6, 0.0), (0.0, -11.0), (1e30, 0.0)).count.sum() == 0


def test_the_order_of_axes_is_d_then_q():
    visits = Visits(np.linspace(-1, 1, 3), np.linspace(-10, 10, 5))
    visits.add(np.array([[1.0, -10.0]]))
    assert visits.count.shape == (3, 5)
    assert visits.count[2, 0] == 1
    assert visits.grid().shape == (3, 5, 2)
    np.testing.assert_array_equal(visits.grid()[2, 0], [1.0, -10.0])


def test_counts_add_up_over_parts():
    rng = np.random.default_rng(0)
    i_dq = rng.uniform(-10, 10, (1000, 2))
    whole, parts = Visits(AXIS, AXIS), Visits(AXIS, AXIS)
    whole.add(i_dq)
    for part in np.array_split(i_dq, 7):
        parts.add(part)
    np.testing.assert_array_equal(whole.count, parts.count)


def test_holes_up_to_the_size_of_a_hole_are_filled_and_larger_ones_are_not():
    ring = [(8 * np.cos(a), 8 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 400)]
    assert at(*ring).inside(18.0, 18.0)[10, 10]
    assert not at(*ring).inside(6.0, 6.0)[10, 10]


def test_nothing_is_added_outside_of_what_was_visited():
    box = [(d, q) for d in range(-5, 6) for q in range(-5, 6)]
    inside = at(*box).inside(6.0, 6.0)
    expected = (np.abs(AXIS) <= 5)[:, None] & (np.abs(AXIS) <= 5)
    np.testing.assert_array_equal(inside, expected)


def test_data_up_to_the_border_of_the_grid_are_kept():
    everywhere = [(d, q) for d in range(-10, 11) for q in range(-10, 11)]
    assert at(*everywhere).inside(6.0, 6.0).all()


def test_a_few_stray_samples_are_no_support():
    visits = at(*[(d, q) for d in range(-3, 4) for q in range(-3, 4)], times=100)
    visits.add(np.array([[9.0, 9.0]] * 5))
    assert not visits.inside(2.0, 2.0)[19, 19]
    visits.add(np.array([[9.0, 9.0]] * 50))
    assert visits.inside(2.0, 2.0)[19, 19]


def test_no_data_are_nowhere():
    assert not Visits(AXIS, AXIS).inside(4.0, 4.0).any()


@pytest.mark.parametrize("i_max", [5.0, 10.0])
def test_the_whole_disc(i_max):
    assert disc_coverage(AXIS, AXIS, np.ones((21, 21), bool), i_max) == 1.0
    assert disc_coverage(AXIS, AXIS, np.zeros((21, 21), bool), i_max) == 0.0


def test_half_of_the_disc():
    half = np.broadcast_to((AXIS < 0)[:, None], (21, 21))
    assert disc_coverage(AXIS, AXIS, half, 8.0) == pytest.approx(0.5, abs=0.05)


def test_a_grid_smaller_than_the_disc_covers_its_share():
    share = disc_coverage(AXIS, AXIS, np.ones((21, 21), bool), 20.0)
    assert share == pytest.approx(20 * 20 / (np.pi * 20**2), rel=0.05)


@given(seed=st.integers(0, 1000), shift=st.integers(-8, 8))
@settings(deadline=None, max_examples=30)
def test_the_mask_holds_the_visited_nodes_and_moves_with_them(seed, shift):
    axis = np.arange(-30.0, 31.0)
    points = np.random.default_rng(seed).integers(-8, 9, (60, 2)).astype(float)
    masks = []
    for offset in (0, shift):
        visits = Visits(axis, axis)
        visits.add(points + offset)
        masks.append(visits.inside(5.0, 7.0))
        assert masks[-1][visits.count > 0].all()
    np.testing.assert_array_equal(np.roll(masks[0], (shift, shift), (0, 1)), masks[1])


def test_the_covered_share_counts_points_by_their_nearest_node():
    """Point by point, with axes that do not reach the rim on one side."""
    i_d, i_q = np.linspace(-8.0, 6.1, 15), np.linspace(-9.0, 9.0, 13)
    inside = np.random.default_rng(4).random((15, 13)) < 0.6
    fine, covered, total = np.linspace(-7.7, 7.7, 201), 0, 0
    for x in fine:
        for y in fine[x * x + fine**2 <= 7.7**2]:
            total += 1
            on_grid = i_d[0] <= x <= i_d[-1] and i_q[0] <= y <= i_q[-1]
            covered += bool(on_grid and inside[np.argmin(abs(i_d - x)), np.argmin(abs(i_q - y))])
    assert disc_coverage(i_d, i_q, inside, 7.7) == pytest.approx(covered / total, abs=1e-4)


@pytest.mark.parametrize("scale", [1 - 1e-10, 1 + 1e-10])
@pytest.mark.parametrize("nodes", [41, 65, 97])
def test_the_mask_does_not_depend_on_rounding(nodes, scale):
    random = np.random.default_rng(nodes)
    differ = 0
    for _ in range(20):
        low, high = -random.uniform(1, 400), random.uniform(1, 400)
        i_dq = random.uniform(low, high, (800, 2))
        masks = []
        for factor in (1.0, scale):
            axis = np.linspace(factor * low, factor * high, nodes)
            visits = Visits(axis, axis)
            visits.add(factor * i_dq)
            masks.append(visits.inside(np.ptp(axis) / 16, np.ptp(axis) / 16))  # a whole number of nodes
        differ += bool((masks[0] != masks[1]).any())
    assert not differ


@given(seed=st.integers(0, 10**6), radii=st.tuples(st.floats(1, 9), st.floats(1, 9)), share=st.floats(0, 1))
def test_dilation(seed, radii, share):
    random = np.random.default_rng(seed)
    reach = [int(radius) for radius in radii]
    mask = np.pad(random.random(random.integers(1, 20, 2)) < share**2, [(r, r) for r in reach])
    grid = np.ogrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1]
    ball = (grid[0] / radii[0]) ** 2 + (grid[1] / radii[1]) ** 2 <= 1.0
    np.testing.assert_array_equal(_dilated(mask, ball), ndimage.binary_dilation(mask, structure=ball))
