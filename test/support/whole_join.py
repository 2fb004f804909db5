"""The join of whole signals, all at once: the oracle of :mod:`drive_id.core.signals.join`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drive_id.core.signals.join import SHORTEST_RUN
from drive_id.core.signals.matching import Phase, partners
from drive_id.core.signals.period import check_agreement, measured_period
from drive_id.core.signals.signal import LARGEST_CUT, Signal, finite_rows
from drive_id.errors import EmptyTopicError, NonFiniteError, NoOverlapError, SamplePeriodError, StampOrderError
from drive_id.types import BoolArray, FloatArray, IntArray, Samples


@dataclass(frozen=True, eq=False)
class Ordered:
    """A signal without its repeated and backward stamps."""

    signal: Signal
    stamp: IntArray
    values: FloatArray
    repeated: int
    backward: int


@dataclass(frozen=True, eq=False)
class _Match:
    """Partners of the clock's samples in another signal: ``index`` (N,), valid where ``found`` (N,); offset in ns."""

    index: IntArray
    found: BoolArray
    offset: int


@dataclass(frozen=True, eq=False)
class WholeJoin:
    """Joined samples; number of breaks, time between the runs, s, and per signal what was cut and its offset, ns."""

    samples: Samples
    gaps: int
    time_lost: float
    ordered: list[Ordered]
    offsets: tuple[int, ...]


def whole_join(currents: Signal, voltages: Signal, resolver: Signal, references: Signal | None = None) -> WholeJoin:
    signals = (currents, voltages, resolver)
    for signal in signals:
        check_values(signal)
    check_agreement(declared_periods(signals))
    ordered = [in_order(signal) for signal in signals]
    period = common_period(signals)
    clock = ordered[0].stamp
    matches = [_match(ordered[0], other, period) for other in ordered[1:]]
    kept = np.flatnonzero(matches[0].found & matches[1].found)
    if len(kept) == 0:
        raise NoOverlapError
    kept, starts, gaps = _runs(clock, kept, period)
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
    lost_time = float(np.sum(np.diff(stamp)[starts[1:] - 1]) * 1e-9 - period * (len(starts) - 1))
    return WholeJoin(samples, gaps, lost_time, ordered, (0, *(match.offset for match in matches)))


def _match(currents: Ordered, other: Ordered, period: float) -> _Match:
    """Find the partner of each current sample, allowing for a constant offset below half a period."""
    clock, step = currents.stamp, period * 1e9
    offset = Phase.of(clock, other.stamp, step).offset(step, other.signal.name, currents.signal.name)
    index, found = partners(clock, other.stamp, offset, step)
    return _Match(index, found, offset)


def _runs(clock: IntArray, kept: IntArray, period: float) -> tuple[IntArray, IntArray, int]:
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
        raise SamplePeriodError
    breaks = np.flatnonzero((step > 1.5e9 * period) | early) + 1
    starts = np.concatenate(([0], breaks))
    length = np.diff(np.append(starts, len(kept)))
    long = length >= SHORTEST_RUN
    if not long.any():
        raise NoOverlapError
    kept = kept[np.repeat(long, length)]
    starts = np.concatenate(([0], np.cumsum(length[long])[:-1]))
    return kept, starts.astype(np.int64), len(breaks)


def derived_speed(angle: FloatArray, starts: IntArray, period: float) -> FloatArray:
    """Differentiate the angle (N,) within each run by central differences, rad/s."""
    speed = np.empty_like(angle)
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


def declared_periods(signals: Sequence[Signal]) -> list[tuple[str, float]]:
    declared = [(signal.name, signal.sample_period) for signal in signals if signal.sample_period is not None]
    if not all(1e-9 <= period < 1e4 for _, period in declared):
        raise SamplePeriodError
    return declared


def check_values(signal: Signal) -> None:
    if len(signal.stamp) == 0:
        raise EmptyTopicError
    if not finite_rows(signal.values).all():
        raise NonFiniteError


def in_order(signal: Signal) -> Ordered:
    """Cut out every sample whose stamp does not exceed all stamps before it."""
    stamp, values = signal.stamp, signal.values
    seen = np.maximum.accumulate(stamp)
    step = np.diff(stamp)
    repeated = (stamp[1:] == seen[:-1]) | (step == 0)
    behind = stamp[1:] <= seen[:-1]
    cut = int(behind.sum())
    if cut > LARGEST_CUT * len(stamp):
        raise StampOrderError
    kept = np.concatenate(([True], ~behind))
    n_repeated = int(repeated.sum())
    return Ordered(signal, stamp[kept], values[kept], n_repeated, cut - n_repeated)


def common_period(signals: Sequence[Signal]) -> float:
    """Return the sample period on which all signals agree, s.

    Raises
    ------
    SamplePeriodError
        When a period is not positive, not known, or two differ by more than 1 %.
    """
    claims = declared_periods(signals)
    for signal in signals:
        measured = measured_period(signal)
        if measured is not None:
            claims.append((signal.name, measured))
    if not claims:
        raise SamplePeriodError
    check_agreement(claims)
    return claims[0][1]
