"""Stamps that jitter: the true times come back, losses are found, and none are invented."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.signals.equal_spacing import equal_spacing
from drive_id.errors import SamplePeriodError

PERIOD = 50_000
START = 1_700_000_000_123_456_789


def arrivals(kept, jitter, rng):
    true = START + PERIOD * kept
    return true, true + jitter(rng, len(kept)).astype(np.int64)


JITTERS = {
    "uniform 20 us": lambda rng, n: rng.uniform(-20_000, 20_000, n),
    "normal 20 us": lambda rng, n: rng.normal(0, 20_000, n),
    "late by up to 5 ms now and then": lambda rng, n: rng.exponential(5_000, n) + 5e6 * (rng.random(n) < 1e-3),
}


def in_order(delay):
    """Return delays of messages that wait for those before."""
    at = PERIOD * np.arange(len(delay))
    return np.maximum.accumulate(at + delay) - at


def stalls(rng, n):
    """Return delays of a computer that five times does nothing for 200 samples, and then takes them all at once."""
    delay = rng.exponential(5_000, n)
    for k in rng.integers(0, n - 2000, 5):
        delay[k : k + 200] = np.maximum(delay[k : k + 200], PERIOD * np.arange(200, 0, -1))
    return in_order(delay)


def loads(rng, n):
    """Return delays of a computer that is slower by about a sample for 300 samples, five times."""
    delay = rng.exponential(10_000, n)
    for k in rng.integers(0, n - 2000, 5):
        delay[k : k + 300] += PERIOD * rng.uniform(0.6, 3)
    return in_order(delay)


def batches(rng, n):
    """Return delays of samples of which 32 arrive at once, as by USB."""
    last = np.minimum(np.arange(n) // 32 * 32 + 31, n - 1)
    return PERIOD * (last - np.arange(n)) + rng.exponential(0.3 * PERIOD, n)[last]


LATE = {
    "exponential, mean of a sample": lambda rng, n: in_order(rng.exponential(PERIOD, n)),
    "exponential, mean of two samples": lambda rng, n: in_order(rng.exponential(2 * PERIOD, n)),
    "exponential, mean of three samples": lambda rng, n: in_order(rng.exponential(3 * PERIOD, n)),
    "normal, a sample": lambda rng, n: rng.normal(0, PERIOD, n),
    "stalls": stalls,
    "loads": loads,
    "batches": batches,
    "whole ms": lambda _, n: -(PERIOD * np.arange(n) % 1_000_000),
}


@pytest.mark.parametrize("jitter", LATE.values(), ids=LATE)
def test_late_messages_in_a_row_are_no_loss(jitter):
    for seed in range(4):
        stamp = arrivals(np.arange(40_000), jitter, np.random.default_rng(seed))[1]
        found = equal_spacing(stamp, np.ones(len(stamp), np.int64))
        assert found.missing == 0, seed
        assert abs(found.period * 1e9 / PERIOD - 1) < 1e-5


@pytest.mark.parametrize("law", [law for law in LATE if "three" not in law])
def test_losses_are_told_from_late_messages(law):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        places = 4000 * (1 + np.arange(8)) + rng.integers(-1000, 1000, 8)
        bursts = np.array([1, 1, 1, 2, 3, 10, 100, 300])
        kept = np.delete(
            np.arange(40_000), np.concatenate([k + np.arange(n) for k, n in zip(places, bursts, strict=True)])
        )
        delay = np.zeros(40_000) if law == "whole ms" else LATE[law](rng, len(kept))
        true = PERIOD * kept
        stamp = true // 1_000_000 * 1_000_000 if law == "whole ms" else np.rint(true + delay).astype(np.int64)
        found = equal_spacing(START + stamp, np.ones(len(kept), np.int64))
        assert (found.missing, found.least) == (bursts.sum(), 1), seed
        assert abs(found.period * 1e9 / PERIOD - 1) < 2e-5


def test_any_loss_rate_and_jitter_far_below_a_sample():
    """Whatever is lost, each sample is counted, and the period is right."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n, period = int(rng.integers(3000, 30_000)), int(rng.integers(20_000, 1_000_000))
        lost = np.zeros(n, np.bool_)
        for k in np.flatnonzero(rng.random(n) < 10 ** rng.uniform(-4, -2.3)):
            lost[k : k + rng.integers(1, 40)] = True
        lost[:500] = lost[-500:] = False
        kept = np.flatnonzero(~lost)
        jitter = rng.normal(size=len(kept)) if seed % 2 else rng.exponential(size=len(kept))
        stamp = START + np.rint(period * (kept + 10 ** rng.uniform(-4, -1.2) * jitter)).astype(np.int64)
        found = equal_spacing(stamp, np.ones(len(kept), np.int64))
        assert found.missing == lost.sum(), seed
        assert abs(found.period * 1e9 / period - 1) < 1e-5, seed


