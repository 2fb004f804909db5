"""Samples that cannot give a map are refused, and only those, whole or in pieces; of the others the range is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import cut, record, saturating_flux

from drive_id.core import frames
from drive_id.core.checks.prescan import Prescan
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identify import identify
from drive_id.errors import CoverageError, DataError, DriveIdError, StandstillError

PERIOD = 1e-4


@pytest.fixture(scope="module")
def good():
    return record(duration=1.0)


def check(*recordings):
    prescan = Prescan()
    for samples in recordings:
        prescan.add(samples)
    prescan.check()


def turning(good, speed, *, angle_noise=0.0, speed_noise=0.0, starts=(0,)):
    """The samples with the rotor moved as speed (N,), rad/s, says."""
    rng = np.random.default_rng(0)
    n = len(good)
    speed = np.broadcast_to(speed, n)
    turned = 0.4 + np.cumsum(speed) * PERIOD - speed[0] * PERIOD
    angle = turned + angle_noise * rng.normal(size=n)
    i_dq = frames.to_dq(good.i_abc, good.angle)
    psi_s = (saturating_flux(i_dq) @ [1, 1j]) * np.exp(1j * turned)
    i_abc = frames.to_abc(i_dq, turned)
    u_s = np.gradient(psi_s, PERIOD) + 0.02 * frames.space_vector(i_abc)
    return replace(
        good,
        i_abc=i_abc,
        u_abc=frames.phases(u_s),
        angle=np.angle(np.exp(1j * angle)),
        speed=speed + speed_noise * rng.normal(size=n),
        run_starts=np.array(starts),
    )


@pytest.mark.parametrize("speed", [7.0, -7.0, 209.0, -3000.0, 15000.0])
def test_any_steady_speed_passes(good, speed):
    check(turning(good, speed))


def test_noise_of_the_sensors_does_not_refuse_a_slow_machine(good):
    """Angles of 12 bits, differentiated from sample to sample, are off by as much as the speed itself."""
    check(turning(good, 20.0, angle_noise=5e-4, speed_noise=10.0))


def test_a_machine_that_turns_back_and_forth_turns(good):
    t = PERIOD * np.arange(len(good))
    check(turning(good, 40 * np.cos(2 * np.pi * 2 * t)))


def test_many_short_runs_make_a_turn_together(good):
    check(turning(good, 209.0, starts=range(0, len(good), 50)))


@pytest.mark.parametrize(("speed", "noise"), [(0.0, 0.0), (0.0, 100.0), (6.0, 0.0), (-6.0, 0.0)])
def test_less_than_a_turn_is_standstill(good, speed, noise):
    with pytest.raises(StandstillError, match=r"turned by only 0\.\d\d electrical revolutions"):
        check(turning(good, speed, angle_noise=1e-3, speed_noise=noise))


def test_a_single_sample_is_standstill(good):
    with pytest.raises(StandstillError):
        check(good.part(0, 1))


@pytest.mark.parametrize("factor", [-1.0, 0.0, 0.25, 0.97, 1.03, 4.0])
def test_speeds_that_contradict_the_angle(good, factor):
    with pytest.raises(DataError, match="times as fast as the logged speed"):
        check(replace(good, speed=factor * good.speed))


def test_angles_that_contradict_the_speed(good):
    held = replace(good, angle=np.zeros(len(good)))
    for wrong in (held, replace(good, angle=-good.angle)):
        with pytest.raises(DataError, match="times as fast"):
            check(wrong)
    with pytest.raises(DataError, match="times as fast"):
        check(good, held)  # one of two recordings


def test_slow_and_fast_parts_are_told_apart_by_neither(good):
    """Pole pairs in one of two recordings only: the wrong one must not hide behind the right one."""
    wrong = replace(good, speed=good.speed / 4)
    with pytest.raises(DataError):
        check(good, wrong)


def with_currents(good, i_d, i_q, noise=0.3):
    i_d, i_q = np.broadcast_to(i_d, len(good)), np.broadcast_to(i_q, len(good))
    i_abc = frames.to_abc(np.stack([i_d, i_q], axis=-1), good.angle)
    return replace(good, i_abc=i_abc + noise * np.random.default_rng(0).normal(size=i_abc.shape))


def test_a_trajectory_passes(good):
    check(good)
    reference = frames.to_dq(good.i_abc, good.angle)
    check(replace(good, i_dq_reference=reference))


@pytest.mark.parametrize(
    ("i_d", "i_q", "axis", "scale"),
    [(0.0, 0.0, "[dq]", 3), (-50.0, 120.0, "[dq]", 3), ("moves", 120.0, "q", 3), (-50.0, "moves", "d", 3)],
)
def test_noise_is_no_trajectory(good, i_d, i_q, axis, scale):
    moves = 200 * np.sin(np.linspace(0, 20, len(good)))
    samples = with_currents(good, *(moves if value == "moves" else value for value in (i_d, i_q)))
    with pytest.raises(CoverageError, match=f"current i_{axis} stays within") as caught:
        check(samples)
    assert float(str(caught.value).split()[5]) < scale  # the range of that axis, not of the other one


def test_no_current_at_all(good):
    samples = with_currents(good, 0.0, 0.0, noise=0.0)
    with pytest.raises(CoverageError, match="stays within 0 A"):
        check(samples)


def test_held_references(good):
    for held in (0.0, -20.0):
        samples = replace(good, i_dq_reference=np.full((len(good), 2), held))
        with pytest.raises(CoverageError, match=rf"references stay at i_d = {held:g} A"):
            check(samples)


def test_references_held_at_another_point_in_each_recording_pass(good):
    parts = [replace(good, i_dq_reference=np.full((len(good), 2), held)) for held in (0.0, 1.0)]
    check(*parts)


def test_references_that_are_not_known_throughout_say_nothing(good):
    partly = np.zeros((len(good), 2))
    partly[100:] = np.nan
    check(replace(good, i_dq_reference=partly))
    held = replace(good, i_dq_reference=np.zeros((len(good), 2)))
    check(held, good)


@pytest.mark.parametrize("spike", [1e4, 1e10, 1e30, 1e38])
def test_a_spike(good, spike):
    i_abc = good.i_abc.copy()
    i_abc[500, 0] = spike
    samples = replace(good, i_abc=i_abc)
    with pytest.raises(DataError, match="stands out"):
        check(samples)


# -- in pieces -----------------------------------------------------------------------------------------------------


def in_pieces(samples, part, **options):
    prescan = Prescan(**options)
    for start in range(0, len(samples), part):
        piece, continues = cut(samples, start, min(start + part, len(samples)))
        prescan.add(piece, continues=continues)
    return prescan


@pytest.fixture(scope="module")
def samples():
    whole = record(duration=2.0, noise=0.3)
    stamp = whole.stamp + np.where(np.arange(20_000) >= 7000, 10**9, 0)
    return replace(whole, stamp=stamp, run_starts=np.array([0, 7000]))


@pytest.mark.parametrize("part", [20_000, 7000, 913])
@pytest.mark.parametrize("reference", [None, 1.0, 0.9, 0.5])
def test_range_and_radius_are_those_of_the_arrays(samples, part, reference):
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    amplitude = np.hypot(*i_dq.T)
    usual = np.quantile(amplitude, 0.999)
    radius = min(300.0 * reference, usual) if reference and 1.2 * 300.0 * reference > usual else usual
    if reference:
        angle = np.linspace(0, 20, len(samples))
        circle = reference * 300 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        circle[:100] = np.nan  # of these, the currents stay below 260 A
        samples = replace(samples, i_dq_reference=circle)
    prescan = in_pieces(samples, part, kept=100)
    prescan.check()
    found = prescan.prepare(FitSettings(method="joint"))
    trusted = i_dq[amplitude <= 1.2 * usual]
    assert ((found.d.low, found.q.low), (found.d.high, found.q.high)) == (
        tuple(trusted.min(axis=0)), tuple(trusted.max(axis=0))
    )  # fmt: skip
    assert found.i_max == pytest.approx(radius, rel=1e-14)
    assert found.reached == found.i_max
    assert prescan.samples == len(samples)


def test_a_spike_does_not_widen_the_map(samples):
    i_abc = samples.i_abc.copy()
    i_abc[500] *= 3.0
    found, expected = (in_pieces(one, 913) for one in (replace(samples, i_abc=i_abc), samples))
    found.check()
    one, other = (prescan.prepare(FitSettings("joint")) for prescan in (found, expected))
    assert (one.d, one.q) == (other.d, other.q)


def test_samples_without_references_count_by_what_they_reach():
    """Whether their recording is one of its own, or a stretch of one whose references are known elsewhere."""
    small, large = (record(duration=1.0, noise=0.3, i_max=i_max, seed=int(i_max)) for i_max in (260.0, 310.0))
    known = replace(small, i_dq_reference=frames.to_dq(record(duration=1.0, i_max=260.0).i_abc, small.angle))
    tiny = record(duration=1.0, noise=0.3, i_max=100.0)
    other = np.quantile(np.hypot(*frames.to_dq(large.i_abc, large.angle).T), 0.999)
    for pair, expected in (((known, large), other), ((large, known), other), ((known, tiny), 260.0)):
        prescan = Prescan()
        for recording in pair:
            prescan.add(recording)
        assert prescan.radius == pytest.approx(expected, rel=5e-4)


def spoiled(samples):
    rng = np.random.default_rng(0)
    zero = np.zeros(len(samples))
    for size in (1e6, 1e38):
        spike = samples.i_abc.copy()
        spike[7100] = np.array([1, -0.5, -0.5]) * size
        yield "stands out where 99.9 %", replace(samples, i_abc=spike)
    yield "turned by only 0.00", replace(samples, speed=zero, angle=zero)
    yield "advances 4.000 times", replace(samples, speed=samples.speed / 4)
    yield "advances -1.000 times", replace(samples, angle=-samples.angle)
    yield "shows only noise", replace(samples, i_abc=rng.normal(size=samples.i_abc.shape))
    yield "stays within 0 A", replace(samples, i_abc=zero[:, None] + zero[:3])
    jump = samples.angle.copy()
    jump[[12_000, 9000]] += 2.0
    yield "jumps in 4 places, the first at 1.900000 s by 2.00 rad", replace(samples, angle=jump)
    yield "references stay at i_d = 3 A", replace(samples, i_dq_reference=np.full((len(samples), 2), 3.0))


@pytest.mark.parametrize("number", range(9))
def test_pieces_and_arrays_are_refused_alike(samples, number):
    said, wrong = list(spoiled(samples))[number]
    with pytest.raises(DriveIdError, match=said) as expected:
        identify([wrong], FitSettings(method="joint"))
    with pytest.raises(type(expected.value)) as found:
        in_pieces(wrong, 1731, kept=100).check()
    assert str(found.value) == str(expected.value)


def test_a_copy_goes_its_own_way(samples):
    prescan = Prescan(kept=100)
    prescan.add(cut(samples, 0, 9000)[0])
    copy, before = prescan.copy(), prescan.radius
    prescan.add(replace(samples, i_abc=1e6 * samples.i_abc, speed=4 * samples.speed))
    with pytest.raises(DataError):
        prescan.check()
    copy.check()
    assert copy.radius == before
    assert copy.samples == 9000


def test_the_radius_of_the_settings_needs_no_samples():
    evidence = Prescan().prepare(FitSettings("joint", i_max=7.0))
    assert evidence.i_max == 7.0
    assert evidence.reached == 0.0


def test_pieces_without_references_between_others_are_no_held_point(samples):
    prescan = Prescan()
    held = np.full((7000, 2), 3.0)
    first, _ = cut(samples, 0, 7000)
    prescan.add(replace(first, i_dq_reference=held))
    prescan.add(cut(samples, 7000, 20_000)[0])
    prescan.check()


def test_the_radius_of_samples_without_references_is_their_own_quantile(good):
    """Of a recording without references, whose amplitude grows steadily, beside one with references."""
    i_dq = np.column_stack([np.linspace(0.0, 260.0, len(good)), np.zeros(len(good))])
    growing = replace(good, i_abc=frames.to_abc(i_dq, good.angle), i_dq_reference=None)
    known = frames.to_abc(np.full_like(i_dq, 160.0), good.angle)
    known = replace(good, i_abc=known, i_dq_reference=np.full_like(i_dq, 160.0))
    prescan = Prescan()
    for samples in (known, growing):
        prescan.add(samples)
    assert prescan.radius == pytest.approx(260.0 * (1 - 2e-3), abs=0.1)  # 0.1 % of both are 0.2 % of one
