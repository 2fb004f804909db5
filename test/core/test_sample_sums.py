"""The small kernels against what numpy says."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_id.core.matching import constant_shift
from drive_id.core.sample_sums import bend_square, count_visits, mark_rests
from drive_id.core.scans import all_finite, apart, rising


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 1000), d=st.integers(2, 70), low=st.sampled_from([-1.0, -313.7, 0.1]))
def test_visits_are_numpys_histogram(seed, d, low):
    rng = np.random.default_rng(seed)
    edges_d, edges_q = np.linspace(low, low + 7.3, d), np.linspace(-2, 2, 9)
    i_dq = np.stack([rng.uniform(low - 1, low + 8, 400), rng.normal(size=400)], axis=-1)
    i_dq[:d, 0], i_dq[d : d + 9, 1] = edges_d, edges_q[: len(i_dq[d : d + 9])]
    i_dq = np.vstack([i_dq, [[np.inf, 0.0], [0.0, -1e300]]])
    count = np.zeros((d - 1, 8), np.int64)
    count_visits(i_dq, edges_d, edges_q, count)
    np.testing.assert_array_equal(count, np.histogram2d(*i_dq.T, bins=[edges_d, edges_q])[0])


def test_rests_and_bends():
    i_dq = np.array([[0.0, 0], [0, 0], [5, 0], [0, 0], [0, 0], [0, 0], [0, 7]])
    idle = np.zeros(7, np.bool_)
    assert mark_rests(i_dq, 1.0, 1.0, 2.0, 0, idle) == 0
    assert idle.tolist() == [False] * 5 + [True, False]
    assert mark_rests(i_dq[:2], 1.0, 1.0, 2.0, 1, idle[:2]) == 3
    assert idle[:2].tolist() == [False, True]
    assert bend_square(i_dq) == np.sum(np.diff(i_dq, n=2, axis=0) ** 2)


def test_scans():
    assert all_finite(np.full((3, 2), 1e308))
    assert not all_finite(np.array([[1.0, np.nan]]))
    assert not all_finite(np.array([[np.inf, -np.inf]]))
    assert rising(np.array([1, 2, 3]))
    assert rising(np.array([1]))
    assert not rising(np.array([1, 2, 2]))
    assert apart(np.array([1, 2]), np.array([4, 5, 9]), 3)
    assert not apart(np.array([1, 2]), np.array([4, 6, 9]), 3)


def test_a_constant_shift_is_one_only_where_partners_are_certain():
    clock = 100 * np.arange(10)
    assert constant_shift(clock, clock + 40) == 40
    assert constant_shift(clock, clock + 60) is None
    assert constant_shift(clock, clock + 60, 40) == 60
    assert constant_shift(clock[:0], clock) is None
    assert constant_shift(clock, clock[:5]) is None
    later = clock + 3
    later[4] += 1
    assert constant_shift(clock, later) is None
