"""The simulated bench: what it does with references, and what it publishes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from drive_id.bench.bench import Pace, SimulatedBench
from drive_id.bench.drive import Drive, build_machine, simulate
from drive_id.bench.effects import COURSE
from drive_id.bench.faults import Channel, FaultSettings
from drive_id.bench.machines import machine_map
from drive_id.bench.reference_buffer import ReferenceBuffer
from drive_id.bench.scalars import logged_scalars
from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.common.health import Level
from drive_id.core.experiment.encoder import Encoder
from drive_id.errors import ConfigurationError
from drive_id.types import SCALARS

MS = 1_000_000
US = 1000
T0 = 1_700_000_000 * 1000 * MS
T = 1e-4
GRID = T0 + np.arange(2000) * 100 * US


def values(*numbers):
    return np.array(numbers, np.float32)


def buffer():
    return ReferenceBuffer(100.0, 1e4)


def test_each_set_point_is_due_at_its_stamp():
    references = buffer()
    references.add(T0 + 1000 * US, T, values(1, 2, 3), values(-1, -2, -3))
    taken = references.take(GRID[:20], T)
    np.testing.assert_array_equal(taken[:10], 0.0)
    np.testing.assert_array_equal(taken[10:13], [[1, -1], [2, -2], [3, -3]])


def test_grids_need_not_agree():
    """A set-point counts from the sample on that follows it; coarser set-points are held."""
    references = buffer()
    references.add(T0 - 50 * US, 2e-4, values(1, 2), values(0, 0))
    np.testing.assert_array_equal(references.take(GRID[:4], T)[:, 0], [1, 1, 2, 2])


def test_without_references_the_current_goes_to_zero_with_bounded_slew():
    references = buffer()
    references.add(T0, T, np.full(10, 30, np.float32), np.full(10, 40, np.float32))
    first, rest = references.take(GRID[:15], T), references.take(GRID[15:100], T)
    taken = np.concatenate((first, rest))
    amplitude = np.hypot(*taken.T)
    np.testing.assert_allclose(amplitude[:11], 50.0)  # the last one holds for one and a half periods
    np.testing.assert_allclose(amplitude[11:61], 50.0 - np.arange(1, 51), atol=1e-9)
    np.testing.assert_array_equal(taken[61:], 0.0)
    assert references.dry


def test_later_blocks_take_back_what_follows_them():
    references = buffer()
    references.add(T0, T, np.full(100, 10, np.float32), np.zeros(100, np.float32))
    references.take(GRID[:20], T)
    references.add(int(GRID[30]), T, np.full(50, 5, np.float32), np.zeros(50, np.float32), count=100)
    taken = references.take(GRID[20:70], T)[:, 0]
    np.testing.assert_array_equal(taken, [10] * 10 + [5] * 40)


def test_late_ones_are_counted():
    references = buffer()
    references.take(GRID[:50], T)
    references.add(T0, T, np.ones(60, np.float32), np.ones(60, np.float32))
    assert references.counts.late == 50
    np.testing.assert_array_equal(references.take(GRID[50:60], T), 1.0)


@pytest.mark.parametrize(
    ("period", "d", "q"),
    [
        (T, values(1, 2), values(1)),
        (T, values(np.nan), values(1)),
        (T, values(1), values(np.inf)),
        (0.0, values(1), values(1)),
        (np.nan, values(1), values(1)),
        (-1.0, values(1), values(1)),
    ],
)
def test_what_makes_no_sense_is_left_out(period, d, q):
    references = buffer()
    references.add(T0, period, d, q)
    assert references.counts.unusable > 0
    np.testing.assert_array_equal(references.take(GRID[:5], T), 0.0)


def test_beyond_the_drives_limit_they_are_ignored_not_scaled():
    references = buffer()
    references.add(T0, T, values(60), values(79))
    np.testing.assert_array_equal(references.take(GRID[:1], T), [[60, 79]])
    references.add(T0 + 100 * US, T, values(300), values(400), count=1)
    np.testing.assert_allclose(np.hypot(*references.take(GRID[1:3], T).T), [98.2, 97.2], atol=0.1)
    assert references.counts.beyond == 1
    assert references.fault == "Set-points of 500 A exceed the limit of 100 A."


def full(value, count=100):
    return np.full(count, value, np.float32), np.zeros(count, np.float32)


def test_a_safe_block_acts_on_receipt_and_ends_its_session():
    """Whoever sends it, whenever it is due; what follows in the session is ignored, a new one is not."""
    references = buffer()
    references.add(T0, T, *full(50), session=5)
    references.take(GRID[:10], T)
    references.add(T0 + 10**12, T, values(0), values(0), session=9, count=77, safe=True)
    np.testing.assert_allclose(references.take(GRID[10:70], T)[:, 0], np.maximum(49 - np.arange(60.0), 0), atol=1e-9)
    assert references.dry
    references.add(int(GRID[70]), T, *full(50), session=5, count=100)
    np.testing.assert_array_equal(references.take(GRID[70:80], T), 0.0)
    references.add(int(GRID[80]), T, *full(50), session=6)
    np.testing.assert_array_equal(references.take(GRID[80:90], T)[:, 0], 50.0)
    assert (references.session, references.applied) == (6, 9)


def test_a_session_whose_beginning_was_missed_is_not_followed():
    """As after a restart of the drive."""
    references = buffer()
    references.add(T0, T, *full(50), session=5, count=1000)
    np.testing.assert_array_equal(references.take(GRID[:10], T), 0.0)
    assert references.counts.foreign == 100


def test_what_follows_a_gap_is_not_taken_up_again():
    references = buffer()
    references.add(T0, T, *full(50, 10), session=5)
    references.add(T0 + 2000 * US, T, *full(50), session=5, count=20)
    taken = references.take(GRID[:100], T)[:, 0]
    np.testing.assert_array_equal(taken[:11], 50.0)
    np.testing.assert_array_equal(taken[70:], 0.0)
    assert references.dry


def test_a_straggler_is_ignored():
    references = buffer()
    references.add(T0, T, *full(10, 10), session=5)
    references.add(T0 + 1000 * US, T, *full(30), session=5, count=10)
    references.add(T0, T, *full(99, 10), session=5)
    np.testing.assert_array_equal(references.take(GRID[:60], T)[:, 0], [10.0] * 10 + [30.0] * 50)


ONE, OTHER = 5 << 16, 6 << 16  # two publishers, before their first runs


def test_two_publishers_bring_the_drive_to_zero_until_both_are_silent():
    references = buffer()
    references.add(T0, T, *full(50), session=ONE + 1)
    references.take(GRID[:10], T)
    references.add(T0 + 1000 * US, T, *full(80), session=OTHER + 1)
    taken = references.take(GRID[10:100], T)
    assert taken[0, 0] == pytest.approx(49.0)
    np.testing.assert_array_equal(taken[60:], 0.0)
    assert references.fault == "Two publishers send references."
    references.add(int(GRID[100]), T, *full(50), session=OTHER + 2)
    np.testing.assert_array_equal(references.take(GRID[100:110], T), 0.0)
    references.take(GRID, T)
    for end in (9000, 11_000):  # a second after the last message, and not before
        assert references.fault
        references.take(GRID[0] + np.arange(end - 2000) * 100 * US, T)
    assert references.fault == ""
    references.add(int(GRID[10]), T, *full(50), session=OTHER + 3)
    np.testing.assert_array_equal(references.take(GRID[10:20], T)[:, 0], 50.0)


@pytest.mark.parametrize("end", ["safe", "run out", "at zero"])
def test_a_drive_belongs_to_its_publisher_for_a_second_after_a_run(end):
    """A publisher that has died after its trip cannot keep an intruder from the drive."""

    def ended():
        references = buffer()
        references.add(T0, T, *full(0 if end == "at zero" else 50), session=ONE + 7)
        references.take(GRID[:50], T)
        if end == "safe":
            references.add(T0, T, *full(0), session=ONE + 7, count=50, safe=True)
        references.take(GRID[50:300], T)
        return references

    def follows(references, session):
        references.add(int(GRID[300]), T, *full(20), session=session)
        return references.take(GRID[300:310], T)[-1, 0] == 20.0

    assert follows(ended(), ONE + 8)  # its next run
    assert not follows(again := ended(), ONE + 7)  # the beginning of the last one, late
    assert again.fault == ""
    for delay in (0, 9000):
        references = ended()
        references.take(GRID[0] + np.arange(delay + 1) * 100 * US, T)
        assert not follows(references, OTHER + 1)
        assert references.fault == "Two publishers send references."
    free = ended()
    free.take(GRID[0] + np.arange(10_001) * 100 * US, T)
    assert follows(free, OTHER + 1)


def test_the_buffer_forgets():
    references = buffer()
    for k in range(0, 2000, 100):
        references.add(int(GRID[k]), T, np.ones(100, np.float32), np.ones(100, np.float32), count=k)
        references.take(GRID[k : k + 100], T)
    assert len(references) <= 1


IPM, DRIVE = machine_map("ipm"), SimulationSettings(current_noise=1e-3)


@pytest.fixture
def bench():
    return SimulatedBench(IPM, DRIVE, BenchSettings())


def columns(blocks, name):
    return np.concatenate([np.stack(getattr(block, name), axis=-1) for block in blocks])


def test_blocks_follow_each_other_and_equal_the_drive_alone():
    bench = SimulatedBench(IPM, DRIVE, BenchSettings(block_size=30))
    t = np.arange(2000) * T
    wanted = (50 * np.stack((np.sin(20 * t), np.cos(20 * t) - 1), axis=-1)).astype(np.float32)
    bench.references.add(T0, T, *wanted.T.copy())
    assert bench.advance(T0) == []
    blocks = []
    for now in (T0 + 1 * MS, T0 + 3 * MS, T0 + 3 * MS + 1, T0 + 90 * MS, T0 + 150 * MS):
        blocks += bench.advance(now)
        assert blocks == [] or blocks[-1].stamp + 3 * MS <= now
    assert len(blocks) == 50
    assert [block.first_sample for block in blocks] == list(range(0, 1500, 30))
    assert [block.stamp for block in blocks] == [T0 + k * 3 * MS for k in range(50)]
    alone = Drive(build_machine(IPM, DRIVE), DRIVE).step_block(wanted[:1500].astype(float)).samples
    np.testing.assert_array_equal(columns(blocks, "currents"), alone.i_abc.astype(np.float32))
    np.testing.assert_array_equal(columns(blocks, "voltages"), alone.u_abc.astype(np.float32))
    np.testing.assert_allclose(columns(blocks, "resolver")[:, 0], alone.angle, atol=3e-7)
    angle = columns(blocks, "resolver")[:, 0].astype(float)
    assert np.all((angle >= -np.pi) & (angle < np.pi))


def test_it_catches_up_without_gaps_and_says_that_it_is_late(bench):
    bench.advance(T0)
    now, blocks = T0 + 3000 * MS, []
    blocks += bench.advance(now)
    assert len(blocks) == 50  # no more at once
    assert bench.health().level is Level.WARN
    assert "behind the clock" in bench.health().message
    for _ in range(10):
        blocks += bench.advance(now)
    assert [block.first_sample for block in blocks] == list(range(0, 30_000, 100))
    assert bench.health().level is Level.OK


def test_speeds_can_change_meanwhile():
    bench = SimulatedBench(IPM, dataclasses.replace(DRIVE, current_noise=0.0), BenchSettings())
    bench.advance(T0)
    bench.advance(T0 + 100 * MS)
    bench.set_speeds((800.0,), 0.1)
    rpm = columns(bench.advance(T0 + 300 * MS), "resolver")[:, 1] * 30 / np.pi / 4
    np.testing.assert_allclose(rpm[[0, 500, 1000, 1999]], [500, 650, 800, 800], rtol=1e-6)


def test_health_tells_of_references_that_could_not_be_followed(bench):
    bench.advance(T0)
    assert bench.health().message == "Zero current: no references."
    bench.references.add(T0, T, values(np.nan), values(0))
    assert "1 set-points were rejected" in bench.health().message
    bench.references.add(T0, T, values(1000), values(0))
    assert "exceed the limit of" in bench.health().message
    bench.advance(T0 + 10 * MS)
    bench.advance(T0 + 1200 * MS)
    bench.advance(T0 + 1200 * MS)
    bench.advance(T0 + 1200 * MS)
    bench.references.add(T0, T, values(1), values(0))
    assert "too late" in bench.health().message
    assert bench.health().level is Level.OK
    assert not any("ipm" in text or "500" in text for text in bench.health().values.values())


def statuses(bench, *times):
    found = []
    for now in times:
        bench.advance(now)
        found.append(bench.status())
    return found


def test_the_status_tells_clock_session_and_reference_in_force(bench):
    bench.references.add(T0, T, *full(-20, 300), session=5)
    _, first, second, third = statuses(bench, T0, T0 + 10 * MS, T0 + 20 * MS, T0 + 30 * MS)
    assert (first.count, first.stamp, first.session, first.applied) == (0, T0 + 10 * MS, 5, 99)
    assert (second, third.count, third.i_d, third.i_q) == (None, 1, -20.0, 0.0)
    assert (first.enabled, first.fault, first.dc_link_voltage) == (True, "", 400.0)
    assert first.speed == pytest.approx(500 * 4 * np.pi / 30)


def test_the_clock_of_the_drive_can_be_wrong():
    """Stamps and due times alike."""
    bench = SimulatedBench(IPM, DRIVE, BenchSettings(), FaultSettings(clock_offset=-5.0, clock_drift=0.5))
    bench.references.add(T0 - 5000 * MS + 10 * MS, T, *full(-20, 300), session=5)
    bench.advance(T0)
    blocks = bench.advance(T0 + 10 * MS)
    assert blocks[0].stamp == T0 - 5000 * MS + 5 * MS  # half of 10 ms gained
    assert bench.references.last[0] == -20.0


def test_a_restarted_drive_counts_from_0_and_stays_at_zero_current(bench):
    bench.references.add(T0, T, *full(-20, 300), session=5)
    bench.advance(T0)
    assert bench.advance(T0 + 20 * MS)[-1].first_sample == 100
    bench.restart()
    bench.references.add(T0 + 30 * MS, T, *full(-20, 300), session=5, count=300)
    assert bench.advance(T0 + 40 * MS)[0].first_sample == 0
    assert bench.references.dry
    assert bench.status().count == 0


def test_a_drive_takes_the_angle_of_its_encoder_only_at_zero_current():
    raw = dataclasses.replace(DRIVE, resolver_offset=0.7, angle_reversed=True)
    wrong, right, plain = (SimulatedBench(IPM, drive, BenchSettings()) for drive in (raw, raw, DRIVE))
    right.set_encoder(Encoder(encoder_offset=-0.7, encoder_direction=-1))
    angles = []
    for bench in (wrong, right, plain):
        bench.advance(T0)
        angles.append(bench.advance(T0 + 10 * MS)[-1].resolver[0])
    np.testing.assert_allclose(angles[1], angles[2], atol=1e-6)
    assert np.abs(angles[0] - angles[2]).max() > 0.5
    right.references.add(T0 + 10 * MS, T, *full(-20, 300), session=5)
    with pytest.raises(ConfigurationError, match="stop it before"):
        right.set_encoder(Encoder())


@pytest.mark.parametrize("freeze", ["stamps", "samples"])
def test_a_frozen_drive_repeats_itself(bench, freeze):
    bench.advance(T0)
    last = bench.advance(T0 + 10 * MS)[-1]
    bench.faults = FaultSettings(freeze=freeze)
    blocks = bench.advance(T0 + 50 * MS)
    assert [block.first_sample for block in blocks] == [100, 200, 300, 400]
    assert {block.stamp == last.stamp for block in blocks} == {freeze == "stamps"}
    assert {block.currents is last.currents for block in blocks} == {freeze == "samples"}


def test_a_drive_trips_by_itself():
    bench = SimulatedBench(IPM, DRIVE, BenchSettings(speed_limit=400.0))
    _, status = statuses(bench, T0, T0 + 10 * MS)
    assert status.fault == "The speed exceeds 400 rpm."
    bench.faults = FaultSettings(trip=True)
    (status,) = statuses(bench, T0 + 40 * MS)
    assert not status.enabled


def test_a_channel_delays_loses_and_reorders():
    lossy = Channel(1)
    arrived = lossy.carry(range(10_000), 0.0, FaultSettings(loss=0.3))
    assert arrived == sorted(arrived)
    assert len(arrived) == pytest.approx(7000, abs=150)
    late = Channel(1)
    assert late.carry([1, 2], 0.0, FaultSettings(latency=0.1)) == []
    assert late.carry([3], 0.1, FaultSettings(latency=0.1)) == [1, 2]
    mixed = Channel(1)
    arrived = [item for k in range(100) for item in mixed.carry([k], k * 0.01, FaultSettings(disorder=0.3))]
    assert arrived != sorted(arrived)
    assert len(set(arrived)) == len(arrived) > 90


def test_scaled_time_waits_for_the_simulation():
    pace = Pace(T0, 0, 10.0)
    assert pace.now(1 * MS, T0 + 50 * MS) == T0 + 10 * MS
    assert pace.now(100 * MS, T0 + 50 * MS) == T0 + 50 * MS
    assert pace.now(101 * MS, T0 + 100 * MS) == T0 + 60 * MS
    real = Pace(T0, 0, 1.0)
    assert real.now(100 * MS, T0 + 50 * MS) == T0 + 100 * MS


def test_optional_signals_come_at_their_rates_without_a_gap():
    """Whatever the blocks: one count, one grid; nothing at all unless it is asked for."""
    settings = SimulationSettings(
        log_scalars=("dc_link_voltage", "winding_temperature", "shaft_torque"),
        scalar_rate=1000.0,
        temperature_rate=40.0,
    )
    bench = SimulatedBench(IPM, settings, BenchSettings(block_size=70))
    bench.advance(T0)
    blocks = [block for step in range(1, 40) for block in bench.advance(T0 + step * 13 * MS)]
    assert len(blocks) > 60
    periods = {"dc_link_voltage": 1e-3, "winding_temperature": 25e-3, "shaft_torque": 1e-3}
    for name, period in periods.items():
        found = [block.scalars[name] for block in blocks if name in block.scalars]
        number = 0
        for scalar in found:
            assert (scalar.first_sample, scalar.stamp) == (number, T0 + round(number * period * 1e9))
            assert scalar.sample_period == pytest.approx(period)
            assert scalar.values[0].dtype == np.float32
            number += len(scalar)
        assert number == -(-len(blocks) * 70 // round(period / T))
    voltages = [block.scalars["dc_link_voltage"].values[0] for block in blocks if block.scalars]
    assert set(np.concatenate(voltages)) == {400.0}
    plain = SimulatedBench(IPM, SimulationSettings(), BenchSettings())
    plain.advance(T0)
    assert all(block.scalars == {} for block in plain.advance(T0 + 50 * MS))


def test_the_torque_is_that_of_the_mean_power():
    """Over whole turns at constant current, T times speed is the electrical power without the copper loss."""
    settings = SimulationSettings(log_scalars=("shaft_torque",), inverter="none")
    reference = np.tile([-60.0, 120.0], (6000, 1))
    found = simulate(IPM, settings, reference)
    samples, speed = found.samples, 500 / 60 * 2 * np.pi
    turns = slice(3600, 4800)  # one revolution
    i_mean = 0.5 * (samples.i_abc[turns] + samples.i_abc[turns.start + 1 : turns.stop + 1])
    power = np.mean(np.sum(samples.u_abc[turns] * i_mean, axis=1))
    copper = found.truth.resistance * np.mean(np.sum(samples.i_abc[turns] ** 2, axis=1))
    assert np.mean(samples.shaft_torque[turns]) == pytest.approx((power - copper) / speed, rel=0.01)


def test_a_drive_that_knows_more_logs_what_it_knows():
    machine = build_machine(IPM, SimulationSettings())
    settings = SimulationSettings(log_scalars=SCALARS)
    course = np.recarray(2, COURSE)
    course.i_dq_machine[:], course.psi_dq[:] = [[-50.0, 100.0], [0.0, 200.0]], [[0.1, 0.05], [0.2, 0.1]]
    course.temperature[:], course.u_dc[:] = [[40.0, 60.0], [41.0, 61.0]], [390.0, 410.0]
    found = logged_scalars(settings, machine, np.zeros((2, 2)), np.zeros(2), course)
    assert found["winding_temperature"].tolist() == [40.0, 41.0]
    assert found["magnet_temperature"].tolist() == [60.0, 61.0]
    assert found["dc_link_voltage"].tolist() == [390.0, 410.0]
    np.testing.assert_allclose(found["shaft_torque"], [1.5 * 4 * (10.0 + 2.5), 1.5 * 4 * 40.0])
