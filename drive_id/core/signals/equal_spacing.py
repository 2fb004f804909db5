"""Equally spaced samples whose stamps jitter, as those of arrival do: the time from the number of the sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.errors import SamplePeriodError
from drive_id.quantity import counted
from drive_id.types import FloatArray, IntArray

_WINDOW = 128
"""Messages on each side of a suspected gap over which delays are compared."""
_FEWEST = 16
"""Least number of them: their median must not be that of a few late ones."""
_SUSPECT = 1.5
"""Samples of time without a message from which a gap is suspected."""
_SHARED = 0.3
"""Share of stamps equal to the one before, from which on they are printed with too few digits."""
_OUTLYING = 4.0  # standard deviations by which a message is delayed that does not count for the period


@dataclass(frozen=True, eq=False)
class EqualSpacing:
    """Regular stamps of messages, and losses: known by the count, or else inferred from lasting steps of the stamps."""

    stamp: IntArray  # (B,), of the first sample of each message, ns
    period: float  # s
    jitter: float  # root mean square distance of the recorded stamps from these, s
    missing: int  # samples between the messages
    gaps: int  # places where samples are missing


def equal_spacing(
    stamp: IntArray, samples: IntArray, first: IntArray | None = None, period: float | None = None, name: str = "signal"
) -> EqualSpacing:
    """Replace stamps that jitter by those of equally spaced samples.

    Raises SamplePeriodError when the stamps do not advance, so that there is no period.

    Parameters
    ----------
    stamp, samples : (B,) int64
        Recorded stamps of the messages in order of their samples, ns, which may run backwards, and samples in each.
    first : (B,) int64, optional
        Running count of the first sample of each message; a count that restarts begins a new stretch. Without it,
        nothing is lost but where the stamps step forward by whole periods for good.
    period : float, optional
        Sample period, s; default: total time over the number of samples.
    """
    count = np.concatenate([[0], np.cumsum(samples)[:-1]]).astype(np.int64)
    since: FloatArray = (stamp - stamp[0]).astype(np.float64)
    index = count if first is None else first - first[0]
    restarts = np.flatnonzero(np.diff(index) < samples[:-1]) + 1
    if first is not None and len(restarts) > 0.01 * len(stamp):
        raise SamplePeriodError(
            f"The running count of {name} runs backwards in {counted(len(restarts), 'place')}: name the right field as "
            "first_sample, or remove it."
        )
    step = 1e9 * period if period else _usual_step(since, count)
    if not step > 0:
        raise SamplePeriodError(
            f"The stamps of {name} do not advance, so the period of its equally spaced samples is unknown: give "
            "sample_period."
        )
    if first is None:
        index = count + _inferred_losses(since - count * step, np.diff(since), np.diff(count), step)
    else:
        lag = np.zeros(len(index), np.int64)  # after a restart, the count goes on from where time says
        for k in restarts:
            elapsed = max(round((since[k] - since[k - 1]) / step), int(samples[k - 1]))
            lag[k:] += int(index[k - 1] - index[k]) + elapsed
        index = index + lag
    if period is None:
        step = _fitted_step(index, since, step)
    offset = float(np.median(since - index * step))
    regular = int(stamp[0]) + np.rint(offset + index * step).astype(np.int64)
    missing = np.diff(index) - samples[:-1]
    return EqualSpacing(
        stamp=regular,
        period=step * 1e-9,
        jitter=float(np.sqrt(np.mean((stamp - regular).astype(np.float64) ** 2))) * 1e-9,
        missing=int(missing.sum()),
        gaps=int((missing > 0).sum()),
    )


def _usual_step(since: FloatArray, count: IntArray) -> float:
    """Return the sample period, ns, as the median over stretches, so that gaps do not count."""
    reach = min(max(len(since) // 8, 1), 1000)
    if len(since) < 2:
        return 0.0
    return float(np.median((since[reach:] - since[:-reach]) / (count[reach:] - count[:-reach])))


def _fitted_step(index: IntArray, since: FloatArray, step: float) -> float:
    """Return the slope of time over number by least squares, delayed messages left out."""
    kept = np.ones(len(index), np.bool_)
    for _ in range(3):
        slope, level = np.polyfit(index[kept].astype(np.float64), since[kept] - index[kept] * step, 1)
        left = since - index * (step + slope) - level
        spread = 1.4826 * float(np.median(np.abs(left - np.median(left)))) + 1.0
        kept = np.abs(left - np.median(left)) <= _OUTLYING * spread
        if kept.sum() < 2:
            break
    return float(step + slope)


def _inferred_losses(delay: FloatArray, elapsed: FloatArray, samples: IntArray, step: float) -> IntArray:
    """Return the samples lost before each message (B,), where the delay (B,), ns, steps up for good.

    A late message has a larger delay than those around it; a gap raises the median of all that follow. Where several
    messages share a stamp, only gaps longer than the step to the next one can be told.
    """
    lost = np.zeros(len(delay), np.int64)
    ahead = elapsed - samples * step
    least = max((_SUSPECT - 1.0) * step, _resolution(elapsed))
    suspects = np.flatnonzero(ahead > least) + 1
    suspects = suspects[(suspects >= _FEWEST) & (suspects <= len(delay) - _FEWEST)]
    for k in suspects[np.argsort(-ahead[suspects - 1], kind="stable")]:
        rise = float(np.median(delay[k : k + _WINDOW]) - np.median(delay[max(k - _WINDOW, 0) : k]))
        found = round(rise / step)
        if found > 0 and rise > least:
            lost[k] = found
            delay[k:] -= found * step  # so that a gap is not found again beside itself
    return np.asarray(np.cumsum(lost))


def _resolution(elapsed: FloatArray) -> float:
    """Return the step, ns, in which coarse stamps advance, by the time from each to the next; 0 for fine ones."""
    shared = elapsed == 0
    if not len(elapsed) or shared.mean() < _SHARED or shared.all():
        return 0.0
    return float(np.median(elapsed[elapsed > 0]))
