"""What a recording looks like: currents over time, speed, turn per sample, gaps and coverage, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drive_id.core import frames
from drive_id.core.maps.coverage import Visits, disc_coverage
from drive_id.core.signals.join import Piece
from drive_id.messages import Message
from drive_id.types import FloatArray

_POINTS = 4096  # of a curve: more than a picture has columns
_NODES = 33  # per axis of the plane in which coverage is counted
_REACH = 4.0  # part of i_max within which a sample covers a node
_LEAST_COVERAGE = 0.45  # of the disc: as the fit warns


@dataclass(frozen=True, eq=False)
class Overview:
    """Figures and thinned curves of a recording.

    Parameters
    ----------
    samples, runs : int
        And gap-free runs.
    duration, sample_period, time_lost : float
        s; the time lost is that between runs.
    speed : (3,) float
        Least, mean and largest electrical speed, rad/s.
    turn : float
        Root mean square electrical turn per sample, rad.
    i_dq_range : (2, 2) float
        Least and largest i_d and i_q, A.
    i_max : float
        Radius of the disc for the coverage, A.
    coverage : float
        Share of this disc with samples, 0 to 1.
    time : (P,) float
        Of the curves, s after the first sample.
    i_dq, reference_dq : (P, 2) float
        A; the references are NaN where there are none.
    speed_curve : (P,) float
        rad/s.
    """

    samples: int
    runs: int
    duration: float
    sample_period: float
    time_lost: float
    speed: FloatArray
    turn: float
    i_dq_range: FloatArray
    i_max: float
    coverage: float
    time: FloatArray
    i_dq: FloatArray
    reference_dq: FloatArray
    speed_curve: FloatArray

    def figures(self) -> dict[str, float]:
        """Return the figures by name, SI units."""
        (i_d_low, i_q_low), (i_d_high, i_q_high) = self.i_dq_range.tolist()
        low, mean, high = self.speed.tolist()
        return {
            "samples": self.samples,
            "runs": self.runs,
            "duration": self.duration,
            "sample_period": self.sample_period,
            "time_lost": self.time_lost,
            "speed_min": low,
            "speed_mean": mean,
            "speed_max": high,
            "turn_per_sample": self.turn,
            "i_d_min": i_d_low,
            "i_d_max": i_d_high,
            "i_q_min": i_q_low,
            "i_q_max": i_q_high,
            "i_max": self.i_max,
            "coverage": self.coverage,
        }

    def findings(self) -> Iterator[Message]:
        """Yield gaps, and a disc that is hardly filled."""
        if self.runs > 1:
            yield Message("gaps", gaps=self.runs - 1, time_lost=self.time_lost)
        if self.coverage < _LEAST_COVERAGE:
            yield Message("coverage", coverage=self.coverage, i_max=self.i_max)


class Overviewing:
    """Gathers an overview, piece by piece."""

    def __init__(self) -> None:
        self._samples = self._runs = 0
        self._speed = np.array([np.inf, 0.0, -np.inf])
        self._square = 0.0
        self._lost = 0
        self._first: int | None = None
        self._last = 0
        self._period = 0.0
        self._low, self._high = np.full(2, np.inf), np.full(2, -np.inf)
        self._rows: list[FloatArray] = []
        self._kept: list[FloatArray] = []

    def add(self, piece: Piece) -> None:
        """Take further samples."""
        samples, skip = piece.samples, int(piece.continues)
        if self._first is None:
            self._first, self._period = int(samples.stamp[0]), samples.sample_period
        elif not piece.continues:
            self._lost += int(samples.stamp[0]) - self._last - round(1e9 * self._period)
        starts = samples.run_starts[1:]
        self._lost += int(np.sum(samples.stamp[starts] - samples.stamp[starts - 1])) - round(1e9 * self._period) * len(
            starts
        )
        self._last = int(samples.stamp[-1])
        self._runs += len(samples.run_starts) - skip
        speed = samples.speed[skip:]
        self._speed += [0.0, float(speed.sum()), 0.0]
        self._speed[0] = min(self._speed[0], float(speed.min(initial=np.inf)))
        self._speed[2] = max(self._speed[2], float(speed.max(initial=-np.inf)))
        self._square += float(np.sum((speed * samples.sample_period) ** 2))
        i_dq = frames.to_dq(samples.i_abc, samples.angle)[skip:]
        self._low, self._high = np.minimum(self._low, i_dq.min(axis=0)), np.maximum(self._high, i_dq.max(axis=0))
        reference = samples.i_dq_reference
        wanted = np.full_like(i_dq, np.nan) if reference is None else reference[skip:]
        time = (samples.stamp[skip:] - self._first) * 1e-9
        rows = np.column_stack([time, i_dq, wanted, speed])
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
        return Overview(
            samples=self._samples,
            runs=self._runs,
            duration=self._samples * self._period,
            sample_period=self._period,
            time_lost=self._lost * 1e-9,
            speed=self._speed / [1.0, self._samples, 1.0],
            turn=float(np.sqrt(self._square / self._samples)),
            i_dq_range=np.array([self._low, self._high]),
            i_max=i_max,
            coverage=disc_coverage(axis, axis, inside, i_max),
            time=rows[:, 0],
            i_dq=rows[:, 1:3],
            reference_dq=rows[:, 3:5],
            speed_curve=rows[:, 5],
        )
