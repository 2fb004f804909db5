"""An angle of another rate at the times of the currents, on a motion that is known."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.signals.rotor_interpolation import interpolated_rotor
from drive_id.core.signals.signal import Signal
from drive_id.errors import DataError

START = 1_700_000_000_000_000_007


def motion(t):
    """Electrical angle and speed of a rotor whose speed swings by 10 % at 25 Hz."""
    angle = 400 * t + 0.25 * np.sin(160 * t)
    return angle, 400 + 40 * np.cos(160 * t)


def rotor(rate, *, with_speed, seconds=1.0, noise=0.0):
    stamp = START + np.rint(np.arange(0, seconds, 1 / rate) * 1e9).astype(np.int64)
    angle, speed = motion((stamp - START) * 1e-9)
    angle = np.angle(np.exp(1j * (angle + noise * np.random.default_rng(0).normal(size=len(angle)))))
    return Signal("/enc", stamp, np.column_stack([angle, speed] if with_speed else [angle]))


@pytest.mark.parametrize("with_speed", [True, False])
@pytest.mark.parametrize("rate", [977.0, 4000.0, 33_000.0])
def test_the_angle_between_samples_is_that_of_the_motion(rate, with_speed):
    clock = START + 3_333 + 100_000 * np.arange(9_900)
    found = interpolated_rotor(rotor(rate, with_speed=with_speed), clock)
    at = (found.signal.stamp - START) * 1e-9
    angle, speed = motion(at)
    away = found.signal.values[:, 0] - angle
    away -= 2 * np.pi * np.rint(away[len(away) // 2] / (2 * np.pi))
    assert np.sqrt(np.mean(away**2)) <= found.error
    assert np.abs(away[50:-50]).max() < 2e-5
    np.testing.assert_allclose(found.signal.values[50:-50, 1], speed[50:-50], rtol=2e-3)
    np.testing.assert_array_equal(found.signal.stamp, clock[clock <= rotor(rate, with_speed=True).stamp[-1]])


@pytest.mark.parametrize(("rate", "noise"), [(2000.0, 1e-3), (700.0, 3e-3), (400.0, 0.0), (250.0, 0.0)])
def test_the_estimated_error_is_that_of_the_interpolation(rate, noise):
    clock = START + 50_000 * np.arange(18_000)
    found = interpolated_rotor(rotor(rate, with_speed=False, noise=noise), clock)
    angle, _ = motion((found.signal.stamp - START) * 1e-9)
    away = found.signal.values[:, 0] - angle
    true = np.std(away)
    assert true < found.error < (1.8 if noise else 8) * true


def test_gaps_are_not_bridged_and_a_coarse_angle_needs_its_speed():
    signal = rotor(1000.0, with_speed=True)
    kept = np.delete(np.arange(1000), slice(400, 450))
    cut = Signal("/enc", signal.stamp[kept], signal.values[kept])
    clock = START + 100_000 * np.arange(9_000)
    stamps = interpolated_rotor(cut, clock).signal.stamp - START
    assert not ((stamps > 399_000_000) & (stamps < 450_000_000)).any()
    assert (stamps < 399_000_000).sum() == 3990
    slow = rotor(130.0, with_speed=False)
    with pytest.raises(DataError, match="degrees electrical between its samples"):
        interpolated_rotor(slow, clock)
    with_speed = interpolated_rotor(rotor(130.0, with_speed=True), clock)
    angle, _ = motion((with_speed.signal.stamp - START) * 1e-9)
    assert np.abs(with_speed.signal.values[:, 0] - angle).max() < 0.1
    with pytest.raises(DataError, match="too few"):
        interpolated_rotor(Signal("/enc", signal.stamp[:3], signal.values[:3]), clock)


@pytest.mark.parametrize("with_speed", [True, False])
def test_samples_in_any_order_and_repeated_ones_give_the_same(with_speed):
    whole = rotor(4000.0, with_speed=with_speed)
    clock = START + 3_333 + 100_000 * np.arange(9_900)
    wanted = interpolated_rotor(whole, clock)
    order = np.append(np.arange(len(whole.stamp))[::-1], [17, 17, 900])
    found = interpolated_rotor(Signal("/enc", whole.stamp[order], whole.values[order]), clock)
    np.testing.assert_array_equal(found.signal.values, wanted.signal.values)
