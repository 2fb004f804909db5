"""Optional signals on the samples' stamps, however the streams are cut, against a sample-by-sample oracle."""

from __future__ import annotations

import bisect
import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from drive_id.core.signals.join import StreamJoin, join, joined
from drive_id.core.signals.signal import Signal
from drive_id.errors import NoOverlapError

START = 1_700_000_000_123_456_789
PERIOD = 0.01
STEP = 10_000_000
NAMES = ("/i", "/u", "/resolver")


def drive_signals(n):
    index = np.arange(n)
    stamp = START + index * STEP
    values = [index[:, None] + 0.1 * np.arange(3), 0.3 + 0.1 * np.arange(3) + 0.0 * index[:, None]]
    values.append(np.stack([0.01 * index, np.full(n, 1.0)], axis=1))
    return [Signal(name, stamp, value, PERIOD) for name, value in zip(NAMES, values, strict=True)]


def fed(joining, signals, at):
    """Add 100 samples of all signals, and return the pieces."""
    part = slice(at, at + 100)
    return [
        piece
        for k, signal in enumerate(signals)
        for piece in joining.add(k, replace(signal, stamp=signal.stamp[part], values=signal.values[part]))
    ]


def scalar(stamp, values, period=None, name="/scalar"):
    return Signal(name, np.asarray(stamp, np.int64), np.asarray(values, float)[:, None], period)


def oracle(stamp, values, period, wanted):
    """Interpolate one value after the other by the rule in words."""
    reach = max(3 * period, 2.0) * 1e9
    stamp, found = stamp.tolist(), []
    for t in wanted.tolist():
        a, b = bisect.bisect_right(stamp, t) - 1, bisect.bisect_left(stamp, t)
        if a >= 0 and b < len(stamp) and stamp[b] - stamp[a] <= reach:
            share = (t - stamp[a]) / (stamp[b] - stamp[a]) if b != a else 0.0
            found.append(values[a] + share * (values[b] - values[a]))
            continue
        near = [(abs(stamp[k] - t), values[k]) for k in (a, b) if 0 <= k < len(stamp)]
        distance, value = min(near, key=lambda entry: entry[0], default=(np.inf, np.nan))
        found.append(value if distance <= reach else np.nan)
    return np.array(found)


@pytest.mark.slow  # the oracle joins thousands of cuts row by row
@settings(max_examples=30, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(st.data())
def test_any_cut_of_the_streams_gives_the_oracle(data):
    n = data.draw(st.integers(300, 2500))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    period = data.draw(st.sampled_from([0.003, 0.01, 0.13, 1.0, 4.0]))
    stamp = (
        START
        + np.arange(-2e8, n * STEP + 2e8, period * 1e9).astype(np.int64)
        + data.draw(st.just(0) | st.integers(0, STEP))
    )
    gap = data.draw(st.integers(0, len(stamp)))
    stamp = np.delete(stamp, slice(gap, gap + data.draw(st.integers(0, 1 + round(6 / period)))))
    values = rng.normal(size=len(stamp))
    declared = data.draw(st.booleans()) or len(stamp) < 3 or gap < 2
    signals, extra = drive_signals(n), scalar(stamp, values, period if declared else None)
    expected = oracle(stamp, values, period, signals[0].stamp)
    whole = join(*signals, scalars={"shaft_torque": extra}).samples
    found = np.full(n, np.nan) if whole.shaft_torque is None else whole.shaft_torque
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)

    joining = StreamJoin(NAMES, batch=data.draw(st.sampled_from([1, 50])), locking=50, scalars={"shaft_torque": "/s"})
    parts = [(s.stamp, k, s) for k, s in enumerate([*signals, extra])]
    sizes = [data.draw(st.sampled_from([1, 7, 90])) for _ in parts]
    blocks = []
    for (stamps, k, s), size in zip(parts, sizes, strict=True):
        breaks = [0, gap if k == 3 else 0, len(stamps)]  # no block spans the gap
        for first, last in itertools.pairwise(breaks):
            for at in range(first, last, size):
                part = slice(at, min(at + size, last))
                block = replace(s, stamp=s.stamp[part], values=s.values[part])
                blocks.append((int(block.stamp[-1]), k, block))
    pieces, longest = [], 0
    for _, k, block in sorted(blocks, key=lambda entry: entry[:2]):  # each block arrives when it is full
        if k < 3:
            pieces += joining.add(k, block)
        else:
            joining.add_scalar("shaft_torque", block)
        longest = max(longest, sum(len(piece.samples) - piece.continues for piece in joining._waiting))
    end, rest = joining.finished()
    end.check()
    again = joined([*pieces, *rest])
    if joining.late:  # blocks that are longer than the patience: bags are then read as a whole
        assert sizes[3] * period > 2
        return
    streamed = np.full(n, np.nan) if again.shaft_torque is None else again.shaft_torque
    np.testing.assert_array_equal(streamed, found)
    np.testing.assert_array_equal(again.i_abc, whole.i_abc)
    assert longest <= 2 * max(3 * period, 2.0) / PERIOD + 300


