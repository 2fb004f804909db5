"""Samples of which no map can come are refused, and only those."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import record

from drive_id.core import frames
from drive_id.core.checks.samples import check_rotation, check_trajectory
from drive_id.errors import CoverageError, DataError, StandstillError

PERIOD = 1e-4


@pytest.fixture(scope="module")
def good():
    return record(duration=1.0)


def turning(good, speed, *, angle_noise=0.0, speed_noise=0.0, starts=(0,)):
    """The samples with the rotor moved as speed (N,), rad/s, says."""
    rng = np.random.default_rng(0)
    n = len(good)
    speed = np.broadcast_to(speed, n)
    angle = 0.4 + np.cumsum(speed) * PERIOD - speed[0] * PERIOD + angle_noise * rng.normal(size=n)
    return replace(
        good,
        angle=np.angle(np.exp(1j * angle)),
        speed=speed + speed_noise * rng.normal(size=n),
        run_starts=np.array(starts),
    )


@pytest.mark.parametrize("speed", [7.0, -7.0, 209.0, -3000.0, 15000.0])
def test_any_steady_speed_passes(good, speed):
    check_rotation([turning(good, speed)])


def test_noise_of_the_sensors_does_not_refuse_a_slow_machine(good):
    """Angles of 12 bits, differentiated from sample to sample, are off by as much as the speed itself."""
    check_rotation([turning(good, 20.0, angle_noise=5e-4, speed_noise=10.0)])


def test_a_machine_that_turns_back_and_forth_turns(good):
    t = PERIOD * np.arange(len(good))
    check_rotation([turning(good, 40 * np.cos(2 * np.pi * 2 * t))])


def test_many_short_runs_make_a_turn_together(good):
    check_rotation([turning(good, 209.0, starts=range(0, len(good), 50))])


@pytest.mark.parametrize(("speed", "noise"), [(0.0, 0.0), (0.0, 100.0), (6.0, 0.0), (-6.0, 0.0)])
def test_less_than_a_turn_is_standstill(good, speed, noise):
    with pytest.raises(StandstillError, match=r"turned by only 0\.\d\d electrical revolutions"):
        check_rotation([turning(good, speed, angle_noise=1e-3, speed_noise=noise)])


def test_a_single_sample_is_standstill(good):
    one = {name: getattr(good, name)[:1] for name in ("stamp", "i_abc", "u_abc", "angle", "speed")}
    with pytest.raises(StandstillError):
        check_rotation([replace(good, **one)])


@pytest.mark.parametrize("factor", [-1.0, 0.0, 0.25, 0.97, 1.03, 4.0])
def test_speeds_that_contradict_the_angle(good, factor):
    with pytest.raises(DataError, match="times as fast as its speed says"):
        check_rotation([replace(good, speed=factor * good.speed)])


def test_angles_that_contradict_the_speed(good):
    held = replace(good, angle=np.zeros(len(good)))
    for wrong in (held, replace(good, angle=-good.angle)):
        with pytest.raises(DataError, match="times as fast"):
            check_rotation([wrong])
    with pytest.raises(DataError, match="times as fast"):
        check_rotation([good, held])  # one of two recordings


def test_slow_and_fast_parts_are_told_apart_by_neither(good):
    """Pole pairs in one of two recordings only: the wrong one must not hide behind the right one."""
    wrong = replace(good, speed=good.speed / 4)
    with pytest.raises(DataError):
        check_rotation([good, wrong])


def currents(samples):
    return [frames.to_dq(one.i_abc, one.angle) for one in samples]


def with_currents(good, i_d, i_q, noise=0.3):
    i_d, i_q = np.broadcast_to(i_d, len(good)), np.broadcast_to(i_q, len(good))
    i_abc = frames.to_abc(np.stack([i_d, i_q], axis=-1), good.angle)
    return replace(good, i_abc=i_abc + noise * np.random.default_rng(0).normal(size=i_abc.shape))


def test_a_trajectory_passes(good):
    check_trajectory([good], currents([good]))
    reference = frames.to_dq(good.i_abc, good.angle)
    check_trajectory([replace(good, i_dq_reference=reference)], currents([good]))


@pytest.mark.parametrize(
    ("i_d", "i_q", "axis", "scale"),
    [
        (0.0, 0.0, "[dq]", 3),
        (-50.0, 120.0, "[dq]", 3),
        ("moves", 120.0, "q", 3),
        (-50.0, "moves", "d", 3),
    ],
)
def test_noise_is_no_trajectory(good, i_d, i_q, axis, scale):
    moves = 200 * np.sin(np.linspace(0, 20, len(good)))
    samples = with_currents(good, *(moves if value == "moves" else value for value in (i_d, i_q)))
    with pytest.raises(CoverageError, match=f"current i_{axis} stays within") as caught:
        check_trajectory([samples], currents([samples]))
    assert float(str(caught.value).split()[5]) < scale  # the range of that axis, not of the other one


def test_no_current_at_all(good):
    samples = with_currents(good, 0.0, 0.0, noise=0.0)
    with pytest.raises(CoverageError, match="stays within 0 A"):
        check_trajectory([samples], currents([samples]))


def test_held_references(good):
    for held in (0.0, -20.0):
        samples = replace(good, i_dq_reference=np.full((len(good), 2), held))
        with pytest.raises(CoverageError, match=rf"references stay at i_d = {held:g} A"):
            check_trajectory([samples], currents([samples]))


def test_references_held_at_another_point_in_each_recording_pass(good):
    parts = [replace(good, i_dq_reference=np.full((len(good), 2), held)) for held in (0.0, 1.0)]
    check_trajectory(parts, currents(parts))


def test_references_that_are_not_known_throughout_say_nothing(good):
    partly = np.zeros((len(good), 2))
    partly[100:] = np.nan
    check_trajectory([replace(good, i_dq_reference=partly)], currents([good]))
    held = replace(good, i_dq_reference=np.zeros((len(good), 2)))
    check_trajectory([held, good], currents([held, good]))


@pytest.mark.parametrize("spike", [1e4, 1e10, 1e30, 1e38])
def test_a_spike(good, spike):
    i_abc = good.i_abc.copy()
    i_abc[500, 0] = spike
    samples = replace(good, i_abc=i_abc)
    with pytest.raises(DataError, match="stands out"):
        check_trajectory([samples], currents([samples]))
