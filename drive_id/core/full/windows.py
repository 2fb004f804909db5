"""Voltage balance over windows in the stator frame: exact at any speed, with the flux at two instants only.

With psi_s = e^{j theta} f(i, theta), integrating u_s = R i_s + drop_s + d psi_s / dt from t_0 to t_1 gives

    e^{j theta_1} f(i_1, theta_1) - e^{j theta_0} f(i_0, theta_0) = int u_s - R int i_s - int drop_s.

It contains neither speed nor derivatives, so current noise enters at the ends only. During a window the rotor turns by
about 60 degrees electrical, never by a whole period, over which a constant flux would cancel.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.maps.inverter_curve import CapacitiveShapes
from drive_id.types import BoolArray, FloatArray, IntArray, Samples

WINDOW_ANGLE = np.deg2rad(60.0)
LONGEST_WINDOW = 0.1
"""Limit at low speed, where 60 degrees would take longer, s."""
STRIDE = 0.8e-3
"""Mean distance between the starts of windows, s."""
SHIFTS = (-4, -3, -2, -1, 0, 1, 2, 3)
"""Samples beside both ends at which the voltage is kept, so that it can be shifted in time later."""
MOST_DELAY = float(-SHIFTS[0])
"""Largest delay of the voltage in either direction, samples."""

_REACH = 4
_ROUNDING = 1e-9  # s
_FEWEST = 4096
"""Samples to collect before windows are cut, so that overlaps cost little."""
_FINEST = 1e-4
"""Grid of the ends of windows where samples are closer, s."""
_SPEED_SPAN = 5e-3
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, eq=False)
class Windows:
    """Terms of the balance over N windows.

    Parameters
    ----------
    time : (N,) float
        Time of the start, gaps not counted, s.
    i_dq : (N, 2, 2) float
        Measured currents at [start, end], A.
    angle : (N, 2) float
        Electrical angle at [start, end], rad.
    voltage : (N,) complex
        int u_s, Vs.
    current : (N,) complex
        int i_s, As.
    duration : (N,) float
        s.
    shifted : (N, len(SHIFTS)) complex
        T (u_s[end + shift] - u_s[start + shift]): change of the integral per sample of delay, Vs.
    shape : (N, S, 3) float
        Integrals of the inverter's shapes of each phase's current, s.
    lag : (N, L) complex
        Integrals of the coarse shapes minus those for the current one sample earlier, turned with the rotor, by which
        a drive compensates the drop, s.
    heating : (N,) float
        Temperature above the reference temperature of resistance and flux map, K.
    drop_scale : (N,) float
        DC-link voltage over the reference voltage of the inverter's curve.
    """

    time: FloatArray
    i_dq: FloatArray
    angle: FloatArray
    voltage: ComplexArray
    current: ComplexArray
    duration: FloatArray
    shifted: ComplexArray
    shape: FloatArray
    lag: ComplexArray
    heating: FloatArray
    drop_scale: FloatArray

    def __len__(self) -> int:
        return len(self.time)

    def interval(self, length: float) -> IntArray:
        """Return the number (N,) of the interval of ``length`` seconds in which each window starts."""
        return np.asarray((self.time + _ROUNDING) / length).astype(np.int64)

    def part(self, selected: slice | IntArray) -> Windows:
        """Return some of the windows."""
        return Windows(*(getattr(self, field.name)[selected] for field in fields(self)))

    @staticmethod
    def joined(parts: list[Windows]) -> Windows:
        """Concatenate windows."""
        return Windows(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Windows)))


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Samples without a gap."""

    i_abc: FloatArray
    u_abc: FloatArray
    angle: FloatArray
    speed: FloatArray
    idle: BoolArray

    def __len__(self) -> int:
        return len(self.angle)

    def part(self, selected: slice) -> _Stretch:
        return _Stretch(*(getattr(self, field.name)[selected] for field in fields(self)))

    def followed_by(self, other: _Stretch) -> _Stretch:
        pairs = [(getattr(self, field.name), getattr(other, field.name)) for field in fields(self)]
        return _Stretch(*(np.concatenate(pair) for pair in pairs))


