"""The largest values of a stream: exact quantiles, exact ranges of all others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_id.core.numerics.largest import Largest


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 3000),
    seed=st.integers(0, 1000),
    kept=st.sampled_from([5, 40, 5000]),
    part=st.sampled_from([1, 7, 500]),
    share=st.sampled_from([0.999, 1.0]),
    few=st.booleans(),
)
def test_quantiles_near_the_top_are_those_of_all_values(n, seed, kept, part, share, few):
    rng = np.random.default_rng(seed)
    value = rng.integers(0, 9, n).astype(float) if few else rng.normal(size=n)
    rows = np.column_stack([value, rng.normal(size=n), np.arange(n)])
    largest = Largest(2, kept)
    for start in range(0, n, part):
        largest.add(rows[start : start + part])
    assert largest.count == n
    assert largest.quantile(share) == pytest.approx(np.quantile(value, share), rel=1e-14, abs=1e-14)
    found = largest.rows()
    assert len(found) == min(n, max(kept, 0))
    np.testing.assert_array_equal(np.sort(found[:, 0]), np.sort(value)[n - len(found) :])
    np.testing.assert_array_equal(found, rows[found[:, 2].astype(int)])
    out = np.setdiff1d(np.arange(n), found[:, 2].astype(int))
    np.testing.assert_array_equal(largest.low, rows[out, 1:].min(axis=0, initial=np.inf))
    np.testing.assert_array_equal(largest.high, rows[out, 1:].max(axis=0, initial=-np.inf))


def test_below_what_is_kept_the_least_of_it_is_said():
    largest = Largest(0, 10)
    largest.add(np.arange(100.0)[:, None])
    assert largest.quantile(0.5) == 90.0
