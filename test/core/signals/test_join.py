"""Joining signals: nothing across a gap, nothing invented, every cut counted."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_id.core.signals.join import join
from drive_id.core.signals.period import Spacings, check_agreement, measured_period
from drive_id.core.signals.signal import Signal
from drive_id.errors import (
    DataError,
    EmptyTopicError,
    NonFiniteError,
    NoOverlapError,
    SamplePeriodError,
    StampOrderError,
)

START = 1_700_000_000_123_456_789
STEP = 100_000


def signal(name, index, width, *, shift=0, step=STEP, period=None, blocks=None):
    """Make a signal whose values tell from which sample they are."""
    index = np.asarray(index)
    values = index[:, None] + 0.1 * np.arange(width)
    if name == "/resolver":
        values = np.column_stack((0.01 * index, index.astype(float)))[:, :width]
    return Signal(name, START + shift + index * step, values.astype(float), period, blocks)


def three(n=1000, **kwargs):
    index = np.arange(n)
    return [signal("/i", index, 3, **kwargs), signal("/u", index, 3, **kwargs), signal("/resolver", index, 2, **kwargs)]


def cut(found, keep):
    return replace(found, stamp=found.stamp[keep], values=found.values[keep])


def test_whole_signals_are_one_run():
    result = join(*three())
    assert len(result.samples) == 1000
    assert result.samples.run_starts.tolist() == [0]
    assert result.samples.sample_period == pytest.approx(1e-4, rel=1e-12)
    assert result.report.warnings == ()
    np.testing.assert_array_equal(result.samples.i_abc[:, 0], np.arange(1000))
    np.testing.assert_array_equal(result.samples.u_abc[:, 1], np.arange(1000) + 0.1)
    np.testing.assert_array_equal(result.samples.speed, np.arange(1000))


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_loss_in_any_signal_is_a_gap(which):
    signals = three()
    signals[which] = cut(signals[which], np.r_[0:400, 410:1000])
    result = join(*signals)
    assert len(result.samples) == 990
    assert result.samples.run_starts.tolist() == [0, 400]
    assert result.report.gaps == 1
    assert result.report.warnings[0].values["time_lost"] == pytest.approx(1e-3)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_window_spans_a_gap(data):
    signals = three(200)
    for k in range(3):
        lost = data.draw(st.sets(st.integers(0, 199), max_size=12))
        signals[k] = cut(signals[k], np.array(sorted(set(range(200)) - lost)))
    samples = join(*signals).samples
    for run in samples.runs():
        assert (np.diff(samples.stamp[run]) == STEP).all()
    np.testing.assert_array_equal(samples.i_abc[:, 0], samples.u_abc[:, 0])
    np.testing.assert_array_equal(samples.i_abc[:, 0], samples.speed)


@settings(max_examples=30, deadline=None)
@given(st.tuples(st.integers(1, 60), st.integers(1, 60), st.integers(1, 60)))
def test_the_result_does_not_depend_on_the_size_of_blocks(sizes):
    expected = join(*three(period=1e-4)).samples
    signals = [
        replace(s, block_start=np.arange(0, 1000, size)) for s, size in zip(three(period=1e-4), sizes, strict=True)
    ]
    found = join(*signals).samples
    np.testing.assert_array_equal(found.stamp, expected.stamp)
    np.testing.assert_array_equal(found.u_abc, expected.u_abc)


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_late_and_repeated_arrivals_are_cut_not_sorted_in(data):
    signals = three(1000)
    which, at, by = data.draw(st.tuples(st.integers(0, 2), st.integers(10, 900), st.integers(1, 8)))
    order = np.arange(1000)
    order[at] = at - by if data.draw(st.booleans()) else at
    order = np.insert(order, at + 1, order[at - 1])
    signals[which] = cut(signals[which], order)
    result = join(*signals)
    told = result.report.warnings[0]
    assert told.values["topic"] == signals[which].name
    assert told.values["repeated"] + told.values["backward"] >= 1
    assert (np.diff(result.samples.stamp) > 0).all()
    for run in result.samples.runs():
        assert (np.diff(result.samples.stamp[run]) == STEP).all()
    np.testing.assert_array_equal(result.samples.i_abc[:, 0], result.samples.speed)
    assert any("were removed" in text for text in result.report.warnings)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_many_backward_stamps_are_refused(which):
    signals = three()
    order = np.arange(1000)
    order[500:520] = order[500:520][::-1]
    signals[which] = cut(signals[which], order)
    with pytest.raises(StampOrderError, match=rf"19 of 1000 stamps of {signals[which].name} .* at 0\.0519"):
        join(*signals)


def test_one_stamp_far_ahead_is_refused():
    signals = three()
    signals[0].stamp[100] += 10**15
    with pytest.raises(StampOrderError, match="run backwards"):
        join(*signals)


@pytest.mark.parametrize(("shift", "warned"), [(-20_000, False), (10_000, False), (40_000, True)])
def test_a_constant_offset_is_allowed_and_told(shift, warned):
    signals = three()
    signals[1] = replace(signals[1], stamp=signals[1].stamp + shift)
    result = join(*signals)
    assert len(result.samples) == 1000
    told = [warning.values["offset"] for warning in result.report.warnings]
    assert told == ([pytest.approx(shift * 1e-9)] if warned else [])


def test_jitter_on_top_of_an_offset_keeps_the_order():
    rng = np.random.default_rng(1)
    signals = three()
    for k, shift in ((1, 35_000), (2, -35_000)):
        signals[k] = replace(signals[k], stamp=signals[k].stamp + shift + rng.integers(-20_000, 20_000, 1000))
    samples = join(*signals).samples
    np.testing.assert_array_equal(samples.i_abc[:, 0], samples.u_abc[:, 0])
    np.testing.assert_array_equal(samples.i_abc[:, 0], samples.speed)
    assert len(samples) == 1000


def test_half_a_period_of_offset_is_refused_for_it_is_ambiguous():
    signals = three()
    signals[1] = replace(signals[1], stamp=signals[1].stamp + 50_000)
    with pytest.raises(DataError, match=r"/u and /i lies half a sample period .* stamp_offset"):
        join(*signals)


def test_clocks_that_drift_apart_are_refused():
    signals = three(100_000)
    signals[1] = replace(signals[1], stamp=START + np.arange(100_000) * (STEP + 5))
    with pytest.raises(DataError, match="wanders"):
        join(*signals)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_values_that_are_not_finite_are_named(value, which):
    signals = three()
    signals[which].values[250, 1] = value
    with pytest.raises(NonFiniteError, match=rf"{signals[which].name} holds 1 sample .* 0\.025000 s"):
        join(*signals)


def test_an_empty_signal_is_named():
    signals = three()
    signals[2] = cut(signals[2], slice(0, 0))
    with pytest.raises(EmptyTopicError, match="/resolver"):
        join(*signals)


def test_no_common_time_names_the_ranges():
    signals = three()
    signals[1] = replace(signals[1], stamp=signals[1].stamp + 10**9)
    with pytest.raises(NoOverlapError, match=r"/i from 0\.000 to 0\.100 s, /u from 1\.000 to 1\.100 s"):
        join(*signals)


def test_single_scattered_samples_are_no_run():
    signals = three(30)
    signals[1] = cut(signals[1], np.arange(30)[np.arange(30) % 4 != 0])
    with pytest.raises(NoOverlapError, match="4 consecutive"):
        join(*signals)


def test_declared_periods_that_disagree():
    signals = three(period=1e-4)
    signals[2] = replace(signals[2], sample_period=2e-4)
    with pytest.raises(SamplePeriodError, match=r"/i declares 100 us but /resolver declares 200 us"):
        join(*signals)


@pytest.mark.parametrize(
    ("value", "said"),
    [(10.0, "10 were in kHz"), (1e4, "1e+04 were in Hz"), (0.1, "in ms"), (100.0, "in us"), (3e-4, "")],
)
def test_a_period_in_a_wrong_unit(value, said):
    with pytest.raises(SamplePeriodError, match=f"as if .*{re.escape(said)}: record" if said else "300 us: record"):
        check_agreement([("the currents declare", 1e-4), ("the stamps have", value)])


def test_stamped_periods_that_disagree():
    signals = three()
    signals[1] = signal("/u", np.arange(500), 3, step=2 * STEP)
    with pytest.raises(SamplePeriodError, match=r"stamps of /i show 100 us but the stamps of /u show 200 us"):
        join(*signals)


def test_a_declared_period_that_the_stamps_of_blocks_deny():
    blocks = np.arange(0, 1000, 50)
    signals = three(period=1e-4, blocks=blocks)
    within = np.arange(1000) % 50
    stamp = START + (np.arange(1000) // 50) * 50 * 110_000 + within * 100_000
    signals = [replace(s, stamp=stamp) for s in signals]
    with pytest.raises(SamplePeriodError, match="show 110 us"):
        join(*signals)


@pytest.mark.parametrize("period", [0.0, -1e-4, np.nan, np.inf, 1e9])
def test_a_period_that_is_none(period):
    with pytest.raises(SamplePeriodError, match="declares a sample period of"):
        join(*three(period=period))


def test_the_measured_period_ignores_losses():
    found = cut(three()[0], np.r_[0:100, 150:1000])
    assert measured_period(found) == pytest.approx(1e-4, rel=1e-12)


def test_speed_is_derived_within_runs_only():
    signals = three()
    full = signals[2]
    signals[2] = replace(full, values=np.mod(0.05 * np.arange(1000) + np.pi, 2 * np.pi)[:, None] - np.pi)
    signals[2] = cut(signals[2], np.r_[0:400, 410:1000])
    samples = join(*signals).samples
    np.testing.assert_allclose(samples.speed, 500.0, rtol=1e-9)


def test_references_are_held_and_nan_where_unknown():
    index = np.arange(100, 600, 10)
    reference = Signal("/r", START + index * STEP, np.column_stack((index, -index)).astype(float), 1e-3)
    held = join(*three(), reference).samples.i_dq_reference
    assert np.isnan(held[:100]).all()
    np.testing.assert_array_equal(held[100:600, 0], np.repeat(index, 10))
    assert np.isnan(held[610:]).all()


def test_references_published_ahead_are_taken_back_by_later_ones():
    index = np.arange(0, 1000)
    ahead = Signal("/r", START + index * STEP, np.column_stack((index, index)).astype(float), 1e-4)
    stop = np.arange(400, 420)  # published when 400 was due, 600 set-points ahead of time
    stamp = np.concatenate((ahead.stamp, START + stop * STEP))
    values = np.concatenate((ahead.values, np.zeros((20, 2))))
    held = join(*three(), Signal("/r", stamp, values, 1e-4)).samples.i_dq_reference
    np.testing.assert_array_equal(held[:400, 0], index[:400])
    np.testing.assert_array_equal(held[400:420], 0.0)
    assert np.isnan(held[422:]).all()


def test_ten_seconds_take_milliseconds():
    import time

    signals = three(100_000)
    start = time.process_time()  # whatever else the machine does
    join(*signals)
    assert time.process_time() - start < 0.5


def test_later_messages_count_for_the_period_as_the_first_ones_do():
    """Of several lengths, with a rate that drifts, pauses, and times that stand still or were set back."""
    count = np.tile([10, 20, 50], 100)
    elapsed = count * (STEP + np.arange(300))
    elapsed[[5, 70, 200]] += 10**9
    elapsed[[8, 90]], elapsed[[11, 210]] = 0, -(10**9)
    stamp = START + np.concatenate([[0], np.cumsum(elapsed)])[:-1]
    few, every = Spacings(kept=30), Spacings()
    for part in np.array_split(np.arange(300), 11):
        few.add(stamp[part], count[part])
        every.add(stamp[part], count[part])
    assert few.period() == pytest.approx(every.period(), rel=1e-12)
    assert few._first().shape == (2, 30)
    assert every.period() == pytest.approx((STEP + 149.5) * 1e-9, rel=1e-4)
