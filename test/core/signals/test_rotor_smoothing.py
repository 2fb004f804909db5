"""Encoder counts smoothed over their motion: closer to the truth, at ends and gaps, too."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.signals.rotor_smoothing import smoothed_rotor
from drive_id.core.signals.signal import Signal

PERIOD = 100_000
QUANTUM = 2 * np.pi * 4 / 4096


def motion(t):
    """Electrical angle and speed, whose speed swings by 5 % at 8 Hz."""
    return 300 * t + 0.3 * np.sin(50 * t), 300 + 15 * np.cos(50 * t)


def counted(kept):
    angle, speed = motion(kept * PERIOD * 1e-9)
    coarse = (np.floor(angle / QUANTUM) + 0.5) * QUANTUM
    return Signal("/enc", 7 + PERIOD * kept, np.angle(np.exp(1j * coarse))[:, None]), angle, speed


@pytest.mark.parametrize("kept", [np.arange(4000), np.delete(np.arange(4000), slice(1500, 1600))])
def test_counts_come_closer_to_the_motion(kept):
    signal, angle, speed = counted(kept)
    found, moved = smoothed_rotor(signal, 0.003)
    away = np.angle(np.exp(1j * (found.values[:, 0] - angle)))
    raw = np.angle(np.exp(1j * (signal.values[:, 0] - angle)))
    assert np.std(away) < 0.35 * np.std(raw)
    assert np.abs(away).max() < 1.2 * np.abs(raw).max()
    assert moved == pytest.approx(np.std(raw), rel=0.1)
    assert np.std(found.values[:, 1] - speed) < 0.01 * 300
    np.testing.assert_array_equal(found.stamp, signal.stamp)


def test_an_angle_that_is_exact_stays_and_short_ones_are_left_alone():
    k = np.arange(500)
    t = k * PERIOD * 1e-9
    parabola = 200 * t + 900 * t**2
    found, moved = smoothed_rotor(Signal("/enc", PERIOD * k, parabola[:, None]), 0.005)
    np.testing.assert_allclose(found.values, np.column_stack([parabola, 200 + 1800 * t]), rtol=1e-9, atol=1e-9)
    assert moved < 1e-12
    few = Signal("/enc", PERIOD * k[:20], parabola[:20, None])
    np.testing.assert_array_equal(smoothed_rotor(few, 0.005)[0].values[:, 0], parabola[:20])
