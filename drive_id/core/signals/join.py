"""Join currents, voltages and resolver on one clock, and cut out whatever is not whole.

The stamps of the currents are the clock. All comparisons are made on integer nanoseconds and on differences of
neighbours, so that neither the epoch nor the length of a recording costs precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drive_id.core.signals.join_report import JoinReport, SignalReport, join_warnings, period_text
from drive_id.core.signals.matching import Phase, partners
from drive_id.core.signals.period import check_declared_periods, common_period, measured_period
from drive_id.core.signals.signal import LARGEST_CUT, Ordered, Signal, check_values, finite_rows, in_order
from drive_id.errors import NoOverlapError, SamplePeriodError
from drive_id.types import BoolArray, FloatArray, IntArray, Samples

SHORTEST_RUN = 4
"""Fewest samples of a gap-free run that is kept."""


@dataclass(frozen=True, eq=False)
class JoinResult:
    """What :func:`join` returns: the samples, and what was done to get them."""

    samples: Samples
    report: JoinReport


@dataclass(frozen=True, eq=False)
class _Match:
    """Partners of the clock's samples in another signal: ``index`` (N,), valid where ``found`` (N,); offset in ns."""

    index: IntArray
    found: BoolArray
    offset: int


def join(currents: Signal, voltages: Signal, resolver: Signal, references: Signal | None = None) -> JoinResult:
    """Join the signals of one drive.

    Samples with repeated or backward stamps are cut out. A current sample is kept when voltages and resolver each have
    a sample within half a period of it (after the constant offset between the topics); whatever is cut leaves a gap,
    and a new run starts behind it.

    Parameters
    ----------
    currents, voltages : Signal
        (N, 3) values, A and V.
    resolver : Signal
        (N, 2) values, electrical angle in rad and speed in rad/s, or (N, 1): speed is then derived from the angle.
    references : Signal, optional
        (N, 2) values, current references d, q in A; held until the next one, for at most 1.5 of their periods.

    Raises
    ------
    EmptyTopicError
        When a signal has no sample.
    NonFiniteError
        When a value is NaN or infinite.
    StampOrderError
        When more than 1 % of a signal would have to be cut out.
    SamplePeriodError
        When the periods of the signals, or the declared and the stamped one, differ by more than 1 %.
    NoOverlapError
        When nothing, or no run of a few samples, is common to the three.
    DataError
        When the stamps of two signals are not locked to each other, or lie half a period apart.
    """
    signals = (currents, voltages, resolver)
    for signal in signals:
        check_values(signal)
    check_declared_periods(signals)
    ordered = [in_order(signal) for signal in signals]
    period = common_period(signals)
    clock = ordered[0].stamp
    matches = [_match(ordered[0], other, period) for other in ordered[1:]]
    kept = np.flatnonzero(matches[0].found & matches[1].found)
    if len(kept) == 0:
        raise overlap_error([(entry.signal.name, int(entry.stamp[0]), int(entry.stamp[-1])) for entry in ordered])
    kept, starts, gaps = _runs(clock, kept, period, currents.name)
    stamp = clock[kept]
    position = ordered[2].values[matches[1].index[kept]]
    angle = position[:, 0].copy()
    speed = position[:, 1].copy() if position.shape[1] > 1 else derived_speed(angle, starts, period)
    samples = Samples(
        stamp=stamp,
        i_abc=ordered[0].values[kept],
        u_abc=ordered[1].values[matches[0].index[kept]],
        angle=angle,
        speed=speed,
        sample_period=period,
        run_starts=starts,
        i_dq_reference=None if references is None else _held(references, stamp, period),
    )
    reports = tuple(
        _signal_report(entry, matched, len(samples)) for entry, matched in zip(ordered, (None, *matches), strict=True)
    )
    lost_time = float(np.sum(np.diff(stamp)[starts[1:] - 1]) * 1e-9 - period * (len(starts) - 1))
    report = JoinReport(reports, period, len(samples), len(starts), lost_time, gaps)
    return JoinResult(samples, report.with_warnings(join_warnings(report)))


def _match(currents: Ordered, other: Ordered, period: float) -> _Match:
    """Find the partner of each current sample, allowing for a constant offset below half a period."""
    clock, step = currents.stamp, period * 1e9
    offset = Phase.of(clock, other.stamp, step).offset(step, other.signal.name, currents.signal.name)
    index, found = partners(clock, other.stamp, offset, step)
    return _Match(index, found, offset)


