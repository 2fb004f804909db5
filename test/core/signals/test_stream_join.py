"""The streaming join, whatever the interleaving and the size of the blocks, against a join of whole signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import record
from whole_join import whole_join

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.signals.join import StreamJoin, join
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
NAMES = ("/i", "/u", "/resolver")


def signals_of(samples, shifts=(0, 0, 0)):
    values = (samples.i_abc, samples.u_abc, np.column_stack((samples.angle, samples.speed)))
    return [
        Signal(name, samples.stamp + shift, value, samples.sample_period)
        for name, value, shift in zip(NAMES, values, shifts, strict=True)
    ]


def plain(n, shifts=(0, 0, 0)):
    index = np.arange(n)
    values = [index[:, None] + 0.1 * np.arange(3), -index[:, None] + 0.1 * np.arange(3), np.stack([index, index], 1)]
    return [
        Signal(name, START + shift + index * STEP, value.astype(float), 1e-4)
        for name, value, shift in zip(NAMES, values, shifts, strict=True)
    ]


def take(signal, part):
    return replace(signal, stamp=signal.stamp[part], values=signal.values[part])


def stream(signals, sizes, order, *, batch=50, **options):
    """Feed signals in blocks; ``order`` yields which one is next while they last."""
    joined, pieces, at = StreamJoin(NAMES, batch=batch, **options), [], [0, 0, 0]
    for k in order:
        if at[k] < len(signals[k].stamp):
            pieces += joined.add(k, take(signals[k], slice(at[k], at[k] + sizes[k])))
            at[k] += sizes[k]
    for k in range(3):
        while at[k] < len(signals[k].stamp):
            pieces += joined.add(k, take(signals[k], slice(at[k], at[k] + sizes[k])))
            at[k] += sizes[k]
    end, rest = joined.finished()
    return end, pieces + rest


def concatenated(pieces):
    """Put the pieces together again: stamps, values, and the starts of the runs."""
    stamp, values, starts = [], [], []
    count = 0
    for number, piece in enumerate(pieces):
        samples, skip = piece.samples, int(piece.continues)
        if piece.continues:
            assert samples.stamp[0] == pieces[number - 1].samples.stamp[-1]
        starts += [int(s) - skip + count for s in samples.run_starts if not (piece.continues and s == 0)]
        stamp.append(samples.stamp[skip:])
        columns = (samples.i_abc, samples.u_abc, samples.angle, samples.speed)
        values.append(np.column_stack(columns)[skip:])
        count += len(samples) - skip
    return np.concatenate(stamp), np.concatenate(values), starts


def assert_same(end, pieces, signals):
    expected = whole_join(*signals)
    samples = expected.samples
    stamp, values, starts = concatenated(pieces)
    np.testing.assert_array_equal(stamp, samples.stamp)
    np.testing.assert_array_equal(values, np.column_stack((samples.i_abc, samples.u_abc, samples.angle, samples.speed)))
    assert starts == samples.run_starts.tolist()
    assert all(piece.samples.sample_period == samples.sample_period for piece in pieces)
    end.check()
    assert (end.samples, end.runs, end.gaps) == (len(samples), len(samples.run_starts), expected.gaps)
    assert end.time_lost * 1e-9 == pytest.approx(expected.time_lost, abs=1e-9)
    for mine, other in zip(end.tracks, expected.ordered, strict=True):
        assert (mine.read, mine.repeated, mine.backward, mine.lost, mine.losses) == (
            len(other.signal.stamp), other.repeated, other.backward, other.signal.lost, other.signal.losses
        )  # fmt: skip
    assert (0, *end._offsets) == pytest.approx(expected.offsets, abs=1000)


SIZES = st.tuples(*[st.sampled_from([1, 7, 30, 100, 333])] * 3)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_the_pieces_are_the_offline_join(data):
    """Losses, repeated and late stamps, a constant offset, jitter; any blocks in any interleaving."""
    n = data.draw(st.integers(20, 1300))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    shifts = (0, data.draw(st.sampled_from([0, 20_000, -30_000])), data.draw(st.sampled_from([0, -10_000])))
    signals = plain(n, shifts)
    jitter = data.draw(st.sampled_from([0, 5_000]))
    for k in range(3):
        lost = data.draw(st.integers(0, 6))
        keep = np.setdiff1d(np.arange(n), (rng.integers(0, n, lost)[:, None] + np.arange(rng.integers(1, 6))).ravel())
        order = np.sort(keep)
        if n > 400 and data.draw(st.booleans()):
            at = int(rng.integers(5, len(order) - 5))
            order = np.insert(order, at, order[at - int(rng.integers(1, 4))])
        signals[k] = take(signals[k], order)
        noise = rng.integers(-jitter, jitter + 1, len(order))
        signals[k] = replace(signals[k], stamp=signals[k].stamp + np.where(np.diff(order, prepend=-1) > 0, noise, 0))
    order = rng.integers(0, 3, 3 * n) if data.draw(st.booleans()) else np.repeat(rng.permutation(3), n)
    batch = data.draw(st.sampled_from([10, 97, 1000]))
    try:
        whole_join(*signals)
    except (DataError, EmptyTopicError) as error:
        end, _ = stream(signals, data.draw(SIZES), order, batch=batch)
        with pytest.raises(type(error)):
            end.check()
        return
    assert_same(*stream(signals, data.draw(SIZES), order, batch=batch), signals)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_whole_signals_without_a_bound_are_the_offline_join(data):
    """Strangers' signals: perhaps no declared period and no speed, references of their own rate."""
    n = data.draw(st.integers(20, 1300))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    shifts = (0, data.draw(st.sampled_from([0, 20_000, -30_000])), data.draw(st.sampled_from([0, -10_000])))
    signals = plain(n, shifts)
    jitter, declared = data.draw(st.sampled_from([0, 5_000])), data.draw(st.sampled_from([(0, 1, 2), (1,), (2,), ()]))
    for k in range(3):
        keep = np.setdiff1d(np.arange(n), rng.integers(0, n, data.draw(st.integers(0, 6))))
        signals[k] = take(signals[k], keep)
        noise = rng.integers(-jitter, jitter + 1, len(keep))
        period = signals[k].sample_period if k in declared else None
        signals[k] = replace(signals[k], stamp=signals[k].stamp + noise, sample_period=period)
    if data.draw(st.booleans()):
        signals[2] = replace(signals[2], values=np.mod(0.05 * signals[2].values[:, :1] + np.pi, 2 * np.pi) - np.pi)
    if data.draw(st.booleans()):
        index = np.arange(n // 3, n, 5)
        values = np.stack([index, -index], axis=-1).astype(float)
        period = data.draw(st.sampled_from([5e-4, None]))
        signals.append(Signal("/r", START + index * STEP, values, period))
    try:
        expected = whole_join(*signals)
    except DataError as error:
        with pytest.raises(type(error)):
            join(*signals)
        return
    found = join(*signals)
    for name in ("stamp", "i_abc", "u_abc", "angle", "speed", "run_starts"):
        np.testing.assert_array_equal(getattr(found.samples, name), getattr(expected.samples, name), err_msg=name)
    assert found.samples.sample_period == expected.samples.sample_period
    assert (found.samples.i_dq_reference is None) == (expected.samples.i_dq_reference is None)
    if expected.samples.i_dq_reference is not None:
        np.testing.assert_array_equal(found.samples.i_dq_reference, expected.samples.i_dq_reference)
    assert (found.report.samples, found.report.gaps) == (len(expected.samples), expected.gaps)
    told = {warning.code: warning.values for warning in found.report.warnings}
    assert ("gaps" in told) == (expected.gaps > 0)
    if "gaps" in told:
        assert told["gaps"]["runs"] == len(expected.samples.run_starts)
        assert told["gaps"]["time_lost"] == pytest.approx(expected.time_lost, abs=1e-9)


@pytest.mark.parametrize(("wait", "least"), [(0.0, 50), (0.03, 300), (10.0, 1000)])
def test_waiting_for_some_time_of_samples(wait, least):
    """Never for more than half of what may wait for partners."""
    signals, sizes = plain(4000), []
    joined = StreamJoin(NAMES, batch=50, wait=wait, capacity=2000, locking=40)
    for at in range(0, 4000, 10):
        for k in range(3):
            sizes += [len(piece.samples) for piece in joined.add(k, take(signals[k], slice(at, at + 10)))]
    assert least <= max(sizes) <= 1.2 * least
    end, rest = joined.finished()
    assert sum(sizes) + sum(len(piece.samples) for piece in rest) >= 4000
    assert not any(track.given_up for track in end.tracks)


@pytest.mark.slow  # streams are cut in many ways
@settings(max_examples=15, deadline=None)
@given(st.data())
def test_live_evidence_is_the_evidence_of_the_whole(data):
    samples = record(duration=0.4, i_max=100.0)
    lost = data.draw(st.sets(st.integers(0, len(samples) - 1), max_size=5))
    keep = np.array(sorted(set(range(len(samples))) - lost))
    signals = signals_of(samples)
    signals[1] = take(signals[1], keep)
    order = np.random.default_rng(data.draw(st.integers(0, 99))).integers(0, 3, 3000)
    end, pieces = stream(signals, data.draw(SIZES), order, batch=data.draw(st.sampled_from([20, 300, 1000])))
    end.check()
    live, whole = (Evidence.within(FitSettings(method="joint"), 100.0) for _ in range(2))
    for piece in pieces:
        live.add(piece.samples, continues=piece.continues)
    whole.add(whole_join(*signals).samples)
    total = whole.information.total
    scale = np.sqrt(np.outer(np.diag(total), np.diag(total)))
    np.testing.assert_allclose(live.information.total, total, atol=1e-12 * scale.max(), rtol=1e-9)
    assert np.all(np.abs(live.information.total - total) <= 1e-12 * scale + 1e-300)
    assert (live.samples, live.gaps, live.information.rows, live.information.outside) == (
        whole.samples, whole.gaps, whole.information.rows, whole.information.outside
    )  # fmt: skip
    assert len(live.information.blocks) == len(whole.information.blocks)
    np.testing.assert_array_equal(live.visits.count, whole.visits.count)
    assert live.sample_period == pytest.approx(whole.sample_period, rel=1e-12)


def test_a_stream_can_be_finished_many_times_and_goes_on():
    signals = plain(3000)
    joined, pieces = StreamJoin(NAMES, batch=100), []
    for at in range(0, 3000, 60):
        for k in range(3):
            pieces += joined.add(k, take(signals[k], slice(at, at + 60)))
        end, rest = joined.finished()
        if at:
            assert_same(end, pieces + rest, [take(signal, slice(0, at + 60)) for signal in signals])


def test_memory_stays_bounded_when_a_signal_is_missing_and_comes_back():
    signals = plain(20_000)
    gone = np.r_[0:5000, 12_000:20_000]
    joined, pieces = StreamJoin(NAMES, batch=100, capacity=2000), []
    for at in range(0, 20_000, 50):
        for k in range(3):
            part = slice(at, at + 50)
            if k != 1 or at in gone:
                pieces += joined.add(k, take(signals[k], part))
            assert len(joined.tracks[k].stamp) + joined.tracks[k].fresh <= 2200
    end, rest = joined.finished()
    stamp, _, starts = concatenated(pieces + rest)
    assert stamp.tolist() == signals[0].stamp[gone].tolist()
    assert starts == [0, 5000]
    end.check()
    assert joined.tracks[0].given_up + joined.tracks[2].given_up > 0
    assert any("waited too long" in text for text in end.report().warnings)


def test_what_is_wrong_is_said_as_the_offline_join_says_it():
    order = np.tile([0, 1, 2], 2000)
    drifting = START + np.arange(2000) * (STEP + 200)
    cases = [
        (EmptyTopicError, lambda s: s.__setitem__(2, take(s[2], slice(0, 0)))),
        (NonFiniteError, lambda s: s[1].values.__setitem__((250, 1), np.nan)),
        (StampOrderError, lambda s: s.__setitem__(0, take(s[0], np.r_[0:560, 500:2000]))),
        (SamplePeriodError, lambda s: s.__setitem__(2, replace(s[2], sample_period=2e-4))),
        (NoOverlapError, lambda s: s.__setitem__(1, replace(s[1], stamp=s[1].stamp + 10**10))),
        (DataError, lambda s: s.__setitem__(1, replace(s[1], stamp=s[1].stamp + STEP // 2))),
        (DataError, lambda s: s.__setitem__(1, replace(s[1], stamp=drifting))),
    ]
    for kind, spoil in cases:
        signals = plain(2000)
        spoil(signals)
        with pytest.raises(kind):
            whole_join(*signals)
        with pytest.raises(kind) as expected:
            join(*signals)
        end, _ = stream(signals, (50, 50, 50), order)
        with pytest.raises(kind) as found:
            end.check()
        if kind is not EmptyTopicError:
            assert str(found.value) == str(expected.value)


def test_a_change_of_rate_is_a_fault_until_the_reset():
    signals = plain(500)
    joined = StreamJoin(NAMES, batch=50)
    for k in range(3):
        joined.add(k, signals[k])
    joined.add(1, replace(signals[1], stamp=signals[1].stamp + 10**9, sample_period=2e-4))
    end, _ = joined.finished()
    with pytest.raises(SamplePeriodError, match=r"/u changes from 0\.0001 to 0\.0002 s"):
        end.check()


@pytest.mark.parametrize("size", [100, 50, 25])
def test_a_partner_at_the_end_of_one_part_does_not_serve_again_in_the_next(size):
    """Stamps of the clock jitter by 0.45 periods, so that samples 49 and 50 are near the same voltage."""
    signals = plain(200)
    stamp = signals[0].stamp.copy()
    stamp[50] -= 55_000
    signals[0] = replace(signals[0], stamp=stamp)
    end, pieces = stream(signals, (size, size, size), [1, 2, 0] * 8, batch=size, locking=20)
    assert_same(end, pieces, signals)
    assert START + 50 * STEP - 55_000 not in concatenated(pieces)[0]
