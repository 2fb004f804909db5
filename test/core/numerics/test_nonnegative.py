"""Nonnegative least squares against scipy's, which a fit does not load."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from drive_id.core.numerics.normal_equations import nonnegative


@pytest.mark.parametrize("seed", range(10))
def test_shares_of_cells_are_those_of_scipy(seed):
    """As in a misfit by cell: each row counts the cells of both axes, so that the columns depend on each other."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, 8, (500, 2, 2))
    counts = [(cells[:, axis, :, None] == np.arange(8)).sum(axis=1) for axis in (0, 1)]
    rows = np.concatenate([*counts, np.ones((500, 1))], axis=1)
    right = rows @ np.maximum(rng.normal(size=17), 0.0) + rng.normal(size=500)
    found = nonnegative(rows.T @ rows, rows.T @ right)
    np.testing.assert_allclose(found, nnls(rows, right)[0], atol=1e-9)
    assert np.any(found == 0.0)
