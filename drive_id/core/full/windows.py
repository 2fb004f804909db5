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
from typing import Any

import numpy as np

from drive_id.core import frames
from drive_id.core.fit_settings import REFERENCE_TEMPERATURE
from drive_id.core.frames import ComplexArray
from drive_id.core.maps.inverter_curve import CapacitiveShapes
from drive_id.core.numerics.scans import first_order
from drive_id.types import BoolArray, FloatArray, IntArray, Samples

WINDOW_ANGLE, SHORT_ANGLE = np.deg2rad(60.0), np.deg2rad(25.0)
"""Angle turned in a window, and in a short one, which fits between the zero crossings of two phase currents."""
LONGEST_WINDOW = 0.1
"""Limit at low speed, where 60 degrees would take longer, s."""
STRIDE = 0.8e-3
"""Mean distance between the starts of windows, s."""
SHIFTS = (-4, -3, -2, -1, 0, 1, 2, 3)
"""Offsets from both ends, samples, at which the voltage is kept so that it can be shifted in time later."""
MOST_DELAY = float(-SHIFTS[0])
"""Largest delay of the voltage in either direction, samples."""

LAGS = (1e-3, 4e-3, 16e-3)
"""Time constants of flux lags, s."""

_REACH = 4
_NEAR = np.arange(-_REACH, _REACH + 1)
_PAST = np.arange(-8, 0)
"""Samples around and before the end of a window over which lines are fitted by least squares."""
_BESIDE, _CUBIC = np.array([-2, -1, 1, 2]), np.array([-1, 4, 4, -1]) / 6
"""Offsets of the samples next to the end of a window, and the weights of the cubic through them."""
_ROUNDING = 1e-9  # s
_FEWEST = 4096
"""Samples collected before windows are cut, so that overlaps cost little."""
_FINEST = 1e-4
"""Spacing of the possible ends of windows if the sample period is shorter, s."""
_SOME = 4
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
    crossing : (N,) complex
        Sum over the zero crossings of the phase currents, see :func:`crossings`, s.
    heating, magnet_heating : (N,) float
        Temperature of winding and magnet above the reference temperature of resistance and flux map, K. The winding:
        as recorded, else as set for the recording; the magnet: as recorded, else that of the winding.
    drop_scale : (N,) float
        DC-link voltage over the reference voltage of the inverter's curve.
    period : (N,) float
        Sample period, s.
    held : (N, 2) complex
        Voltage u_s held before [start, end], V.
    slope : (N, 2) complex
        d i_dq / dt before [start, end], A/s, from earlier samples only: the controller responds to the noise of a
        sample later, so that noise and slope are independent.
    lagging : (N, 2, len(LAGS) + 1) complex
        i_dq at [start, end], interpolated between neighbouring samples to exclude the noise of the sample itself, minus
        the same after first-order lags of LAGS seconds; last, the interpolated current itself, A.
    speed : (N, 2) float
        Electrical speed at [start, end], rad/s.
    turned : (N, 2) float
        Electrical angle turned since the start of the run at [start, end], rad.
    heat : (N,) float
        int |i_s|^2 dt from the start of the recording to the start of the window, A^2 s.
    link : (N,) complex
        int u_s u_dc, V^2 s, NaN where the DC-link voltage is not known.
    run, recording : (N,) int
        Number of the gap-free run and of the recording.
    clearance : (N,) float
        Smallest absolute value of a phase current within the window, 0 where one crosses zero, A.
    short : (N,) bool
        Whether the rotor turns by SHORT_ANGLE instead of WINDOW_ANGLE.
    effects : (N, EFFECT_COLUMNS) complex, optional
        Columns of the regression that depend on a map, see :mod:`drive_id.core.full.effects`.
    weight : (N,) float, optional
        Of the squared residuals; default: 1.
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
    crossing: ComplexArray
    heating: FloatArray
    magnet_heating: FloatArray
    drop_scale: FloatArray
    period: FloatArray
    held: ComplexArray
    slope: ComplexArray
    lagging: ComplexArray
    speed: FloatArray
    turned: FloatArray
    heat: FloatArray
    link: ComplexArray
    run: IntArray
    recording: IntArray
    clearance: FloatArray
    short: BoolArray
    effects: ComplexArray | None = None
    weight: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time)

    def interval(self, length: float) -> IntArray:
        """Return the number (N,) of the interval of ``length`` seconds in which each window starts."""
        return np.asarray((self.time + _ROUNDING) / length).astype(np.int64)

    def part(self, selected: slice | IntArray | BoolArray) -> Windows:
        """Return some of the windows."""
        own: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        chosen: dict[str, Any] = {name: x if x is None else x[selected] for name, x in own.items()}
        return Windows(**chosen)

    @staticmethod
    def joined(parts: list[Windows]) -> Windows:
        """Concatenate windows."""
        if len(parts) == 1:
            return parts[0]
        known = [name for name in (*MEASURED, *_ADDED) if all(getattr(part, name) is not None for part in parts)]
        return Windows(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in known})

    def thinned(self, most: int) -> Windows:
        """Return every k-th of the windows, at most ``most``."""
        return self.part(slice(None, None, -(-len(self) // most)))

    @property
    def whole(self) -> Windows:
        """Those that are not short."""
        return self.part(~self.short) if self.short.any() else self

    @property
    def weights(self) -> FloatArray:
        """Weights (N,) of the squared residuals."""
        return np.ones(len(self)) if self.weight is None else self.weight


_ADDED = ("effects", "weight")
MEASURED = tuple(field.name for field in fields(Windows) if field.name not in _ADDED)
"""Arrays of windows that are computed from samples alone."""


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Samples without a gap."""

    i_abc: FloatArray
    u_abc: FloatArray
    angle: FloatArray
    speed: FloatArray
    idle: BoolArray
    turned: FloatArray
    heat: FloatArray
    lagged: ComplexArray  # i_dq after each of LAGS
    link: FloatArray  # DC-link voltage, NaN where unknown
    winding: FloatArray  # temperature, degrees Celsius, NaN where unknown
    magnet: FloatArray

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
    short : bool
        Cut short windows as well, from the same beginnings: those without a zero crossing of a phase current, those
        at small current, and a quarter of the others.
    """

    def __init__(self, shapes: CapacitiveShapes, *, short: bool = False) -> None:
        self._shapes, self._short = shapes, short
        self._heating, self._drop_scale = 0.0, 1.0
        self._turned = self._heat = 0.0  # up to the last sample, rad and A^2 s
        self._lagged = np.zeros(len(LAGS), np.complex128)  # at the last sample, A
        self._run, self._recording = -1, 0
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

    def restart(self, time: float, recording: int) -> None:
        """Continue at another time, s, with another recording, after :meth:`finish`."""
        self._time, self._recording, self._heat = time, recording, 0.0

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
        fewest = max(_FEWEST, int(2 * LONGEST_WINDOW / samples.sample_period))
        for number, run in enumerate(samples.runs()):
            if continues and number == 0 and self._rest is not None:
                self._rest = self._rest.followed_by(self._stretch(samples, idle, run, continues=True))
            else:
                yield from self.finish()
                self._rest, self._period = self._stretch(samples, idle, run, continues=False), samples.sample_period
                self._origin = self._number = 0
                self._run += 1
            while len(self._rest) >= 2 * fewest:
                yield from self._cut(self._rest.part(slice(2 * fewest)))
            if len(self._rest) >= fewest:
                yield from self._cut(self._rest)

    def adjacent(self, samples: Samples, length: int) -> Iterator[tuple[int, Windows]]:
        """Yield for each run the sample where the first of its adjacent windows of ``length`` samples starts, and them.

        The first few and the last few samples of a run are not included.
        """
        self._period = samples.sample_period
        for run in samples.runs():
            self._run += 1
            stretch = self._stretch(samples, np.zeros(len(samples), np.bool_), run, continues=False)
            begin = np.arange(-_PAST[0], len(stretch) - length - _REACH, length)
            if len(begin):
                yield (
                    run.start + int(begin[0]),
                    self._windows(stretch, begin, begin + length, np.zeros(len(begin), np.bool_)),
                )

    def _stretch(self, samples: Samples, idle: BoolArray, run: slice, *, continues: bool) -> _Stretch:
        """Return the new samples of a run with the quantities integrated over them."""
        angle, turned = samples.angle[run], 0.0
        if continues:
            turned = self._turned
        turn = np.angle(np.exp(1j * np.diff(angle)))
        i_abc = samples.i_abc[run]
        power = 2 / 3 * np.sum(np.square(i_abc[1:]), axis=1) * samples.sample_period
        turns, heat = (np.cumsum(np.append(first, steps)) for first, steps in ((turned, turn), (self._heat, power)))
        self._turned, self._heat = float(turns[-1]), float(heat[-1])
        new = slice(run.start + continues, run.stop)
        i_dq = frames.space_vector(i_abc) * np.exp(-1j * angle)
        if not continues:
            self._lagged = np.full(len(LAGS), i_dq[0])
        decay, before, now = _lag_weights(samples.sample_period)
        lagged = np.stack(
            [
                first_order(i_dq, start, d, a, b)
                for d, a, b, start in zip(decay, before, now, self._lagged, strict=True)
            ],
            axis=1,
        )
        lagged = np.concatenate([self._lagged[None], lagged])
        self._lagged = lagged[-1]
        return _Stretch(
            i_abc[continues:],
            samples.u_abc[new],
            samples.angle[new],
            samples.speed[new],
            idle[new],
            turns[continues:],
            heat[continues:],
            lagged[continues:],
            *(
                np.full(new.stop - new.start, np.nan) if values is None else values[new]
                for values in (samples.dc_link_voltage, samples.winding_temperature, samples.magnet_temperature)
            ),
        )

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
            begin_used, end_used = begin_used[moving], end_used[moving]
            whole = len(begin_used)
            if self._short:
                begin_used, end_used = self._with_short(stretch, begin_used, end_used)
            yield self._windows(stretch, begin_used, end_used, np.arange(len(begin_used)) >= whole)
        self._number += count
        grain = _grain(self._period)
        past = max(0, int(begin[count]) - grain * -(_PAST[0] // grain)) if count < len(begin) else 0
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
        begin = grain * (place - (2 * _PAST[0] // grain)) - self._origin  # only after the lags have settled
        span = max(1, round(_SPEED_SPAN / self._period))
        travelled = np.concatenate([[0.0], np.cumsum(np.abs(stretch.speed))])
        first = np.clip(begin, 0, len(stretch) - 1)
        last = np.minimum(first + span, len(stretch))
        turn = (travelled[last] - travelled[first]) / (last - first) * (self._period * grain)
        longest = max(2.0, LONGEST_WINDOW / (self._period * grain))
        length = np.clip(np.rint(WINDOW_ANGLE / np.maximum(turn, WINDOW_ANGLE / longest)), 2, longest)
        return begin, grain * length.astype(np.int64)

    def _with_short(self, stretch: _Stretch, begin: IntArray, end: IntArray) -> tuple[IntArray, IntArray]:
        """Append the places of the short windows."""
        grain = _grain(self._period)
        turns = np.rint((end - begin) * (SHORT_ANGLE / WINDOW_ANGLE) / grain).astype(np.int64)
        sooner = begin + grain * np.maximum(turns, 1)
        current = np.abs(frames.space_vector(stretch.i_abc))
        current = np.maximum(current[begin], current[sooner])
        scales = self._shapes.scales
        useful = (_clearance(stretch.i_abc, begin, sooner) > scales[1]) | (current < scales[self._shapes.usual - 1])
        useful |= (self._origin + begin) // grain % _SOME == 0
        return np.append(begin, begin[useful]), np.append(end, sooner[useful])

    def _windows(self, stretch: _Stretch, begin: IntArray, end: IntArray, short: BoolArray) -> Windows:
        period, grain = self._period, _grain(self._period)
        i_s, u_s = frames.space_vector(stretch.i_abc), frames.space_vector(stretch.u_abc)
        voltage: ComplexArray = period * np.cumsum(np.append(0j, u_s[:-1]), dtype=np.complex128)
        current: ComplexArray = period / 2 * np.cumsum(np.append(0j, i_s[1:] + i_s[:-1]), dtype=np.complex128)
        shape = self._shapes.integrals(stretch.i_abc[::grain], period * grain)
        lag = self._lag(i_s, stretch.angle)
        crossing = np.cumsum(crossings(stretch.i_abc, period))
        ends = np.stack([begin, end], axis=1)
        turned = i_s * np.exp(-1j * stretch.angle)
        i_dq = turned[ends]
        lines = np.linalg.pinv(np.stack([np.ones(len(_PAST)), period * _PAST], axis=1))
        slope = turned[ends[..., None] + _PAST] @ lines[1]
        now = turned[ends[..., None] + _BESIDE] @ _CUBIC
        decay, by_last, by_now = _lag_weights(period)
        lagged = decay * stretch.lagged[ends - 1] + by_last * turned[ends - 1, None] + by_now * now[..., None]
        speed = stretch.turned[ends[..., None] + _NEAR] @ _NEAR / (period * np.sum(_NEAR**2))
        winding, magnet = (x[begin] - REFERENCE_TEMPERATURE for x in (stretch.winding, stretch.magnet))
        heating = np.where(np.isnan(winding), self._heating, winding)
        unknown = np.cumsum(np.append(0, np.isnan(stretch.link[:-1])))
        link: ComplexArray = period * np.cumsum(
            np.append(0j, (u_s * np.nan_to_num(stretch.link))[:-1]), dtype=np.complex128
        )
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
            crossing=crossing[end] - crossing[begin],
            heating=heating,
            magnet_heating=np.where(np.isnan(magnet), heating, magnet),
            drop_scale=np.full(len(begin), self._drop_scale),
            period=np.full(len(begin), period),
            held=u_s[ends - 1],
            slope=slope,
            lagging=np.concatenate([now[..., None] - lagged, now[..., None]], axis=-1),
            speed=speed,
            turned=stretch.turned[ends],
            heat=stretch.heat[begin],
            link=np.where(unknown[end] == unknown[begin], link[end] - link[begin], np.nan),
            run=np.full(len(begin), self._run),
            recording=np.full(len(begin), self._recording),
            clearance=_clearance(stretch.i_abc, begin, end),
            short=short,
        )

    def _lag(self, i_s: ComplexArray, angle: FloatArray) -> ComplexArray:
        """Return the integrals (G, L) from the first sample on, see :class:`Windows`."""
        grain, shapes = _grain(self._period), self._shapes.coarse
        turn = np.diff(angle, prepend=angle[0])
        before = np.concatenate([i_s[:1], i_s[:-1]]) * np.exp(1j * turn)
        now, then = (shapes.integrals(frames.phases(x[::grain]), self._period * grain) for x in (i_s, before))
        excess = now - then
        return np.stack([frames.space_vector(excess[:, number]) for number in range(len(shapes.scales))], axis=1)


def crossings(i_abc: FloatArray, period: float) -> ComplexArray:
    """Return the vectors (N,) of the zero crossings in the sample before each, positive for rising currents, s.

    If the drop steps from -D to D at a zero crossing that is t T earlier than linear interpolation between two samples
    predicts, its integral increases by ``2 D t T``. The current has a kink at the step and the shapes round its corner,
    so t is a few hundredths and about the same at all crossings.
    """
    out = np.zeros(len(i_abc), np.complex128)
    for phase, shift in enumerate(frames.PHASE_SHIFTS):
        i = i_abc[:, phase]
        at = np.flatnonzero(i[:-1] * i[1:] < 0)
        out[at + 1] += 2 / 3 * period * np.sign(i[at + 1]) * np.exp(1j * shift)
    return out


def _clearance(i_abc: FloatArray, begin: IntArray, end: IntArray) -> FloatArray:
    """Return the smallest absolute value (N,) of a phase current from ``begin`` to ``end``, 0 if it crosses zero, A."""
    least = np.min(np.abs(i_abc), axis=1)
    until = least.copy()
    until[:-1][np.any((i_abc[:-1] < 0) != (i_abc[1:] < 0), axis=1)] = 0.0
    within = np.minimum.reduceat(until, np.stack([begin, end], axis=1).ravel())[::2]
    return np.asarray(np.minimum(within, least[end]))


def _lag_weights(period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weights of the last lagging, the last and the present current; between samples it is linear."""
    lags = np.array(LAGS)
    decay = np.exp(-period / lags)
    now = 1 - (1 - decay) * lags / period
    return decay, 1 - decay - now, now


def _grain(period: float) -> int:
    return max(1, int(1.001 * _FINEST / period))
