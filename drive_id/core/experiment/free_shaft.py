"""Trajectory for a drive without load machine: its own torque swings the shaft about a mean speed, held slowly."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drive_id.common.settings import Checked, setting
from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray

SLOWEST_SWING = 5.0  # Hz; slower swings visit the disc too seldom
FASTEST_SWING = 60.0  # Hz; faster swings strain current controllers
TRIP_FACTOR = 1.2  # speed and current at which a free shaft trips, relative to the largest ones planned
_SWING_SHARE = 0.85  # part of the speed band that the swing is planned to take
_RATIO = (3 - math.sqrt(5)) / 2
"""f_d / f_q, 0.382, the golden angle: the figure never closes, and i_d changes its sign each or every other period.
Where i_d and i_q lag differently, reluctance torque has a mean of that sign: slower figures swing the mean speed."""
_LARGEST_SKEW = 0.8  # largest modulation of the phase of i_q, rad: mean of 0.37 of the amplitude
_RAMP_TIME = 0.2  # s, at least, in whole periods of f_q
_WINDOW = 0.1  # s, at least, in whole periods of f_q, over which the mean speed is taken
_PHASE_LAG = 0.35  # crossover of the speed's feedback times its dead time, rad: 20 degrees of lag
_INTEGRAL = 0.25  # corner of the integrator relative to the crossover
_RUN_UP = 0.15  # part of the largest torque that brings the shaft to its mean speed
LARGEST_BIAS = 0.36  # of i_q, relative to its amplitude, that the feedback of the mean speed gives
_DECIMATION = 10  # of the angles that are kept for the mean speed
_LEAST_MOTION = 1e-3  # rad


def swing_frequency(acceleration: float, speed_max: float, mean_speed: float = 0.0) -> float:
    """Return the frequency of i_q whose swing fits the speeds, Hz, at least that of the slowest swing.

    The acceleration by the largest torque, T_max p / J, rad/s^2, and the speeds, rad/s, are electrical. Raises
    ConfigurationError when the mean speed leaves no band.
    """
    band = _SWING_SHARE * (speed_max - abs(mean_speed))
    if band <= 0:
        raise ConfigurationError(
            f"mean_speed is {mean_speed:g} rad/s and shaft_speed_max {speed_max:g} rad/s: nothing is left for the "
            "swing."
        )
    return max(SLOWEST_SWING, acceleration / (2 * math.pi * band))


@dataclass(frozen=True)
class FreeShaft(Checked):
    """Torque that reverses with i_q and so leaves the mean speed alone, while i_d slowly sweeps the disc.

    ``i_q = I cos(x'), i_d = I sin(x') sin(2 pi f_d t)`` with ``x' = x - beta sin(x)``, ``x = 2 pi f_q t``: the skew
    beta prolongs one sign of i_q at the same amplitude; the mean of cos(x') is the Bessel function J_1(beta), about
    beta/2. Ramps take whole periods, so that they leave no mean speed either.
    """

    i_max: float = setting(100.0, "amplitude", unit="A", minimum=1e-3)
    frequency: float = setting(5.0, "frequency of i_q", unit="Hz", minimum=0.1, maximum=1000.0)
    run_time: float = setting(20.0, "duration, ramps included", unit="s", minimum=1e-2)

    @property
    def ramp_time(self) -> float:
        """Duration of the ramp at each end, s."""
        return math.ceil(_RAMP_TIME * self.frequency) / self.frequency

    @property
    def duration(self) -> float:
        """Duration in whole periods, s."""
        return max(math.ceil(self.run_time * self.frequency) / self.frequency, 3 * self.ramp_time)

    @property
    def slope(self) -> float:
        """Upper bound of |di/dt|, A/s."""
        x_rate = (1 + _LARGEST_SKEW) * self.frequency
        return self.i_max * (2 * math.pi * math.hypot(x_rate, _RATIO * self.frequency) + 1 / self.ramp_time)

    def __call__(self, t: FloatArray, bias: FloatArray | float = 0.0) -> FloatArray:
        """Return i_dq references (N, 2), A, at times (N,), s; ``bias`` is the mean of i_q relative to its amplitude."""
        t = np.mod(np.asarray(t, np.float64), self.duration)
        skew = np.clip(2 * np.asarray(bias), -_LARGEST_SKEW, _LARGEST_SKEW)
        x = 2 * np.pi * self.frequency * t
        x = x - skew * np.sin(x)
        envelope = np.clip(np.minimum(t, self.duration - t) / self.ramp_time, 0.0, 1.0) * self.i_max
        i_d = envelope * np.sin(x) * np.sin(2 * np.pi * _RATIO * self.frequency * t)
        return np.stack([i_d, envelope * np.cos(x)], axis=-1)


class MeanSpeed:
    """Mean speed over whole periods of a swing of ``frequency``, Hz, from the angle: exact where the speed lags."""

    def __init__(self, frequency: float) -> None:
        self.window = math.ceil(_WINDOW * frequency) / frequency
        self.value = math.nan
        """Electrical, rad/s; NaN before the first window is full."""
        self.motion = math.inf
        """Range of the angle in the window, rad; infinite before it is full."""
        self._blocks: deque[tuple[FloatArray, FloatArray]] = deque()
        self._due: int | None = None
        self._time = self._angle = 0.0

    def add(self, first_sample: int, sample_period: float, angle: NDArray[np.floating]) -> float:
        """Add a block of angles (N,), rad; return the time by which it goes on, s. A gap begins a new window."""
        count = len(angle)
        if first_sample != self._due:
            self._blocks.clear()
            self.value, self.motion = math.nan, math.inf
        self._due = first_sample + count
        unwrapped: FloatArray = np.unwrap(np.concatenate(([self._angle], angle.astype(np.float64))))[1:]
        time: FloatArray = self._time + sample_period * np.arange(1, count + 1, dtype=np.float64)
        passed = float(time[-1] - self._time)
        self._time, self._angle = float(time[-1]), float(unwrapped[-1])
        kept = slice((count - 1) % _DECIMATION, None, _DECIMATION)
        self._blocks.append((time[kept], unwrapped[kept]))
        begin = self._time - self.window
        while len(self._blocks) > 1 and self._blocks[1][0][0] <= begin:
            self._blocks.popleft()
        if self._blocks[0][0][0] <= begin:
            times, angles = (np.concatenate(parts) for parts in zip(*self._blocks, strict=True))
            self.value = float(self._angle - np.interp(begin, times, angles)) / self.window
            self.motion = float(np.ptp(angles[times >= begin]))
        return passed


class SpeedFeedback:
    """Holds the mean speed by the bias of i_q: slowly, for references are published ahead.

    Parameters
    ----------
    frequency : float
        Of the swing, Hz.
    acceleration : float or None
        By the amplitude of the current, electrical, rad/s^2; None where it is not known: no feedback.
    mean_speed : float
        Electrical, rad/s.
    dead_time : float
        From a measurement to its effect, without the averaging, s.
    """

    def __init__(self, frequency: float, acceleration: float | None, mean_speed: float, dead_time: float) -> None:
        self.mean = MeanSpeed(frequency)
        self.bias = 0.0
        self.reference = 0.0
        """Mean speed that is to be held now, rad/s."""
        self._acceleration = acceleration
        self._target = mean_speed
        self._crossover = _PHASE_LAG / (dead_time + 0.5 * self.mean.window)
        self._integral = 0.0
        self._still = 0.0
        self._last = 0.0

    def add(self, first_sample: int, sample_period: float, angle: NDArray[np.floating], *, active: bool) -> None:
        """Add a block of angles (N,), rad, N > 0; ``active``: the swing is under way."""
        passed = self.mean.add(first_sample, sample_period, angle)
        self._still = self._still + passed if active and self.mean.motion < _LEAST_MOTION else 0.0
        if not active or self._acceleration is None or math.isnan(self.mean.value):
            return
        left = self._target - self.reference
        step = math.copysign(min(_RUN_UP * self._acceleration * passed, abs(left)), left)
        self.reference += step
        error, gain = self.reference - self.mean.value, self._crossover / self._acceleration
        ahead = step / (passed * self._acceleration) if passed > 0 else 0.0
        wanted = ahead + gain * error + self._integral
        self.bias = min(max(wanted, -LARGEST_BIAS), LARGEST_BIAS)
        if wanted == self.bias:  # no wind-up
            self._integral += gain * _INTEGRAL * self._crossover * error * passed

    def biases(self, count: int) -> FloatArray:
        """Return the bias for the next ``count`` set-points: it goes from its last value to the present one."""
        out = np.linspace(self._last, self.bias, count + 1)[1:]
        self._last = self.bias
        return out

    def stands_still(self, longest: float) -> bool:
        """Whether the angle has not moved for ``longest``, s, though torque acts: locked, or frozen samples."""
        return self._still > longest


@dataclass(frozen=True)
class RotatingVector(Checked):
    """For a first start: zero current, then a vector in the stator frame that turns slowly, forwards and backwards.

    At each of two currents: align at angle 0, turn ``turns`` forwards, wait, turn back, and go to zero current.
    """

    i_max: float = setting(100.0, "larger one of the two amplitudes", unit="A", minimum=1e-3)
    frequency: float = setting(2.0, "electrical turns per second", unit="Hz", minimum=0.05, maximum=10.0)
    turns: int = setting(4, "electrical turns each way", minimum=1, maximum=100)
    settle_time: float = setting(1.5, "at rest on each amplitude", unit="s", minimum=0.1, maximum=60.0)

    SECOND = 0.5
    """Second amplitude relative to the first one."""
    ZERO_TIME = 0.5
    """Time at zero current before, for the offsets, s."""
    RISE_TIME = 0.5
    """Time of each ramp of the amplitude and of the speed of the vector, s."""

    @property
    def way(self) -> float:
        """Time for all turns one way, both ramps of the speed included, s."""
        return self.turns / self.frequency + self.RISE_TIME

    @property
    def section(self) -> float:
        """Time at one amplitude, s."""
        return 2 * (self.RISE_TIME + self.settle_time + self.way)

    @property
    def duration(self) -> float:
        """Of all sections, s."""
        return self.ZERO_TIME + 2 * self.section

    @property
    def slope(self) -> float:
        """Upper bound of |di/dt|, A/s."""
        return self.i_max * (2 * math.pi * self.frequency + 1 / self.RISE_TIME)

    def _turned(self, t: FloatArray) -> FloatArray:
        """Angle of the vector, rad, a time ``t`` after it began to turn: speed up, turn, slow down."""
        rise, way = self.RISE_TIME, self.way
        t = np.clip(t, 0.0, way)
        up, down = np.minimum(t, rise), np.maximum(t - (way - rise), 0.0)
        turns = np.maximum(t - rise, 0.0) + up**2 / (2 * rise) - down**2 / (2 * rise)
        return np.asarray(2 * np.pi * self.frequency * turns)

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return alpha and beta (N, 2), A, at times (N,), s."""
        t = np.asarray(t, np.float64) - self.ZERO_TIME
        first = t < self.section
        amplitude = self.i_max * np.where(first, 1.0, self.SECOND)
        t = np.where(first, t, t - self.section)
        begin = self.RISE_TIME + self.settle_time
        angle = self._turned(t - begin) - self._turned(t - begin - self.way - self.settle_time)
        amplitude *= np.clip(np.minimum(t, self.section - t) / self.RISE_TIME, 0.0, 1.0)
        return np.asarray(amplitude[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
