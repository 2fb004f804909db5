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
