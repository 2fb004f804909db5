"""The open-loop simulation beside the measured current: an excerpt for pictures, and the deviation over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drive_id.types import FloatArray, Samples

_SECONDS = 1.0  # of the excerpt, at most
_POINTS = 2000  # of the excerpt: a picture shows no more
_BINS = 400  # of the deviation over time


@dataclass(frozen=True, eq=False)
class SimulatedCurrent:
    """Simulated against measured current.

    Times are times of data: gaps are left out.
    """

    time: FloatArray  # (N,), of an excerpt of one second at most around the largest deviation, s
    measured: FloatArray  # (N, 2), i_d and i_q there, A
    simulated: FloatArray  # (N, 2), likewise; NaN from where the simulation diverged
    bin_time: FloatArray  # (T,), centres of equal bins of the whole simulation, s
    deviation: FloatArray  # (T, 2), mean absolute deviation in each bin, A; NaN where the simulation diverged


def simulated_current(
    pieces: Sequence[Samples], simulated: Sequence[FloatArray], measured: Sequence[FloatArray]
) -> SimulatedCurrent | None:
    """Reduce a simulation to what a picture shows.

    Parameters
    ----------
    simulated, measured : sequence of (N, 2) float
        i_dq of each piece, A.

    Returns
    -------
    SimulatedCurrent or None
        None when nothing was simulated, or the simulation diverged at once.
    """
    times, start = [], 0.0
    for piece in pieces:
        times.append(start + piece.sample_period * np.arange(len(piece)))
        start += piece.duration
    time = np.concatenate([np.zeros(0), *times])
    ours, theirs = (np.concatenate([np.zeros((0, 2)), *parts]) for parts in (simulated, measured))
    deviation = np.abs(ours - theirs)
    known = np.isfinite(deviation).all(axis=1)
    if not known.any():
        return None
    bins = max(1, min(_BINS, len(time) // 8))
    place = np.minimum((time / start * bins).astype(np.int64), bins - 1)
    with np.errstate(invalid="ignore"):
        count = np.bincount(place, minlength=bins)
        binned = np.stack([np.bincount(place, values, bins) / count for values in deviation.T], axis=1)
    worst = int(np.where(known, deviation.max(axis=1), -1.0).argmax())
    begin = min(max(time[worst] - _SECONDS / 2, 0.0), max(time[-1] - _SECONDS, 0.0))
    first, last = np.searchsorted(time, [begin, begin + _SECONDS])
    chosen = slice(int(first), int(last) + 1, 1 + int(last - first) // _POINTS)
    return SimulatedCurrent(
        time=time[chosen],
        measured=theirs[chosen],
        simulated=ours[chosen],
        bin_time=(np.arange(bins) + 0.5) * start / bins,
        deviation=binned,
    )
