"""Equally spaced samples whose stamps jitter, as those of arrival do: the time from the number of the sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from drive_id.common.quantity import counted
from drive_id.errors import SamplePeriodError
from drive_id.types import FloatArray, IntArray

_BLOCKS = (1, 4, 8, 16, 32, 64, 128, 256, 512, 1024)
"""Messages whose common delay is compared with that of the next ones: the fewest that tell one sample are taken."""
_FEWEST = 16
"""Least number of blocks, half of them behind a gap: a few late messages must not pass for one."""
_ONWARD = 2000  # messages for which a rise must last: late ones in a row are no gap
_MOSTLY = 0.8
"""Share of the steps from block to block that are none at gaps."""
_AT_MOSTLY = 1.2816 * 2**0.5  # as many spreads are exceeded by the other steps
_TOOTH = 5  # blocks, fewer of which do not come early alone, but where stamps have few digits
_FEW_TEETH = 0.002  # share of them that chance explains
_ROUGH = 0.05  # relative error of the period before
_LIKELY = 5.0  # spreads of the delays of blocks by which they rise at a gap
_OUTLYING = 4.0  # standard deviations by which a message is delayed that does not count for the period


@dataclass(frozen=True, eq=False)
class EqualSpacing:
    """Regular stamps of messages, and losses: known by the count, or else inferred from lasting steps of the stamps."""

    stamp: IntArray  # (B,), of the first sample of each message, ns
    period: float  # s
    jitter: float  # root mean square distance of the recorded stamps from these, s
    missing: int  # samples between the messages
    gaps: int  # places where samples are missing
    least: int = 1  # samples that must be missing in one place to be told from jitter


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
    least = 1
    if first is None:
        if period is None:
            for _ in range(3):
                step = _folded_step(since, count, step)
        lost, least = _inferred_losses(since - count * step, step)
        index = count + lost
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
        least=least,
    )


def _usual_step(since: FloatArray, count: IntArray) -> float:
    """Return the sample period, ns, as the median over stretches, so that gaps do not count."""
    if len(since) < 2:
        return 0.0
    steps = np.diff(since)
    alone = max(float(np.mean(steps > 0.1 * steps.mean())), 0.1)  # and not in a batch that arrives at once
    reach = min(max(len(since) // 8, 1), round(100 / alone))
    return float(np.median((since[reach:] - since[:-reach]) / (count[reach:] - count[:-reach])))


def _fitted_step(index: IntArray, since: FloatArray, step: float) -> float:
    """Return the slope of time over number by least squares, delayed messages left out."""
    slope, level = 0.0, 0.0
    for _ in range(4):
        left = since - index * (step + slope) - level
        spread = 1.4826 * float(np.median(np.abs(left - np.median(left)))) + 1.0
        kept = np.abs(left - np.median(left)) <= _OUTLYING * spread
        if kept.sum() < 2:
            break
        slope, level = np.polyfit(index[kept].astype(np.float64), since[kept] - index[kept] * step, 1)
    return float(step + slope)


def _folded_step(since: FloatArray, count: IntArray, step: float) -> float:
    """Return the sample period, ns, from delays less whole periods, so that gaps do not count."""
    size, block, spread = _blocks(since - count * step, step)
    if not len(block):
        return step
    first = count[: size * len(block) : size]
    away, apart = float(np.median(np.diff(block))) / float(np.median(np.diff(first))), 1
    while _LIKELY * spread <= 0.5 * step and apart <= len(block) // 4:
        samples = first[apart:] - first[:-apart]
        turn = np.exp(2j * np.pi / step * (block[apart:] - block[:-apart] - away * samples))
        away += float(np.angle(turn.mean())) * step / (2 * np.pi * float(samples.mean()))
        apart *= 4
    return step + away


def _inferred_losses(delay: FloatArray, step: float) -> tuple[IntArray, int]:
    """Return the samples lost before each message (B,), where the delays, ns, step up for good, and how few are told.

    Late messages, also many in a row, are followed by others in time; a gap raises the delay of all that follow. So
    the least delay of blocks counts, over as many messages as are late in a row.
    """
    lost = np.zeros(len(delay), np.int64)
    size, block, spread = _blocks(delay, step)
    if not len(block):
        return lost, round(float(np.ptp(delay)) / step) + 1
    least = max(0.5 * step, _LIKELY * spread)
    reach = min(max(2 * _FEWEST, _ONWARD // size), len(block))
    ndimage = scipy.ndimage  # loaded here, in 0.1 s: only stamps that jitter need it
    lasting = ndimage.minimum_filter1d(ndimage.grey_closing(block, _TOOTH), reach, mode="nearest", origin=-(reach // 2))
    rises, level = np.zeros(len(block), np.int64), float(lasting[0])
    for j in np.flatnonzero(np.diff(lasting[: -_FEWEST // 2])) + 1:
        rise = float(lasting[j]) - level
        if abs(rise) > least:
            rises[j] = round(rise / step)
        level += rises[j] * step + 0.5 * (rise - rises[j] * step)
    levels = np.minimum.accumulate(np.cumsum(rises)[::-1])[::-1]
    for j in np.flatnonzero(np.diff(levels)) + 1:
        k = _place(delay, size, int(j), found := int(levels[j] - levels[j - 1]), step)
        lost[k] += found
        delay[k:] -= found * step
    return np.asarray(np.cumsum(lost)), 1 if least <= 0.5 * step else int(least / step) + 1


def _blocks(delay: FloatArray, step: float) -> tuple[int, FloatArray, float]:
    """Return how many messages make a block, the delay common to those of each, ns, and its spread.

    The delay is nearly the least one where messages are late, and a mean where they are early as well.
    """
    best = (0, np.zeros(0), np.inf)
    for size in _BLOCKS:
        blocks = len(delay) // size
        if blocks < _FEWEST:
            break
        each = np.sort(delay[: blocks * size].reshape(blocks, size), axis=1)
        for common in (each[:, min(1, size - 1)], each[:, size // 4 : size - size // 4].mean(axis=1)):
            steps = np.diff(common)
            usual = float(np.median(steps))
            steps -= usual
            spread = float(np.quantile(np.abs(steps - step * np.rint(steps / step)), _MOSTLY)) / _AT_MOSTLY
            if abs(usual) > _ROUGH * size * step:
                continue  # a part of a batch of messages
            teeth = np.mean(scipy.ndimage.grey_closing(common, _TOOTH) - common > 0.5 * step)
            if _LIKELY * spread <= 0.5 * step and np.median(np.abs(steps)) <= 0.5 * step and teeth <= _FEW_TEETH:
                return size, common, spread
            spread = max(float(np.quantile(np.abs(steps), _MOSTLY)) / _AT_MOSTLY, step / _LIKELY)
            if spread < best[2]:
                best = (size, common, spread)
    return best


def _place(delay: FloatArray, size: int, block: int, found: int, step: float) -> int:
    """Return the message near the beginning of a block before which ``found`` samples were most likely lost."""
    first, last = max((block - 1) * size, 0), min((block + 1) * size, len(delay))
    usual = float(np.median(delay[max(first - 8 * _FEWEST, 0) : first + 1]))
    nearer = np.abs(delay[first:last] - usual) - np.abs(delay[first:last] - usual - found * step)
    return first + int(np.argmin(np.concatenate([[0.0], np.cumsum(nearer)])))
