"""Operating points at a low rate: right where current and resolver are sampled at other times, and never too many."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.signals.signal import Signal
from drive_id.live.identification.operating_points import PointDecimator

PERIOD = 1e-4
SPEED = 700.0  # rad/s
START = 1_700_000_000_000_000_000


def angle_at(t):
    return SPEED * t + 0.3


def dq_at(t):
    return 30.0 * np.cos(9.0 * t) - 12.0, 20.0 * np.sin(7.0 * t) + 5.0


def block(section, first, size, shift=0.0):
    """A block of currents (0) or resolver (2) whose samples lie ``shift`` s behind the clock."""
    t = PERIOD * (first + np.arange(size)) + shift
    stamp = START + np.rint(t * 1e9).astype(np.int64)
    if section == 2:
        wrapped = np.angle(np.exp(1j * angle_at(t)))
        return Signal("resolver", stamp, np.stack([wrapped, np.full(size, SPEED)], axis=-1), PERIOD)
    i_d, i_q = dq_at(t)
    turned = (i_d + 1j * i_q) * np.exp(1j * angle_at(t))
    return Signal(
        "currents", stamp, np.stack([(turned * np.exp(-2j * np.pi * k / 3)).real for k in range(3)], -1), PERIOD
    )


def played(rate, seconds, size, shift=0.0, every=1):
    """All points, looked for after every so many blocks."""
    points, found = PointDecimator(rate), []
    for number in range(round(seconds / PERIOD / size)):
        points.add(0, block(0, number * size, size))
        points.add(1, block(0, number * size, size))
        points.add(2, block(2, number * size, size, shift))
        if number % every == every - 1:
            found += points.take()
    return found


@pytest.mark.slow  # the slow oracle
@pytest.mark.parametrize(("size", "every"), [(1, 50), (7, 3), (100, 1), (1000, 1), (5000, 1)])
def test_each_point_is_that_of_its_stamp(size, every):
    found = played(50.0, 2.0, size, 0.4 * PERIOD, every)
    t = np.array([(point.stamp - START) * 1e-9 for point in found])
    i_d, i_q = dq_at(t)
    np.testing.assert_allclose([point.i_d for point in found], i_d, atol=1e-6)
    np.testing.assert_allclose([point.i_q for point in found], i_q, atol=1e-6)
    assert {point.speed for point in found} == {SPEED}
    assert 98 <= len(found) <= 101
    assert np.diff(t).min() > 0.015
    assert np.diff(t).max() < 0.025 + size * PERIOD * (size > 200)


def test_a_long_silence_yields_no_flood():
    points = PointDecimator(1000.0)
    for number in range(300):
        points.add(0, block(0, number * 100, 100))
        points.add(2, block(2, number * 100, 100))
    assert len(points.take()) == 50
    assert points.take() == []


def test_nothing_without_a_rate_a_partner_or_listeners():
    assert played(0.0, 0.1, 100) == []
    points = PointDecimator(50.0)
    points.add(0, block(0, 0, 100))
    assert points.take() == []
    points.add(2, block(2, 0, 100))
    points.clear()
    assert points.take() == []


def test_nan_samples_are_left_out_and_a_clock_that_is_set_back_begins_anew():
    points = PointDecimator(50.0)
    spoiled = block(0, 0, 1000)
    spoiled.values[:, 1] = np.nan
    points.add(0, spoiled)
    points.add(2, block(2, 0, 1000))
    assert points.take() == []
    points = PointDecimator(50.0)
    for first in (10**6, 0):
        points.add(0, block(0, first, 1000))
        points.add(2, block(2, first, 1000))
        assert len(points.take()) >= 5, first
