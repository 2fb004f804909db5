"""The free shaft: the current stays in the disc, the mean speed is held with references ahead of time, trips work."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import j1
from supervised_cell import Cell

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.experiment.free_shaft import FreeShaft, MeanSpeed, RotatingVector, swing_frequency
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.state_machine import ExperimentState
from drive_id.errors import ConfigurationError

ELECTRICAL = 4 * math.pi / 30
"""rad/s per rpm of the machine ipm."""


@pytest.mark.parametrize("frequency", [5.0, 13.7, 60.0])
@pytest.mark.parametrize("bias", [0.0, 0.2, -0.35])
def test_the_figure_stays_in_the_disc_within_its_slope_and_leaves_the_mean_that_is_asked_for(frequency, bias):
    figure = FreeShaft(100.0, frequency, 3.0)
    t = np.arange(round(figure.duration * 1e5) + 1) * 1e-5
    i_dq = figure(t[:-1], bias)
    assert np.hypot(*i_dq.T).max() <= 100.0 * (1 + 1e-12)
    assert np.hypot(*np.diff(i_dq, axis=0).T).max() <= figure.slope * 1e-5
    np.testing.assert_allclose(i_dq[[0, -1]], 0.0, atol=1e-1)
    full = (t[:-1] >= figure.ramp_time) & (t[:-1] < figure.duration - figure.ramp_time)
    assert i_dq[full, 1].mean() == pytest.approx(100.0 * j1(2 * bias), abs=0.02)
    if bias == 0.0:
        assert abs(i_dq[:, 1].mean()) < 0.01  # neither do the ramps drive the shaft


def test_the_mean_speed_is_that_of_whole_periods_also_across_turns_and_begins_anew_after_a_gap():
    mean = MeanSpeed(7.0)
    t = np.arange(10_000) * 1e-4
    angle = 83.0 * t + 2.5 * np.sin(2 * np.pi * 7.0 * t)
    wrapped = (np.mod(angle + np.pi, 2 * np.pi) - np.pi).astype(np.float32)
    for k in range(0, 5000, 100):
        mean.add(k, 1e-4, wrapped[k : k + 100])
    assert mean.value == pytest.approx(83.0, abs=0.2)
    mean.add(6000, 1e-4, wrapped[6000:6100])
    assert math.isnan(mean.value)


def test_the_frequency_gives_the_swing_that_fits():
    assert 8000.0 / (2 * math.pi * swing_frequency(8000.0, 200.0, 80.0)) == pytest.approx(0.85 * 120.0)
    assert swing_frequency(10.0, 200.0) == 5.0
    with pytest.raises(ConfigurationError, match="nothing is left for the swing"):
        swing_frequency(8000.0, 200.0, 200.0)


def test_the_vector_turns_as_far_back_as_forwards():
    vector = RotatingVector(10.0)
    t = np.arange(round(vector.duration * 1e4)) * 1e-4
    values = vector(t)
    assert np.hypot(*np.diff(values, axis=0).T).max() <= vector.slope * 1e-4 * (1 + 1e-9)
    assert not values[t < 0.5].any()
    angle = np.unwrap(np.angle(values[:, 0] + 1j * values[:, 1]))
    assert np.ptp(angle) == pytest.approx(2 * np.pi * vector.turns, rel=1e-3)
    assert angle[-1] == pytest.approx(angle[0], abs=1e-6)


def cell_of(drive=None, **settings):
    drive = {"free_shaft": True, "current_noise": 0.001, "speed_observer": 100.0} | (drive or {})
    settings = {"trajectory": "free_shaft", "i_max": 300.0, "slew_rate": 2e5, "duration": 8.0} | settings
    return Cell(machine_map("ipm"), SimulationSettings(**drive), ExperimentSettings(**settings))


# The largest torque of the machine accelerates it by 4000 rad/s^2 (mechanical), 16000 rad/s^2 electrical.
BAND = {"shaft_acceleration": 14_000.0, "shaft_speed_max": 1400 * ELECTRICAL}


@pytest.mark.accuracy
def test_a_swing_about_standstill_stays_in_its_band():
    cell = cell_of(**BAND)
    report = cell.run()
    assert report.state is ExperimentState.IDLE, report.reason
    assert report.coverage > 0.8
    assert max(cell.speeds) < 1.1 * cell.settings.shaft_speed_max
    assert max(cell.speeds) > 0.5 * cell.settings.shaft_speed_max
    assert max(cell.peaks) < 1.2 * 300.0
    assert abs(np.nanmean(cell.means[100:-10])) < 0.1 * cell.settings.shaft_speed_max


@pytest.mark.slow  # minutes of a heavy rotor are simulated
@pytest.mark.parametrize("friction", [0.01, 0.05])
def test_a_heavy_rotor_is_held_at_its_mean_speed_whatever_its_friction(friction):
    """A proportional feedback alone stays behind by what friction takes."""
    torque = 127.4  # largest one of this machine, N m
    mean = 600 * ELECTRICAL
    cell = cell_of(
        {"inertia": 10 * torque / 4000.0, "coulomb_friction": friction * torque, "viscous_friction": 0.0},
        shaft_acceleration=1400.0, shaft_speed_max=1400 * ELECTRICAL, mean_speed=mean, duration=20.0,
    )  # fmt: skip
    report = cell.run()
    assert report.state is ExperimentState.IDLE, report.reason
    assert np.mean(cell.means[600:950]) == pytest.approx(mean, rel=0.04)
    assert max(cell.speeds) < 1.2 * cell.settings.shaft_speed_max


def test_a_swing_that_was_planned_for_a_heavier_rotor_trips():
    cell = cell_of(shaft_acceleration=3000.0, shaft_speed_max=600 * ELECTRICAL)
    report = cell.run()
    assert report.state is ExperimentState.TRIPPED
    assert "above 1.2 times shaft_speed_max" in report.reason
    driven = [block for block in cell.wanted if block.any()]
    assert driven[-1][-1].any(), "zero at once, without a ramp: every further moment of torque drives it on"
    for _ in range(10):
        cell.tick()
    assert cell.peaks[-1] < 5.0  # A
    assert max(cell.speeds) < 1.5 * 1.2 * cell.settings.shaft_speed_max  # what 30 ms of torque add


def test_a_locked_shaft_trips():
    cell = cell_of({"inertia": 1e6}, **BAND)
    report = cell.run()
    assert report.state is ExperimentState.TRIPPED
    assert "the shaft is locked" in report.reason


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"shaft_speed_max": None}, "shaft_speed_max is not set"),
        ({"shaft_acceleration": None}, "Neither shaft_acceleration nor swing_frequency is set"),
        ({"mean_speed": 1e4}, "it must be below shaft_speed_max"),
        ({"repeat": 0}, "free_shaft must have an end"),
        ({"slew_rate": 1e4}, "make it slower or smaller, or raise slew_rate"),
    ],
)
def test_what_cannot_be_planned_is_refused(changes, sentence):
    with pytest.raises(ConfigurationError, match=sentence):
        ExperimentSettings(**{"trajectory": "free_shaft", "i_max": 300.0, "slew_rate": 2e5} | BAND | changes)
