"""Steady operating points in slow telemetry: their samples, means and the errors of the means.

A segment rests while the range of i_d, of i_q and of the speed each stays within a tolerance: 2 % of the largest
current amplitude or of the largest speed, or more where noise needs it. Its first and last sample, which may be means
over a change, are cut, and so is its beginning until the voltages are settled. What remains must be three samples long.
In a fast log, a moving current is within the tolerance for some samples, too: segments with a slope are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drive_id.core.steady.operating_data import OperatingData
from drive_id.errors import CoverageError
from drive_id.types import BoolArray, FloatArray, IntArray

TOLERANCE = 0.02  # range within a segment at rest, by the largest current amplitude or speed
_LARGEST_TOLERANCE = 0.10  # however large the noise
_NOISE = 8.0  # range of white noise in some hundred samples, in standard deviations
LEAST_SAMPLES = 3  # of a segment
_SETTLED = 4.0  # distance from the final voltages within which they are settled, in standard deviations of their noise
_SETTLED_SHARE = 0.005  # the same by the largest voltage, in addition
_LARGEST_SLOPE = 0.01
"""Change of the current within a segment, by the largest current and while the rotor turns by 1 rad electrical at the
largest speed: about the share of the voltage that a changing flux then takes, which is not in the equations."""
_GAP = 3.0  # periods without a sample that end a segment
_POOLED_SAMPLES = 30.0  # weight of the scatter of all segments beside that of the own one, samples
_MOST_CORRELATED = 0.95  # correlation from sample to sample that is believed: beyond, the means would have no weight
_BLOCK = 64  # samples that are looked at first for the end of a segment
_SURE = 3.0  # standard errors of a slope that noise explains
_QUARTILE = 0.3186  # of |x|, x standard normal

_PER_POINT = ("i_dq", "u_dq", "speed", "winding_temperature", "covariance", "count")
"""Arrays with an entry for each point, or None."""


@dataclass(frozen=True, eq=False)
class OperatingPoints:
    """Means over segments at rest."""

    i_dq: FloatArray  # (P, 2), A
    u_dq: FloatArray  # (P, 2), V
    speed: FloatArray  # (P,), electrical, rad/s
    winding_temperature: FloatArray | None  # (P,), degrees Celsius
    covariance: FloatArray | None
    """(P, 5, 5), of the errors of ``[i_d, i_q, u_d, u_q, speed]``; None where only the fit tells the noise."""
    count: IntArray  # (P,), samples of each point
    freedom: float  # degrees of freedom behind the covariance
    samples: int  # of the log, those at no point included

    def __len__(self) -> int:
        return len(self.speed)

    @property
    def i_max(self) -> float:
        """Largest current amplitude, A."""
        return float(np.hypot(*self.i_dq.T).max())

    def chosen(self, kept: BoolArray) -> OperatingPoints:
        """Return some of the points (P,)."""
        known: dict[str, Any] = {name: getattr(self, name) for name in _PER_POINT}
        return replace(self, **{name: values[kept] for name, values in known.items() if values is not None})


def operating_points(data: OperatingData) -> OperatingPoints:
    """Return the operating points of telemetry; without a time, each sample is one.

    Raises CoverageError when the drive never rests.
    """
    if data.time is None or len(data) < LEAST_SAMPLES:
        ones = np.ones(len(data), np.int64)
        return OperatingPoints(data.i_dq, data.u_dq, data.speed, data.winding_temperature, None, ones, 0.0, len(data))
    segments = steady_segments(data)
    moving = [at for at in segments if _is_moving(data, at)]
    if 2 * sum(at.stop - at.start for at in moving) > sum(at.stop - at.start for at in segments):
        raise CoverageError(
            f"The currents do not rest: at {len(moving)} of {len(segments)} points, sampled every "
            f"{data.period * 1e3:.2g} ms, they change so fast that the changing flux counts in the voltages: hold each "
            "operating point until voltages and currents are constant, or log phase quantities and the angle and fit "
            "with --method full."
        )
    segments = [at for at in segments if at not in moving]
    if not segments:
        raise CoverageError(
            f"The drive never rests for {LEAST_SAMPLES} samples within {100 * TOLERANCE:.0f} % of its largest current "
            "and speed: hold each operating point for five samples or more, or, if each sample is an operating point, "
            "set rows_are_points (in Python: leave out the time)."
        )
    signals = np.column_stack([data.i_dq, data.u_dq, data.speed])
    means = np.array([signals[at].mean(axis=0) for at in segments])
    count = np.array([at.stop - at.start for at in segments])
    temperature = None
    if data.winding_temperature is not None:
        temperature = np.array([data.winding_temperature[at].mean() for at in segments])
    return OperatingPoints(
        i_dq=means[:, :2],
        u_dq=means[:, 2:4],
        speed=means[:, 4],
        winding_temperature=temperature,
        covariance=_covariance([signals[at] - mean for at, mean in zip(segments, means, strict=True)], count),
        count=count,
        freedom=float(np.sum(count - 1)),
        samples=len(data),
    )


def joined_points(parts: list[OperatingPoints]) -> OperatingPoints:
    """Join the points of several logs; a quantity that one log lacks is left out for all.

    Raises CoverageError when some logs have a time and others do not.
    """
    if len(parts) == 1:
        return parts[0]
    timed = {part.covariance is not None for part in parts}
    if len(timed) > 1:
        raise CoverageError("Some logs have a time and some do not: fit them with and without a time separately.")

    def together(name: str) -> Any:
        found = [getattr(part, name) for part in parts]
        return None if any(values is None for values in found) else np.concatenate(found)

    arrays = {name: together(name) for name in _PER_POINT}
    freedom, samples = sum(part.freedom for part in parts), sum(part.samples for part in parts)
    return OperatingPoints(**arrays, freedom=freedom, samples=samples)


def steady_segments(data: OperatingData) -> list[slice]:
    """Return the segments at rest, transients cut, in order of time; see this module for the rule."""
    assert data.time is not None
    moving = np.column_stack([data.i_dq, data.speed])
    scale = np.array([np.hypot(*data.i_dq.T).max()] * 2 + [np.abs(data.speed).max()])
    scale = np.maximum(scale, np.finfo(float).tiny)
    tolerance = np.clip(_NOISE * _noise(moving), TOLERANCE * scale, _LARGEST_TOLERANCE * scale)
    gaps = np.diff(data.time) > _GAP * data.period
    noise, largest = _noise(data.u_dq), float(np.hypot(*data.u_dq.T).max())
    settled = _SETTLED * noise + _SETTLED_SHARE * largest
    found = []
    for run in _calm_runs(moving, tolerance, gaps):
        for segment in _segments(moving, tolerance, run):
            kept = _trimmed(data.u_dq, segment, settled, len(data))
            if kept.stop - kept.start >= LEAST_SAMPLES:
                found.append(kept)
    return found


def _is_moving(data: OperatingData, segment: slice) -> bool:
    """Tell whether the currents of a segment have a slope that its noise does not explain and that is too large."""
    assert data.time is not None
    turn = np.abs(data.speed).max() * (data.time[segment] - data.time[segment].mean())
    if not turn.any():
        return False
    deviation = data.i_dq[segment] - data.i_dq[segment].mean(axis=0)
    squares = turn @ turn
    slope = turn @ deviation / squares
    residual = deviation - turn[:, None] * slope
    sigma = np.sqrt((residual**2).sum() / max(residual.size - 4, 1) / squares)
    allowed = _LARGEST_SLOPE * np.hypot(*data.i_dq.T).max() + _SURE * sigma
    return bool(np.hypot(*slope) > allowed)


def _noise(values: FloatArray) -> FloatArray:
    """Return the standard deviation (K,) of white noise in signals (N, K) that rest for a quarter of the time."""
    steps = np.abs(np.diff(values, axis=0))
    return np.asarray(np.quantile(steps, 0.25, axis=0) / (_QUARTILE * np.sqrt(2)))


def _calm_runs(values: FloatArray, tolerance: FloatArray, gaps: BoolArray) -> list[slice]:
    """Return runs of samples, each of which lies in some short window within the tolerance."""
    windows = np.lib.stride_tricks.sliding_window_view(values, LEAST_SAMPLES, axis=0)
    calm = (np.ptp(windows, axis=-1) <= tolerance).all(axis=1)
    calm &= ~np.lib.stride_tricks.sliding_window_view(gaps, LEAST_SAMPLES - 1).any(axis=1)
    inside = np.zeros(len(values), np.bool_)
    for shift in range(LEAST_SAMPLES):
        inside[shift : shift + len(calm)] |= calm
    begins = inside & ~np.concatenate([[False], inside[:-1] & ~gaps])
    ends = inside & ~np.concatenate([inside[1:] & ~gaps, [False]])
    return [slice(int(a), int(b) + 1) for a, b in zip(np.flatnonzero(begins), np.flatnonzero(ends), strict=True)]


def _segments(values: FloatArray, tolerance: FloatArray, run: slice) -> list[slice]:
    """Divide a run, from its beginning on, into the longest segments within the tolerance."""
    segments, start = [], run.start
    while start < run.stop:
        size, stop = _BLOCK, run.stop
        while True:
            block = values[start : min(start + size, run.stop)]
            over = (np.maximum.accumulate(block) - np.minimum.accumulate(block) > tolerance).any(axis=1)
            if over.any():
                stop = start + int(np.argmax(over))
                break
            if start + size >= run.stop:
                break
            size *= 4
        segments.append(slice(start, stop))
        start = stop
    return segments


def _trimmed(u_dq: FloatArray, segment: slice, settled: FloatArray, samples: int) -> slice:
    """Cut the ends of a segment that border on a change, and its beginning until the voltages are settled."""
    start = segment.start + (segment.start > 0)
    stop = segment.stop - (segment.stop < samples)
    if stop - start < LEAST_SAMPLES:
        return slice(start, start)
    final = np.median(u_dq[(start + stop) // 2 : stop], axis=0)
    close = (np.abs(u_dq[start:stop] - final) <= settled).all(axis=1)
    return slice(start + int(np.argmax(close)), stop) if close.any() else slice(start, start)


def _covariance(deviations: list[FloatArray], count: IntArray) -> FloatArray:
    """Return the covariances of the means (P, 5, 5): that of the own scatter and that of all segments, weighted.

    The scatter is correlated from sample to sample in filtered telemetry; the means then rest on fewer samples.
    """
    scatter = np.array([part.T @ part for part in deviations])
    freedom = count - 1.0
    pooled = scatter.sum(axis=0) / freedom.sum()
    each = (_POOLED_SAMPLES * pooled + scatter) / (_POOLED_SAMPLES + freedom)[:, None, None]
    squares = np.array([np.sum(part[:-1] * part[1:], axis=0) for part in deviations]).sum(axis=0)
    total = np.maximum(np.diagonal(scatter.sum(axis=0)), np.finfo(float).tiny)
    length = float(count.mean())
    correlation = squares / total * length / (length - 1) + 1 / length  # subtracting the mean lowers it by about 1/n
    correlation = np.where(np.abs(correlation) < 2 / np.sqrt(count.sum()), 0.0, correlation)
    correlation = np.clip(correlation, 0.0, _MOST_CORRELATED)
    wider = np.sqrt((1 + correlation) / (1 - correlation))
    return np.asarray(each * wider[:, None] * wider / count[:, None, None])