class WindowCutter:
    """Cuts a stream of samples into windows; the result does not depend on how the stream is divided.

    Parameters
    ----------
    shapes : CapacitiveShapes
        Of the inverter.
    """

    def __init__(self, shapes: CapacitiveShapes) -> None:
        self._shapes = shapes
        self._heating, self._drop_scale = 0.0, 1.0
        self._rest: _Stretch | None = None  # samples that later windows need
        self._period = 0.0
        self._origin = 0  # index of the rest's first sample within its run
        self._number = 0  # windows placed in the run
        self._time = 0.0  # of data before the rest, s

    def copy(self) -> WindowCutter:
        """Return an independent copy."""
        return copy.copy(self)

    def set_conditions(self, heating: float, drop_scale: float) -> None:
        """Set temperature rise, K, and relative DC-link voltage of the samples to come, see :class:`Windows`."""
        self._heating, self._drop_scale = heating, drop_scale

    def restart(self, time: float) -> None:
        """Continue at another time, s, after :meth:`finish`."""
        self._time = time

    def cut(self, samples: Samples, idle: BoolArray | None = None, *, continues: bool = False) -> Iterator[Windows]:
        """Yield the windows of further samples; the last ones follow with :meth:`finish`.

        Parameters
        ----------
        samples : Samples
        idle : (N,) bool, optional
            Samples at rest: windows that begin and end at one are left out.
        continues : bool
            The first of these samples is the last one of the samples before.
        """
        idle = np.zeros(len(samples), np.bool_) if idle is None else idle
        whole = _Stretch(samples.i_abc, samples.u_abc, samples.angle, samples.speed, idle)
        fewest = max(_FEWEST, int(2 * LONGEST_WINDOW / samples.sample_period))
        for number, run in enumerate(samples.runs()):
            if continues and number == 0 and self._rest is not None:
                self._rest = self._rest.followed_by(whole.part(slice(run.start + 1, run.stop)))
            else:
                yield from self.finish()
                self._rest, self._period = whole.part(run), samples.sample_period
                self._origin = self._number = 0
            while len(self._rest) >= 2 * fewest:
                yield from self._cut(self._rest.part(slice(2 * fewest)))
            if len(self._rest) >= fewest:
                yield from self._cut(self._rest)

    def finish(self) -> Iterator[Windows]:
        """Yield the last windows of a run."""
        if self._rest is not None:
            yield from self._cut(self._rest)
            self._time += len(self._rest) * self._period
            self._rest = None

    def _cut(self, stretch: _Stretch) -> Iterator[Windows]:
        """Yield the windows that end within ``stretch``, the beginning of the rest; drop samples no longer needed."""
        assert self._rest is not None  # for the type checker
        begin, length = self._places(stretch)
        complete = begin + length + _REACH < len(stretch)
        count = len(begin) if complete.all() else int(complete.argmin())
        begin_used, end_used = begin[:count], begin[:count] + length[:count]
        moving = ~(stretch.idle[begin_used] & stretch.idle[end_used])
        if moving.any():
            yield self._windows(stretch, begin_used[moving], end_used[moving])
        self._number += count
        grain = _grain(self._period)
        past = max(0, int(begin[count]) - grain * -(-_REACH // grain)) if count < len(begin) else 0
        self._rest, self._origin = self._rest.part(slice(past, None)), self._origin + past
        self._time += past * self._period

    def _places(self, stretch: _Stretch) -> tuple[IntArray, IntArray]:
        """Return the starts of the next windows within the stretch and their lengths in samples.

        Equally spaced starts can lock to the phase of a rotor-position harmonic at certain speeds; a golden-section
        jitter spreads them evenly over all phases.
        """
        grain = _grain(self._period)
        stride = max(1.0, STRIDE / self._period / grain)
        number = self._number + np.arange(int(len(stretch) / grain / stride) + 2)
        place = np.floor((number + number * _GOLDEN % 1.0) * stride).astype(np.int64)
        begin = grain * (place - (-_REACH // grain)) - self._origin
        span = max(1, round(_SPEED_SPAN / self._period))
        travelled = np.concatenate([[0.0], np.cumsum(np.abs(stretch.speed))])
        first = np.clip(begin, 0, len(stretch) - 1)
        last = np.minimum(first + span, len(stretch))
        turn = (travelled[last] - travelled[first]) / (last - first) * (self._period * grain)
        longest = max(2.0, LONGEST_WINDOW / (self._period * grain))
        length = np.clip(np.rint(WINDOW_ANGLE / np.maximum(turn, WINDOW_ANGLE / longest)), 2, longest)
        return begin, grain * length.astype(np.int64)

    def _windows(self, stretch: _Stretch, begin: IntArray, end: IntArray) -> Windows:
        period, grain = self._period, _grain(self._period)
        i_s, u_s = frames.space_vector(stretch.i_abc), frames.space_vector(stretch.u_abc)
        voltage: ComplexArray = period * np.cumsum(np.append(0j, u_s[:-1]), dtype=np.complex128)
        current: ComplexArray = period / 2 * np.cumsum(np.append(0j, i_s[1:] + i_s[:-1]), dtype=np.complex128)
        shape = self._shapes.integrals(stretch.i_abc[::grain], period * grain)
        lag = self._lag(i_s, stretch.angle)
        ends = np.stack([begin, end], axis=1)
        i_dq = i_s[ends] * np.exp(-1j * stretch.angle[ends])
        return Windows(
            time=self._time + period * begin.astype(np.float64),
            i_dq=np.stack([i_dq.real, i_dq.imag], axis=-1),
            angle=stretch.angle[ends],
            voltage=voltage[end] - voltage[begin],
            current=current[end] - current[begin],
            duration=period * (end - begin).astype(np.float64),
            shifted=np.stack([period * (u_s[end + shift] - u_s[begin + shift]) for shift in SHIFTS], axis=1),
            shape=shape[end // grain] - shape[begin // grain],
            lag=lag[end // grain] - lag[begin // grain],
            heating=np.full(len(begin), self._heating),
            drop_scale=np.full(len(begin), self._drop_scale),
        )

    def _lag(self, i_s: ComplexArray, angle: FloatArray) -> ComplexArray:
        """Return the integrals (G, L) from the first sample on, see :class:`Windows`."""
        grain, shapes = _grain(self._period), self._shapes.coarse
        turn = np.diff(angle, prepend=angle[0])
        before = np.concatenate([i_s[:1], i_s[:-1]]) * np.exp(1j * turn)
        now, then = (shapes.integrals(frames.phases(x[::grain]), self._period * grain) for x in (i_s, before))
        excess = now - then
        return np.stack([frames.space_vector(excess[:, number]) for number in range(len(shapes.scales))], axis=1)


def _grain(period: float) -> int:
    return max(1, int(1.001 * _FINEST / period))
