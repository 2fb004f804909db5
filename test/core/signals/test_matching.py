"""Partners of samples, and the offset between two signals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_id.core.signals.matching import Phase, nearest, partners

INCREASING = st.lists(st.integers(1, 300), min_size=1, max_size=40).map(np.cumsum)


@settings(max_examples=200, deadline=None)
@given(INCREASING, INCREASING, st.integers(-400, 400))
def test_partners_are_the_nearest(clock, stamp, offset):
    index, found = partners(clock, stamp, offset, 100.0)
    np.testing.assert_array_equal(index, nearest(clock + offset, stamp))
    assert (np.abs(stamp[index] - clock - offset)[found] <= 50).all()
    assert (np.diff(index[found]) > 0).all()


@settings(max_examples=50, deadline=None)
@given(INCREASING, INCREASING)
def test_the_phase_is_the_mean_direction_of_the_distances_within_a_period(clock, stamp):
    phase, away = Phase.of(clock, stamp, 100.0), stamp[nearest(clock, stamp)] - clock
    away = away[np.abs(away) <= 100]
    assert phase.count == len(away)
    assert phase.total == pytest.approx(np.exp(2j * np.pi * away / 100.0).sum(), abs=1e-9)


def test_the_phase_of_a_constant_offset():
    clock = 100 * np.arange(1000)
    assert Phase.of(clock, clock + 20, 100.0).total == pytest.approx(1000 * np.exp(0.4j * np.pi), rel=1e-12)
    assert Phase.of(clock, clock + 20, 100.0).offset(100.0, "this", "that") == 20
    assert Phase.of(clock, np.array([10**6]), 100.0) == Phase()
