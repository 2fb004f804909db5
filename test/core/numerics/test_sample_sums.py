"""The small kernels against what numpy says."""

from __future__ import annotations

import numpy as np

from drive_id.core.numerics.scans import all_finite, rising


def test_scans():
    assert all_finite(np.full((3, 2), 1e308))
    assert not all_finite(np.array([[1.0, np.nan]]))
    assert not all_finite(np.array([[np.inf, -np.inf]]))
    assert rising(np.array([1, 2, 3]))
    assert rising(np.array([1]))
    assert not rising(np.array([1, 2, 2]))
