"""What a recording looks like: currents over time, speed, turn per sample, gaps and coverage, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.checks.radius import WEAK_COVERAGE
from drive_id.core.maps.coverage import Visits, disc_coverage
from drive_id.core.signals.join import Piece
from drive_id.types import FloatArray

_POINTS = 4096  # of a curve: more than a picture has columns
_NODES = 33  # per axis of the plane in which coverage is counted
_REACH = 4.0  # part of i_max within which a sample covers a node


@dataclass(frozen=True, eq=False)
class Overview:
    """Figures and thinned curves of a recording."""

    # SI units; speeds are electrical, the turn per sample is a root mean square, the time lost that between gap-free
    # runs, and the coverage the share of the disc of radius i_max with samples, 0 to 1
    figures: dict[str, float]
    time: FloatArray  # (P,), of the curves, s after the first sample
    i_dq: FloatArray  # (P, 2), A; the references are NaN where there are none
    reference_dq: FloatArray
    speed: FloatArray  # (P,), rad/s

    def findings(self) -> Iterator[Message]:
        """Yield gaps, and a disc that is hardly filled."""
        figures = self.figures
        if figures["runs"] > 1:
            yield Message("gaps", gaps=figures["runs"] - 1, time_lost=figures["time_lost"])
        if figures["coverage"] < WEAK_COVERAGE:
            yield Message("coverage", coverage=figures["coverage"], i_max=figures["i_max"])


class Overviewing:
    """Gathers an overview, piece by piece."""

    def __init__(self) -> None:
        self._samples = self._runs = 0
        self._turned = self._square = 0.0  # sum of the speeds, rad/s, and of the squared turns per sample, rad^2
        self._between = 0  # from the last sample of each run to the first one of the next, ns
        self._first = self._last = 0
        self._period = 0.0
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)  # of i_d, i_q and speed
        self._rows: list[FloatArray] = []
        self._kept: list[FloatArray] = []

    def add(self, piece: Piece) -> None:
        """Take further samples."""
        samples, skip = piece.samples, int(piece.continues)
        if not self._samples:
            self._first, self._period = int(samples.stamp[0]), samples.sample_period
        elif not piece.continues:
            self._between += int(samples.stamp[0]) - self._last
        starts = samples.run_starts[1:]
        self._between += int(np.sum(samples.stamp[starts] - samples.stamp[starts - 1]))
        self._last = int(samples.stamp[-1])
        self._runs += len(samples.run_starts) - skip
        i_dq, speed = frames.to_dq(samples.i_abc, samples.angle)[skip:], samples.speed[skip:]
        self._turned += float(speed.sum())
        self._square += float(np.sum((speed * samples.sample_period) ** 2))
        wanted = samples.or_unknown("i_dq_reference")[skip:]
        time = (samples.stamp[skip:] - self._first) * 1e-9
        rows = np.column_stack([time, i_dq, wanted, speed])
        reached = rows[:, [1, 2, 5]]
        self._low, self._high = np.minimum(self._low, reached.min(axis=0)), np.maximum(self._high, reached.max(axis=0))
        self._samples += len(rows)
        self._rows.append(rows[:: max(len(rows) // _POINTS, 1)])
        self._kept.append(i_dq[:: max(len(rows) // (8 * _POINTS), 1)])

    def overview(self, i_max: float) -> Overview | None:
        """Return the overview for a disc of radius ``i_max``, A; None without samples."""
        if not self._samples or not i_max > 0:
            return None
        axis = np.linspace(-i_max, i_max, _NODES)
        visits = Visits(axis, axis)
        for i_dq in self._kept:
            visits.add(i_dq)
        inside = visits.inside(i_max / _REACH, i_max / _REACH)
        rows = np.concatenate(self._rows)
        rows = rows[:: max(len(rows) // _POINTS, 1)]
        low, high = self._low.tolist(), self._high.tolist()
        figures = {
            "samples": self._samples,
            "runs": self._runs,
            "duration": self._samples * self._period,
            "sample_period": self._period,
            "time_lost": (self._between - round(1e9 * self._period) * (self._runs - 1)) * 1e-9,
            "speed_min": low[2],
            "speed_mean": self._turned / self._samples,
            "speed_max": high[2],
            "turn_per_sample": float(np.sqrt(self._square / self._samples)),
            "i_d_min": low[0],
            "i_d_max": high[0],
            "i_q_min": low[1],
            "i_q_max": high[1],
            "i_max": i_max,
            "coverage": disc_coverage(axis, axis, inside, i_max),
        }
        return Overview(figures, rows[:, 0], rows[:, 1:3], rows[:, 3:5], rows[:, 5])
