"""The small kernels against what numpy says."""

from __future__ import annotations

import numpy as np

from drive_id.core.numerics.scans import all_finite, mark_rests, rising


def test_rests():
    i_dq = np.array([[0.0, 0], [0, 0], [5, 0], [0, 0], [0, 0], [0, 0], [0, 7]])
    idle = np.zeros(7, np.bool_)
    assert mark_rests(i_dq, 1.0, 1.0, 2.0, 0, idle) == 0
    assert idle.tolist() == [False] * 5 + [True, False]
    assert mark_rests(i_dq[:2], 1.0, 1.0, 2.0, 1, idle[:2]) == 3
    assert idle[:2].tolist() == [False, True]


def test_scans():
    assert all_finite(np.full((3, 2), 1e308))
    assert not all_finite(np.array([[1.0, np.nan]]))
    assert not all_finite(np.array([[np.inf, -np.inf]]))
    assert rising(np.array([1, 2, 3]))
    assert rising(np.array([1]))
    assert not rising(np.array([1, 2, 2]))