def test_a_sensor_that_falls_silent_does_not_stop_the_others():
    signals = drive_signals(3000)
    joining = StreamJoin(NAMES, batch=100, locking=50)
    pieces = []
    for at in range(0, 3000, 100):
        part = slice(at, at + 100)
        if at < 1000:
            stamp = signals[0].stamp[part][::50]
            joining.add_scalar("winding_temperature", scalar(stamp, np.full(2, 60.0), 0.5))
        pieces += fed(joining, signals, at)
    found = joined(pieces)
    assert len(found) > 3000 - 100 - 450
    last = int(np.flatnonzero(np.isfinite(found.winding_temperature))[-1])
    assert last == 950 + 200  # the last value, 9.5 s, and the 2 s for which it is held
    end, _ = joining.finished()
    assert "/scalar is unknown for 18.490 s of data" in end.report().warnings[-1]


def test_a_slow_sensor_is_waited_for_in_bounded_memory():
    """Its last value is held where there is no room to wait for the next one, 20 s later."""
    signals, values = drive_signals(5000), {0: 20.0, 2000: 30.0, 4000: 40.0}
    joining, pieces, longest = StreamJoin(NAMES, batch=100, locking=50, capacity=500), [], 0
    for at in range(0, 5000, 100):
        if at in values:
            joining.add_scalar("magnet_temperature", scalar(signals[0].stamp[[at]], [values[at]], 20.0))
        pieces += fed(joining, signals, at)
        longest = max(longest, sum(len(piece.samples) for piece in joining._waiting))
    assert longest <= 500
    found = joined([*pieces, *joining.finished()[1]]).magnet_temperature
    assert found[[0, 1000, 2000, 3000, 4000, 4999]].tolist() == [20.0, 20.0, 30.0, 30.0, 40.0, 40.0]


def test_a_late_joiner_is_unknown_before():
    signals = drive_signals(1500)
    joining, pieces = StreamJoin(NAMES, batch=100, locking=50), []
    for at in range(0, 1500, 100):
        part = slice(at, at + 100)
        if at >= 800:
            joining.add_scalar("shaft_torque", scalar(signals[0].stamp[part], np.arange(at, at + 100), PERIOD))
        pieces += fed(joining, signals, at)
    assert pieces[0].samples.shaft_torque is None
    found = joined([*pieces, *joining.finished()[1]])
    np.testing.assert_array_equal(found.shaft_torque[800:], np.arange(800.0, 1500.0))
    assert not joining.late


def test_samples_that_come_after_the_patience_are_late():
    signals = drive_signals(1500)
    joining = StreamJoin(NAMES, batch=100, locking=50, scalars={"shaft_torque": "/scalar"})
    for at in range(0, 1500, 100):
        fed(joining, signals, at)
    assert not joining.late
    joining.add_scalar("shaft_torque", scalar(signals[0].stamp[:200], np.zeros(200), PERIOD))
    assert joining.late


def test_values_out_of_order_and_not_finite_are_dropped():
    signals = drive_signals(400)
    stamp = signals[0].stamp[[0, 100, 50, 100, 200, 300, 399]]
    extra = scalar(stamp, [0.0, 1.0, 77.0, 78.0, np.nan, 3.0, 3.99], 1.0)
    found = join(*signals, scalars={"dc_link_voltage": extra}).samples.dc_link_voltage
    np.testing.assert_allclose(found, 0.01 * np.arange(400), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("streamed", [False, True])
def test_duty_cycles_are_cut_where_the_dc_link_voltage_is_unknown(streamed):
    signals = drive_signals(2000)
    stamp = np.concatenate([signals[0].stamp[500:900], signals[0].stamp[1500:1990]])
    u_dc = scalar(stamp, 500.0 + np.arange(len(stamp)), PERIOD)
    if streamed:
        joining = StreamJoin(
            NAMES, batch=70, locking=50, scalars={"dc_link_voltage": "/u_dc"}, scaled_by="dc_link_voltage"
        )
        joining.add_scalar("dc_link_voltage", u_dc)
        pieces = []
        for at in range(0, 2000, 70):
            for k, s in enumerate(signals):
                pieces += joining.add(k, replace(s, stamp=s.stamp[at : at + 70], values=s.values[at : at + 70]))
        end, rest = joining.finished()
        end.check()
        samples, report = joined([*pieces, *rest]), end.report()
    else:
        result = join(*signals, scalars={"dc_link_voltage": u_dc}, scaled_by="dc_link_voltage")
        samples, report = result.samples, result.report
    kept = np.r_[300:1100, 1300:2000]  # with 2 s on either side
    np.testing.assert_array_equal(samples.stamp, signals[0].stamp[kept])
    assert samples.run_starts.tolist() == [0, 800]
    np.testing.assert_allclose(samples.u_abc, signals[1].values[kept] * samples.dc_link_voltage[:, None], rtol=1e-12)
    assert samples.dc_link_voltage[200] == 500.0
    assert "500 samples were cut out, because their voltages are duty cycles" in report.warnings[-1]
    assert report.samples == 1500


def test_duty_cycles_without_any_dc_link_voltage_are_refused():
    signals = drive_signals(200)
    far = scalar(signals[0].stamp + 60_000_000_000, np.full(200, 500.0), PERIOD)
    with pytest.raises(NoOverlapError, match="duty cycles, and the DC-link voltage is unknown during all of them"):
        join(*signals, scalars={"dc_link_voltage": far}, scaled_by="dc_link_voltage")
