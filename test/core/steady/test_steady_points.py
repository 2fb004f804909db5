"""Operating points: which samples rest, the errors of their means, and slow telemetry from fast samples."""

from __future__ import annotations

import numpy as np
import pytest
from steady_state import LinearDrive, disc_points, telemetry

from drive_id.core.steady.operating_data import OperatingData
from drive_id.core.steady.operating_points import operating_points, steady_segments
from drive_id.errors import CoverageError, DataError, NonFiniteError


def of(i_d, u_q=None, speed=None, time=None):
    n = len(i_d)
    i_dq = np.column_stack([i_d, np.full(n, 5.0)])
    u_dq = np.column_stack([np.full(n, 1.0), np.full(n, 20.0) if u_q is None else u_q])
    return OperatingData(
        i_dq, u_dq, np.full(n, 300.0) if speed is None else speed, np.arange(n) / 10 if time is None else time
    )


def test_changes_ramps_and_settling_voltages_are_cut():
    i_d = np.concatenate([np.full(8, -10.0), [-9.0, -7.0, -4.0], np.full(8, -2.0), np.linspace(-2.0, 10.0, 12)])
    u_q = np.full(len(i_d), 20.0)
    u_q[11:14] = [30.0, 25.0, 22.0]
    assert steady_segments(of(i_d, u_q)) == [slice(0, 7), slice(14, 19)]


def test_a_change_of_speed_and_a_gap_end_a_segment():
    speed, time = np.full(20, 300.0), np.arange(20) / 10
    speed[10:] = 320.0
    time[5:] += 2.0
    assert steady_segments(of(np.full(20, -10.0), speed=speed, time=time)) == [
        slice(0, 4), slice(6, 9), slice(11, 20),
    ]  # fmt: skip


def test_long_rests_are_one_point():
    rng = np.random.default_rng(5)
    data = of(np.full(3000, -10.0) + 0.01 * rng.standard_normal(3000))
    assert steady_segments(data) == [slice(0, 3000)]


def test_means_and_their_errors_hold():
    drive, i_dq = LinearDrive(), disc_points(np.random.default_rng(1), 100.0, 6, least=0.3)
    speed = np.array([100.0, 200.0, -300.0, 400.0, -150.0, 250.0])
    errors, claimed = [], []
    for seed in range(60):
        points = operating_points(telemetry(drive, i_dq, speed, rng=np.random.default_rng(seed), samples=12))
        assert len(points) == 6
        errors.append(points.i_dq - i_dq)
        claimed.append(np.diagonal(points.covariance, axis1=1, axis2=2)[:, :2])
    assert np.mean(np.square(errors)) == pytest.approx(np.mean(claimed), rel=0.15)


def test_filtered_noise_widens_the_errors():
    """An AR(1) filter with coefficient 0.7 leaves (1 + 0.7) / (1 - 0.7) times the variance of the mean."""
    errors, claimed = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        noise = np.zeros(240)
        for k, step in enumerate(0.01 * rng.standard_normal(240)):
            noise[k] = 0.7 * noise[k - 1] + step
        level = np.repeat([-10.0, -7.0, -4.0, -1.0], 60)
        points = operating_points(of(level + noise))
        errors += list(points.i_dq[:, 0] - [-10.0, -7.0, -4.0, -1.0])
        claimed += list(points.covariance[:, 0, 0])
    assert np.mean(np.square(errors)) == pytest.approx(np.mean(claimed), rel=0.35)


def test_without_a_time_each_sample_is_a_point():
    data = of(np.arange(5.0))
    points = operating_points(OperatingData(data.i_dq, data.u_dq, data.speed))
    assert len(points) == 5
    assert points.covariance is None


def test_a_drive_that_never_rests_is_refused():
    with pytest.raises(CoverageError, match=r"never rests for 3 samples.*rows_are_points"):
        operating_points(of(np.linspace(-50.0, 50.0, 40)))


@pytest.mark.parametrize(
    ("arrays", "error", "said"),
    [
        ((np.zeros((3, 2)), np.zeros((3, 2)), np.zeros(2)), DataError, "i_dq has shape"),
        ((np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)), DataError, "no samples"),
        ((np.full((2, 2), np.nan), np.zeros((2, 2)), np.zeros(2)), NonFiniteError, "i_dq is NaN"),
        ((np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2), np.zeros(2)), DataError, "does not increase"),
        (([["a", "b"]], np.zeros((1, 2)), np.zeros(1)), DataError, "not an array of numbers"),
    ],
)
def test_bad_arrays_are_refused(arrays, error, said):
    with pytest.raises(error, match=said):
        OperatingData(*arrays)


@pytest.mark.cases
@pytest.mark.parametrize(("frequency", "rate"), [(7.3, 10_000.0), (7.3, 2000.0), (1.0, 10_000.0)])
def test_a_moving_current_in_a_fast_log_is_no_rest(frequency, rate):
    """The derivative of the fluxes, unknown to the equations, takes percents of the voltage."""
    time = np.arange(int(3 * rate)) / rate
    turns = 2 * np.pi * frequency * time
    i_dq = 100 * np.column_stack([np.cos(turns) * np.cos(0.31 * turns), np.cos(turns) * np.sin(0.31 * turns)])
    i_dq += 0.1 * np.random.default_rng(1).standard_normal(i_dq.shape)
    data = OperatingData(i_dq, np.ones_like(i_dq), np.full(len(time), 209.0), time)
    with pytest.raises(CoverageError, match=r"do not rest: .* hold each operating point .*--method full"):
        operating_points(data)


def test_held_currents_rest_in_a_fast_log():
    rng = np.random.default_rng(2)
    held = np.repeat(disc_points(rng, 100.0, 12), 3000, axis=0)
    i_dq = held + 0.5 * rng.standard_normal(held.shape)
    data = OperatingData(i_dq, np.ones_like(i_dq), np.full(len(held), 209.0), np.arange(len(held)) / 10_000)
    assert len(operating_points(data)) >= 12  # noise divides some of them
    assert operating_points(data).count.sum() > 35_900
