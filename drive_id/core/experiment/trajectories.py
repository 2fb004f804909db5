"""Current trajectories that cover the disc in the dq plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from drive_id.common.settings import Checked, setting
from drive_id.types import FloatArray


class Trajectory(Protocol):
    """A curve in the disc of radius ``i_max`` that begins at zero current."""

    @property
    def i_max(self) -> float:
        """Radius of the disc, A."""

    @property
    def duration(self) -> float:
        """Duration of one pass, after which the curve is back at zero current and repeats, s; infinite without end."""

    @property
    def slope(self) -> float:
        """Upper bound of |di/dt| in the dq plane, A/s."""

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return i_dq references (N, 2), A, at times (N,), s, from the start of the trajectory."""


@dataclass(frozen=True)
class Lissajous(Checked):
    """The paper's constrained Lissajous figure (double-sine sweep) in the current disc."""

    i_max: float = setting(100.0, "radius of the current disc", unit="A", minimum=1e-3)
    frequency_d: float = setting(3.7, "frequency of the d reference, Phi_d / 2 pi", unit="Hz", minimum=0.0)
    frequency_q: float = setting(1.1, "frequency of the q reference, Phi_q / 2 pi", unit="Hz", minimum=0.0)
    form: str = setting(
        "smooth", "printed: i_d follows the root as the paper prints it, with a kink wherever i_q touches the rim; "
        "smooth: the signed root, the same disc without kinks", choices=("smooth", "printed"),
    )  # fmt: skip

    @property
    def duration(self) -> float:
        """Infinite: the two frequencies may have no common period."""
        return math.inf

    @property
    def slope(self) -> float:
        """``I hypot(w_d, w_q)``: |di/dt| is largest where i_q = 0 and i_d crosses zero, in both forms, A/s."""
        return self.i_max * 2 * math.pi * math.hypot(self.frequency_d, self.frequency_q)

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return i_dq references (N, 2), A, at times (N,), s, from the start of the trajectory.

        ``i_q = I sin(Phi_q t)``; the root of ``I^2 - i_q^2`` is ``I |cos(Phi_q t)|``, or signed when smooth.
        """
        phase_q = 2 * np.pi * self.frequency_q * np.asarray(t)
        root = np.cos(phase_q) if self.form == "smooth" else np.abs(np.cos(phase_q))
        i_d = root * np.sin(2 * np.pi * self.frequency_d * np.asarray(t))
        return self.i_max * np.stack([i_d, np.sin(phase_q)], axis=-1)


@dataclass(frozen=True)
class Stair(Checked):
    """Operating points on a square grid in the disc, held one by one and joined by straight ramps."""

    i_max: float = setting(100.0, "radius of the current disc", unit="A", minimum=1e-3)
    points: int = setting(9, "grid points per axis", minimum=3, maximum=101)
    dwell_time: float = setting(0.2, "time at each operating point", unit="s", minimum=1e-3)
    slew_rate: float = setting(10000.0, "|di/dt| from point to point", unit="A/s", minimum=1.0)

    @cached_property
    def operating_points(self) -> FloatArray:
        """The points (P, 2) in order, A: rows of constant i_q from below, their direction alternating."""
        axis = np.linspace(-self.i_max, self.i_max, self.points)
        rows = []
        for k, i_q in enumerate(axis):
            i_d = axis if k % 2 == 0 else axis[::-1]
            inside = i_d[np.hypot(i_d, i_q) <= self.i_max * (1 + 1e-12)]
            rows.append(np.column_stack((inside, np.full_like(inside, i_q))))
        return np.concatenate(rows)

    @cached_property
    def _knots(self) -> tuple[FloatArray, FloatArray]:
        """Times (K,), s, and currents (K, 2), A, of the corners."""
        points = self.operating_points
        stations = np.concatenate((np.zeros((1, 2)), points, np.zeros((1, 2))))
        travel = np.hypot(*np.diff(stations, axis=0).T) / self.slew_rate
        dwell = np.full(len(points), self.dwell_time)
        times = np.cumsum(np.column_stack((travel[:-1], dwell)).ravel())
        end = times[-1] + travel[-1]
        return np.concatenate(([0.0], times, [end])), np.concatenate(
            (stations[:1], np.repeat(points, 2, axis=0), stations[-1:])
        )

    @property
    def duration(self) -> float:
        """Duration of one pass through all points, from zero to zero current, s."""
        return float(self._knots[0][-1])

    @property
    def slope(self) -> float:
        """|di/dt| from point to point, A/s."""
        return self.slew_rate

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return i_dq references (N, 2), A, at times (N,), s, from the start of the trajectory."""
        times, currents = self._knots
        phase = np.mod(t, self.duration)
        return np.stack([np.interp(phase, times, currents[:, axis]) for axis in (0, 1)], axis=-1)


@dataclass(frozen=True)
class Spiral(Checked):
    """A spiral with equally spaced turns from zero current to the rim and back."""

    i_max: float = setting(100.0, "radius of the current disc", unit="A", minimum=1e-3)
    turns: float = setting(10.0, "turns from the centre to the rim", minimum=0.5, maximum=1000.0)
    duration: float = setting(10.0, "time out and back", unit="s", minimum=1e-2)

    @property
    def slope(self) -> float:
        """|di/dt| at the rim, A/s."""
        return 2 * self.i_max / self.duration * math.hypot(1.0, 2 * math.pi * self.turns)

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return i_dq references (N, 2), A, at times (N,), s, from the start of the trajectory."""
        part = np.mod(t, self.duration) / self.duration
        radius = self.i_max * (1 - np.abs(1 - 2 * part))
        angle = 4 * np.pi * self.turns * part
        return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