def test_losses_that_cannot_be_told_from_jitter_are_named():
    rng = np.random.default_rng(0)
    kept = np.delete(np.arange(20_000), 9000)
    stamp = arrivals(kept, lambda rng, n: in_order(rng.exponential(10 * PERIOD, n)), rng)[1]
    found = equal_spacing(stamp, np.ones(len(kept), np.int64))
    assert found.missing == 0
    assert 2 <= found.least <= 40
    assert abs(found.period * 1e9 / PERIOD - 1) < 5e-4
    assert equal_spacing(stamp, np.ones(len(kept), np.int64), first=kept).least == 1


@pytest.mark.parametrize("jitter", JITTERS.values(), ids=JITTERS)
def test_the_true_times_come_back_and_no_gap_is_invented(jitter):
    true, stamp = arrivals(np.arange(40_000), jitter, np.random.default_rng(1))
    found = equal_spacing(stamp, np.ones(len(stamp), np.int64))
    assert found.gaps == found.missing == 0
    assert abs(found.period * 1e9 / PERIOD - 1) < 2e-6
    away = found.stamp - true
    assert np.ptp(away) < 2000  # ns; a constant delay cannot be told from the time of the first sample


@pytest.mark.parametrize("jitter", JITTERS.values(), ids=JITTERS)
def test_lost_samples_are_inferred_and_counted(jitter):
    kept = np.delete(np.arange(40_000), [7000, 20_001, 20_002, 20_003, *range(30_000, 30_500)])
    rng = np.random.default_rng(2)
    true, stamp = arrivals(kept, jitter, rng)
    found = equal_spacing(stamp, np.ones(len(stamp), np.int64))
    assert (found.gaps, found.missing) == (3, 504)
    wrong = np.abs(found.stamp - true - np.median(found.stamp - true)) > 2000
    assert wrong.sum() <= 32  # just where, within the jitter, a sample is missing cannot be seen
    counted = equal_spacing(stamp, np.ones(len(stamp), np.int64), first=kept + 17)
    assert (counted.gaps, counted.missing) == (3, 504)
    assert np.ptp(counted.stamp - true) < 2000


def test_blocks_and_a_declared_period():
    rng = np.random.default_rng(3)
    samples = rng.integers(1, 30, 3000)
    first = np.concatenate([[0], np.cumsum(samples)[:-1]])
    true, stamp = arrivals(first, JITTERS["normal 20 us"], rng)
    measured = equal_spacing(stamp, samples)
    declared = equal_spacing(stamp, samples, period=PERIOD * 1e-9)
    assert abs(measured.period * 1e9 / PERIOD - 1) < 2e-6
    assert declared.period == PERIOD * 1e-9
    np.testing.assert_array_equal(np.diff(declared.stamp), PERIOD * samples[:-1])
    assert abs(declared.jitter - 20e-6) < 1e-6
    assert np.ptp(measured.stamp - true) < 3000


def test_a_count_that_restarts_goes_on_by_time():
    kept = np.concatenate([np.arange(5000), np.arange(6000, 9000)])
    true, stamp = arrivals(kept, JITTERS["uniform 20 us"], np.random.default_rng(4))
    count = np.concatenate([np.arange(5000), np.arange(3000)])
    found = equal_spacing(stamp, np.ones(len(stamp), np.int64), first=count)
    assert np.ptp(found.stamp - true) < 2000
    assert found.missing == 1000


def test_stamps_that_stand_still_are_refused():
    with pytest.raises(SamplePeriodError, match="do not advance"):
        equal_spacing(np.full(100, START), np.ones(100, np.int64))
    backwards = np.arange(100)[::-1].copy()
    with pytest.raises(SamplePeriodError, match="runs backwards"):
        equal_spacing(START + PERIOD * np.arange(100), np.ones(100, np.int64), first=backwards)
