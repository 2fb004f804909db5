"""Trajectories stay in their disc, are no steeper than they say, and close."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_id.core.experiment.trajectories import Lissajous, Spiral, Stair, Trajectory
from drive_id.errors import ConfigurationError

radii = st.floats(1e-3, 1e6)
frequencies = st.floats(0.0, 100.0)
trajectories = st.one_of(
    st.builds(Lissajous, radii, frequencies, frequencies, st.sampled_from(["smooth", "printed"])),
    st.builds(Stair, radii, st.integers(3, 15), st.floats(1e-3, 1.0), st.floats(1.0, 1e6)),
    st.builds(Spiral, radii, st.floats(0.5, 50.0), st.floats(1e-2, 100.0)),
)


@given(trajectories, st.floats(0.0, 1000.0))
def test_in_the_disc_and_no_steeper_than_it_says(trajectory: Trajectory, begin: float):
    step = 1e-4
    i_dq = trajectory(begin + np.arange(500) * step)
    assert i_dq.shape == (500, 2)
    assert np.hypot(*i_dq.T).max() <= trajectory.i_max * (1 + 1e-12)
    # Times near 1000 s have a quantum of 1e-13 s.
    assert np.hypot(*np.diff(i_dq, axis=0).T).max() <= trajectory.slope * step * (1 + 1e-6) + 1e-9 * trajectory.i_max


@given(trajectories)
def test_they_begin_at_zero_current_and_repeat(trajectory: Trajectory):
    np.testing.assert_allclose(trajectory(np.zeros(1)), 0.0, atol=1e-12 * trajectory.i_max)
    if math.isfinite(trajectory.duration):
        t = np.linspace(0.0, trajectory.duration, 7, endpoint=False)
        # One quantum of time is this much way.
        slack = 1e-9 * trajectory.i_max + trajectory.slope * trajectory.duration * 1e-14
        np.testing.assert_allclose(trajectory(t + trajectory.duration), trajectory(t), atol=slack)


def test_the_slope_of_the_lissajous_is_reached():
    for form in ("smooth", "printed"):
        trajectory = Lissajous(30.0, 5.0, 0.7, form)
        steepest = np.hypot(*np.diff(trajectory(np.arange(100_000) * 1e-4), axis=0).T).max() / 1e-4
        assert steepest == pytest.approx(trajectory.slope, rel=1e-3)


def test_the_stair_visits_every_point_and_stays():
    stair = Stair(10.0, 5, 0.1, 1000.0)
    points = stair.operating_points
    assert len(points) == 13  # of 25, those within the circle
    i_dq = stair(np.arange(round(stair.duration / 1e-4)) * 1e-4)
    for point in points:
        stays = np.all(np.abs(i_dq - point) < 1e-9, axis=1)
        assert 999 <= stays.sum() <= 1003
    ways = np.hypot(*np.diff(np.concatenate(([[0, 0]], points, [[0, 0]])), axis=0).T)
    assert stair.duration == pytest.approx(13 * 0.1 + ways.sum() / 1000.0)


def test_the_spiral_fills_the_disc():
    spiral = Spiral(10.0, 10.0, 4.0)
    i_dq = spiral(np.linspace(0, 4, 40_000))
    assert np.hypot(*i_dq.T).max() == pytest.approx(10.0, rel=1e-3)
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    for radius in (1.0, 5.0, 9.0):
        rim = radius * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        nearest = np.min(np.hypot(*(i_dq[:, None, :] - rim).transpose(2, 0, 1)), axis=0)
        assert nearest.max() < 1.0  # half the distance between turns, twice passed


def test_impossible_ones_are_refused():
    for make in (lambda: Stair(points=2), lambda: Spiral(duration=0.0), lambda: Lissajous(i_max=math.nan)):
        with pytest.raises(ConfigurationError):
            make()