def _runs(clock: IntArray, kept: IntArray, period: float, name: str) -> tuple[IntArray, IntArray, int]:
    """Divide the kept samples into gap-free runs and drop the shortest.

    Returns
    -------
    kept : (N,) int64
    starts : (S,) int64
        Index into ``kept`` of the first sample of each run.
    gaps : int
        Number of breaks before short runs were dropped.
    """
    step = np.diff(clock[kept])
    early = step < 0.5e9 * period
    if early.sum() > LARGEST_CUT * len(kept):
        k = int(np.argmax(early))
        raise early_error(name, int(early.sum()), int(clock[kept[k]]) - int(clock[0]), period)
    breaks = np.flatnonzero((step > 1.5e9 * period) | early) + 1
    starts = np.concatenate(([0], breaks))
    length = np.diff(np.append(starts, len(kept)))
    long = length >= SHORTEST_RUN
    if not long.any():
        raise no_run_error(name)
    kept = kept[np.repeat(long, length)]
    starts = np.concatenate(([0], np.cumsum(length[long])[:-1]))
    return kept, starts.astype(np.int64), len(breaks)


def derived_speed(angle: FloatArray, starts: IntArray, period: float) -> FloatArray:
    """Differentiate the angle (N,) within each run by central differences, rad/s."""
    speed = np.empty_like(angle)
    with np.errstate(over="ignore", invalid="ignore"):  # absurd angles give infinite speeds, which Samples refuses
        for start, end in zip(starts, np.append(starts[1:], len(angle)), strict=True):
            speed[start:end] = np.gradient(np.unwrap(angle[start:end]), period)
    return speed


def _held(references: Signal, stamp: IntArray, period: float) -> FloatArray | None:
    """Hold each reference until the next one, for at most 1.5 of their periods; NaN (N, 2) where there is none.

    References are published ahead of time, and later ones take back what is due at or after their stamps.
    """
    known = finite_rows(references.values)
    if not known.any():
        return None
    given, values = references.stamp[known], references.values[known]
    stands = given[:-1] < np.minimum.accumulate(given[::-1])[::-1][1:]
    given, values = given[np.append(stands, True)], values[np.append(stands, True)]
    own = references.sample_period or measured_period(references) or period
    index = np.searchsorted(given, stamp + int(0.1e9 * period), side="right") - 1
    first = np.maximum(index, 0)
    valid = (index >= 0) & (stamp - given[first] <= 1.5e9 * own)
    return np.where(valid[:, None], values[first], np.nan)


def _signal_report(ordered: Ordered, match: _Match | None, used: int) -> SignalReport:
    signal = ordered.signal
    return SignalReport(
        topic=signal.name,
        read=len(signal.stamp),
        used=used,
        repeated=ordered.repeated,
        backward=ordered.backward,
        lost=signal.lost,
        losses=signal.losses,
        offset=0.0 if match is None else match.offset * 1e-9,
        declared_period=signal.sample_period,
        measured_period=measured_period(signal),
    )


def early_error(name: str, count: int, after: int, period: float) -> SamplePeriodError:
    """Return the error for samples that follow each other too soon, the first ``after`` ns behind the start."""
    return SamplePeriodError(
        f"{count} samples of {name} follow each other within half of the sample period "
        f"{period_text(period)}, the first {after * 1e-9:.6f} s after its start: "
        "correct sample_period or the stamp source in a signals file."
    )


def no_run_error(name: str) -> NoOverlapError:
    """Return the error for samples that are too scattered."""
    return NoOverlapError(
        f"No {SHORTEST_RUN} consecutive samples of {name} have partners in voltages and resolver: "
        "record the signals without losses."
    )


def overlap_error(ranges: Sequence[tuple[str, int, int]]) -> NoOverlapError:
    """Return the error for signals, given by name, first and last stamp, ns, that share no sample."""
    start = min(first for _, first, _ in ranges)
    text = ", ".join(
        f"{name} from {(first - start) * 1e-9:.3f} to {(last - start) * 1e-9:.3f} s" for name, first, last in ranges
    )
    return NoOverlapError(
        f"The signals share no sample ({text}, counted from stamp {start} ns): record them at the same time, or take "
        "another stamp source in a signals file."
    )
