"""Voltage balance over windows in the stator frame: exact at any speed, with the flux at two instants only.

With psi_s = e^{j theta} f(i, theta), integrating u_s = R i_s + drop_s + d psi_s / dt from t_0 to t_1 gives

    e^{j theta_1} f(i_1, theta_1) - e^{j theta_0} f(i_0, theta_0) = int u_s - R int i_s - int drop_s.

It contains neither speed nor derivatives, so current noise enters at the ends only. During a window the rotor turns by
about 60 degrees electrical, never by a whole period, over which a constant flux would cancel.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from drive_id.common.temperature import REFERENCE_TEMPERATURE
from drive_id.core import frames
from drive_id.core.frames import ROOT_THIRD, THIRD, ComplexArray
from drive_id.core.maps.inverter_curve import CapacitiveShapes, drop_shape
from drive_id.core.numerics.compiled import compiled
from drive_id.types import BoolArray, FloatArray, IntArray, Samples

WINDOW_ANGLE = np.deg2rad(60.0)
"""Angle turned in a window."""
SHORT_ANGLE = np.deg2rad(25.0)
"""Angle turned in a short window, which fits between the zero crossings of two phase currents."""
LONGEST_WINDOW = 0.1
"""Limit at low speed, where 60 degrees would take longer, s."""
WINDOW_CURRENT = 1.3
"""Current excursion within a window, rotor frame, in i_max: fast changes are integrated less accurately."""
STRIDE = 0.8e-3
"""Mean distance between the starts of windows, s."""
SHIFTS = (-4, -3, -2, -1, 0, 1, 2, 3)
"""Offsets from both ends, samples, at which the voltage is kept so that it can be shifted in time later."""
MOST_DELAY = float(-SHIFTS[0])
"""Largest delay of the voltage in either direction, samples."""
EARLIEST = -1.0
"""Delay, samples, above which early voltages are those held before the ends of a window. At -0.5, where this ended, the
voltage after an end, which answers to the noise there, made half a sample win over the -0.4 of every fifth sample."""
DECIMATED = -0.5
"""Delay, samples, below which no log is decimated: the voltages are early by the steps of a drive."""

SEARCHED = 1500
"""Windows or currents over which many candidates are compared: enough for a dozen unknowns of each."""
LAGS = (1e-3, 4e-3, 16e-3)
"""Time constants of flux lags, s."""

_REACH = 4  # samples to each side over which the speed is fitted: a tenth of the noise of one difference
_NEAR = np.arange(-_REACH, _REACH + 1)
_PAST = np.arange(-8, 0)
"""Samples around and before the end of a window over which lines are fitted by least squares."""
_LINE = (_PAST - _PAST.mean()) / np.sum((_PAST - _PAST.mean()) ** 2)
"""Weights of these samples in the slope of the line, per sample."""
_BESIDE = np.array([-2, -1, 1, 2])
"""Offsets of the samples next to the end of a window."""
_CUBIC = np.array([-1, 4, 4, -1]) / 6
"""Weights of the cubic through these samples at the end of the window."""
_ROUNDING = 1e-9
"""Of stamps, s: a time that is a multiple of a batch must not fall into the batch before."""
_FEWEST = 4096
"""Samples collected before windows are cut, so that overlaps cost little."""
_ADJACENT = 4096
"""Most adjacent windows that are cut at once, so that memory does not grow with the recording."""
_PAUSE = 1.0
"""Gap in the stamps, s, after which winding and magnets may have another temperature: 10 A/mm2 heat by 0.5 K/s."""
_FINEST = 1e-4
"""Spacing of the possible ends of windows if the sample period is shorter, s."""
_SOME = 4
"""Of short windows with a zero crossing, one in so many is cut: they only show whether crossings disturb."""
_WAY_STEP = 5e-4
"""Step in which the way of rotor and current is added up, s: noise lengthens shorter ones."""
_GOLDEN = 0.6180339887498949
"""Golden section: shifts windows evenly, and never in step with the rotor or the trajectory."""
_AXES = np.exp(1j * frames.PHASE_SHIFTS)


@dataclass(frozen=True, eq=False)
class Windows:
    """Terms of the balance over N windows."""

    time: FloatArray  # (N,), time of the start, gaps not counted, s
    gaps: FloatArray  # (N,), sum of the gaps since the start of the recording, s
    i_dq: FloatArray  # (N, 2, 2), measured currents at [start, end], A
    angle: FloatArray  # (N, 2), electrical angle at [start, end], rad
    voltage: ComplexArray  # (N,), int u_s, Vs
    current: ComplexArray  # (N,), int i_s, As
    duration: FloatArray  # (N,), s
    # (N, len(SHIFTS)), T (u_s[end + shift] - u_s[start + shift]): change of the integral per sample of delay, Vs
    shifted: ComplexArray
    shape: FloatArray  # (N, S, 3), integrals of the inverter's shapes of each phase's current, s
    # (N, L + 1, 3), integrals of the magnitudes of the coarse shapes, s, and last of the phase currents, As
    rectified: FloatArray
    # (N, L), integrals of the coarse shapes minus those for the current one sample earlier, turned with the rotor, by
    # which a drive compensates the drop, s
    lag: ComplexArray
    crossing: ComplexArray  # (N,), sum over the zero crossings of the phase currents, see :class:`_Sums`, s
    # (N, L, 5), int h'(i) x of the phase currents for the coarse shapes h, x = j i_s, conj(i_s), j conj(i_s), 1 and j:
    # by how much the faults of the current sensors change their integrals, s, the last two s/A
    sensed: ComplexArray
    # (N,), temperature of winding and, below, magnet above the reference temperature of resistance and flux map, K. The
    # winding: as recorded, else as set for the recording; the magnet: as recorded, else that of the winding.
    heating: FloatArray
    magnet_heating: FloatArray
    drop_scale: FloatArray  # (N,), DC-link voltage over the reference voltage of the inverter's curve
    period: FloatArray  # (N,), sample period, s
    held: ComplexArray  # (N, 2), voltage u_s held before [start, end], V
    # (N, 2), d i_dq / dt before [start, end], A/s, from earlier samples only: the controller responds to the noise of a
    # sample later, so that noise and slope are independent
    slope: ComplexArray
    # (N, 2, len(LAGS) + 1), i_dq at [start, end], interpolated between neighbouring samples to exclude the noise of the
    # sample itself, minus the same after first-order lags of LAGS seconds; last, the interpolated current itself, A
    lagging: ComplexArray
    speed: FloatArray  # (N, 2), electrical speed at [start, end], rad/s
    turned: FloatArray  # (N, 2), electrical angle turned since the start of the run at [start, end], rad
    heat: FloatArray  # (N,), int |i_s|^2 dt from the start of the recording to the start of the window, A^2 s
    link: ComplexArray  # (N,), int u_s u_dc, V^2 s, NaN where the DC-link voltage is not known
    loaded: ComplexArray  # (N,), int u_s p with the power p = 3/2 Re(u_s conj(i_s)) that the machine takes, V^2 A s
    run: IntArray  # (N,), number of the gap-free run, below of the recording, and of a part of one between pauses
    recording: IntArray
    section: IntArray
    # (N,), smallest absolute value of a phase current within the window, 0 where one crosses zero, A
    clearance: FloatArray
    short: BoolArray  # (N,), whether the rotor turns by SHORT_ANGLE instead of WINDOW_ANGLE
    # (N, 2), ``i_dq`` minus the measured currents, A, and ``angle`` minus the measured angle, rad, see
    # ``EffectColumns.moved``; default: 0
    moved: ComplexArray | None = None
    righted: FloatArray | None = None
    # (N, EFFECT_COLUMNS), columns of the regression that depend on a map, see :mod:`drive_id.core.full.effects`
    effects: ComplexArray | None = None
    weight: FloatArray | None = None  # (N,), of the squared residuals; default: 1

    def __len__(self) -> int:
        return len(self.time)

    def part(self, selected: slice | IntArray | BoolArray) -> Windows:
        """Return some of the windows."""
        own = ((name, getattr(self, name)) for name in (*MEASURED, *_ADDED))
        return Windows(**{name: x[selected] for name, x in own if x is not None})

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

    def scattered(self) -> Windows:
        """Return at most ``SEARCHED`` of the windows, by a lot that is always the same.

        At even distances, all of one harmonic of the rotor position can look like another one.
        """
        if len(self) <= SEARCHED:
            return self
        return self.part(np.sort(np.random.default_rng(0).choice(len(self), SEARCHED, replace=False)))

    @property
    def measured(self) -> ComplexArray:
        """Measured currents (N, 2) in the frame of ``angle`` at [start, end], A."""
        i_dq: ComplexArray = self.i_dq[..., 0] + 1j * self.i_dq[..., 1]
        return i_dq if self.moved is None else i_dq - self.moved

    @property
    def weights(self) -> FloatArray:
        """Weights (N,) of the squared residuals."""
        return np.ones(len(self)) if self.weight is None else self.weight


_ADDED = ("moved", "righted", "effects", "weight")
MEASURED = tuple(field.name for field in fields(Windows) if field.name not in _ADDED)
"""Arrays of windows that are computed from samples alone."""


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Samples without a gap, with the quantities computed once per sample."""

    i_abc: FloatArray
    i_s: ComplexArray
    u_s: ComplexArray
    i_dq: ComplexArray
    angle: FloatArray
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
    short : float, optional
        Cut short windows as well, from the same beginnings: those without a zero crossing of a phase current, those
        at small current, and a quarter of the others. They begin in one of :attr:`short_every` intervals of so many s,
        see :func:`kept_of`.
    """

    def __init__(self, shapes: CapacitiveShapes, short: float | None = None) -> None:
        self._shapes, self._short = shapes, short
        self.short_every = 1
        self._heating, self._drop_scale = 0.0, 1.0
        self._turned = self._heat = 0.0  # up to the last sample, rad and A^2 s
        self._lagged = np.zeros(len(LAGS), np.complex128)  # at the last sample, A
        self._run, self._recording, self._section = -1, 0, -1
        self._paused = -np.inf  # since when, ns; infinite before a recording
        self._gaps = 0.0  # s
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

    def restart(self, time: float, recording: int, last: tuple[int, int] | None = None) -> None:
        """Continue at another time, s, with another recording, after :meth:`finish`, and after a last run and section.

        Default of these: those that were cut last.
        """
        self._time, self._recording, self._heat, self._paused, self._gaps = time, recording, 0.0, -np.inf, 0.0
        self._run, self._section = last or (self._run, self._section)

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
                self._begin(samples.stamp[run.start])
            self._paused = float(samples.stamp[run.stop - 1])
            while len(self._rest) >= 2 * fewest:
                yield from self._cut(self._rest.part(slice(2 * fewest)))
            if len(self._rest) >= fewest:
                yield from self._cut(self._rest)

    def adjacent(self, samples: Samples, length: int) -> Iterator[tuple[int, Windows]]:
        """Yield pieces of adjacent windows of ``length`` samples, and the sample where the first of each piece starts.

        The first few and the last few samples of a run are not included.
        """
        self._period = samples.sample_period
        grain = spacing(self._period)
        for run in samples.runs():
            self._begin(samples.stamp[run.start])
            self._paused = float(samples.stamp[run.stop - 1])
            stretch = self._stretch(samples, np.zeros(len(samples), np.bool_), run, continues=False)
            every = np.arange(-_PAST[0], len(stretch) - length - _REACH, length)
            for begin in np.split(every, range(_ADJACENT, len(every), _ADJACENT)) if len(every) else ():
                first = max(int(begin[0] + _PAST[0]) // grain - 1, 0) * grain
                self._time = first * self._period
                part = stretch.part(slice(first, int(begin[-1]) + length + _REACH + 1))
                sums, short = _Sums.over(part, self._period, self._shapes.coarse), np.zeros(len(begin), np.bool_)
                windows = self._windows(part, sums, begin - first, begin - first + length, short)
                yield run.start + int(begin[0]), windows

    def _begin(self, stamp: float) -> None:
        self._run += 1
        gap = (stamp - self._paused) * 1e-9
        self._section += gap > _PAUSE
        self._gaps += gap if np.isfinite(gap) else 0.0

    def _stretch(self, samples: Samples, idle: BoolArray, run: slice, *, continues: bool) -> _Stretch:
        """Return the new samples of a run with the quantities integrated over them."""
        i_abc, count = samples.i_abc[run], run.stop - run.start
        i_s, u_s, i_dq = (np.empty((count, 2)) for _ in range(3))
        lagged = np.empty((count, len(LAGS), 2))
        weights = np.stack(_lag_weights(samples.sample_period))
        if continues:
            lagged[0] = self._lagged.view(np.float64).reshape(-1, 2)
        _follow(i_abc, samples.u_abc[run], samples.angle[run], weights, not continues, i_s, u_s, i_dq, lagged)
        a, b, c = np.square(i_abc[1:].T)
        steps = frames.wrapped(np.diff(samples.angle[run]))
        turned = np.cumsum(np.append(self._turned if continues else 0.0, steps))
        heat = np.cumsum(np.append(self._heat, 2 * THIRD * (a + b + c) * samples.sample_period))
        lags = _complex(lagged)
        self._turned, self._heat, self._lagged = float(turned[-1]), float(heat[-1]), lags[-1].copy()
        new, later = slice(run.start + continues, run.stop), slice(int(continues), None)
        return _Stretch(  # currents without their sum: they shift the zero crossings as those of two sensors do
            i_abc=np.ascontiguousarray(frames.phases(_complex(i_s)[later])),
            i_s=_complex(i_s)[later],
            u_s=_complex(u_s)[later],
            i_dq=_complex(i_dq)[later],
            angle=samples.angle[new],
            idle=idle[new],
            turned=turned[later],
            heat=heat[later],
            lagged=lags[later],
            link=samples.or_unknown("dc_link_voltage")[new],
            winding=samples.or_unknown("winding_temperature")[new],
            magnet=samples.or_unknown("magnet_temperature")[new],
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
        complete = begin + length + max(_REACH, self._way_step) < len(stretch)
        count = len(begin) if complete.all() else int(complete.argmin())
        begin_used, end_used = begin[:count], begin[:count] + length[:count]
        moving = ~(stretch.idle[begin_used] & stretch.idle[end_used])
        if moving.any():
            begin_used, end_used = begin_used[moving], end_used[moving]
            whole, sums = len(begin_used), _Sums.over(stretch, self._period, self._shapes.coarse)
            if self._short is not None:
                wanted = kept_of(interval(self._time + self._period * begin_used, self._short), self.short_every)
                begin_used, end_used = self._with_short(stretch, sums, begin_used, end_used, wanted)
            yield self._windows(stretch, sums, begin_used, end_used, np.arange(len(begin_used)) >= whole)
        self._number += count
        grain = spacing(self._period)
        past = max(0, int(begin[count]) - grain * -(_PAST[0] // grain)) if count < len(begin) else 0
        self._rest, self._origin = self._rest.part(slice(past, None)), self._origin + past
        self._time += past * self._period

    def _places(self, stretch: _Stretch) -> tuple[IntArray, IntArray]:
        """Return the starts of the next windows within the stretch and their lengths in samples.

        Equally spaced starts can lock to the phase of a rotor-position harmonic at certain speeds; a golden-section
        jitter spreads them evenly over all phases.
        """
        grain = spacing(self._period)
        stride = max(1.0, STRIDE / self._period / grain)
        number = self._number + np.arange(int(len(stretch) / grain / stride) + 2)
        place = np.floor((number + number * _GOLDEN % 1.0) * stride).astype(np.int64)
        begin = grain * (place - (2 * _PAST[0] // grain)) - self._origin  # only after the lags have settled
        longest, step = max(2.0, LONGEST_WINDOW / (self._period * grain)), self._way_step
        lengths = [
            _length_of_way(x, way, begin, step)
            for x, way in ((stretch.turned, WINDOW_ANGLE), (stretch.i_dq, WINDOW_CURRENT * self._shapes.i_max))
        ]
        length = np.clip(np.rint(np.minimum(*lengths) / grain), 2, longest)
        return begin, grain * length.astype(np.int64)

    @property
    def _way_step(self) -> int:
        """Samples from one to the next over which the way of rotor and current is taken."""
        return max(1, round(_WAY_STEP / self._period))

    def _with_short(
        self, stretch: _Stretch, sums: _Sums, begin: IntArray, end: IntArray, wanted: BoolArray
    ) -> tuple[IntArray, IntArray]:
        """Append the places of the short windows among the wanted ones."""
        grain, places = spacing(self._period), (begin, end)
        begin, end = begin[wanted], end[wanted]
        turns = np.rint((end - begin) * (SHORT_ANGLE / WINDOW_ANGLE) / grain).astype(np.int64)
        sooner = begin + grain * np.maximum(turns, 1)
        current = np.maximum(np.abs(stretch.i_s[begin]), np.abs(stretch.i_s[sooner]))
        scales = self._shapes.scales
        useful = (sums.clearance(begin, sooner) > scales[1]) | (current < scales[self._shapes.usual - 1])
        useful |= (self._origin + begin) // grain % _SOME == 0
        return np.append(places[0], begin[useful]), np.append(places[1], sooner[useful])

    def _windows(self, stretch: _Stretch, sums: _Sums, begin: IntArray, end: IntArray, short: BoolArray) -> Windows:
        period, grain = self._period, spacing(self._period)
        u_s, i_dq = stretch.u_s, stretch.i_dq
        shape = self._shapes.integrals(stretch.i_abc[::grain], period * grain)
        rectified = self._rectified(stretch, shape)
        ends = np.stack([begin, end], axis=1)
        slope = i_dq[ends[..., None] + _PAST] @ (_LINE / period)
        now = i_dq[ends[..., None] + _BESIDE] @ _CUBIC
        decay, by_last, by_now = _lag_weights(period)
        lagged = decay * stretch.lagged[ends - 1] + by_last * i_dq[ends - 1, None] + by_now * now[..., None]
        speed = stretch.turned[ends[..., None] + _NEAR] @ _NEAR / (period * np.sum(_NEAR**2))
        winding, magnet = (x[begin] - REFERENCE_TEMPERATURE for x in (stretch.winding, stretch.magnet))
        heating = np.where(np.isnan(winding), self._heating, winding)
        return Windows(
            time=self._time + period * begin.astype(np.float64),
            gaps=np.full(len(begin), self._gaps),
            i_dq=frames.as_pairs(i_dq[ends]),
            angle=stretch.angle[ends],
            voltage=sums.voltage[end] - sums.voltage[begin],
            current=sums.current[end] - sums.current[begin],
            duration=period * (end - begin).astype(np.float64),
            shifted=np.stack([period * (u_s[end + shift] - u_s[begin + shift]) for shift in SHIFTS], axis=1),
            shape=shape[end // grain] - shape[begin // grain],
            rectified=rectified[end // grain] - rectified[begin // grain],
            lag=self._lag(stretch, shape, begin // grain, end // grain),
            crossing=sums.crossing[end] - sums.crossing[begin],
            sensed=sums.sensed[end] - sums.sensed[begin],
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
            link=_link(stretch, period, begin, end),
            loaded=sums.loaded[end] - sums.loaded[begin],
            run=np.full(len(begin), self._run),
            recording=np.full(len(begin), self._recording),
            section=np.full(len(begin), self._section),
            clearance=sums.clearance(begin, end),
            short=short,
        )

    def _coarse(self, shape: FloatArray) -> FloatArray:
        """Return those of the coarse shapes (G, L, 3) among the integrals of all (G, S, 3)."""
        return shape[:, : self._shapes.usual : 2]

    def _rectified(self, stretch: _Stretch, shape: FloatArray) -> FloatArray:
        """Return the integrals (G, L + 1, 3), see :class:`Windows`, from those of all shapes (G, S, 3).

        Only in a step in which a current changes its sign, one of some hundred, are they too small.
        """
        grain = spacing(self._period)
        current = stretch.i_abc[::grain]
        charge = 0.5 * self._period * grain * (current[1:] + current[:-1])
        steps = np.concatenate([np.diff(self._coarse(shape), axis=0), charge[:, None]], axis=1)
        return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(np.abs(steps), axis=0)])

    def _lag(self, stretch: _Stretch, shape: FloatArray, begin: IntArray, end: IntArray) -> ComplexArray:
        """Return the integrals (N, L), see :class:`Windows`, from those of all shapes (G, S, 3), ends in grains."""
        grain, angle = spacing(self._period), stretch.angle
        places = np.arange(0, len(angle), grain)
        earlier = np.maximum(places - 1, 0)
        before = stretch.i_s[earlier] * np.exp(1j * (angle[places] - angle[earlier]))
        then = self._shapes.coarse.integrals(frames.phases(before), self._period * grain)
        now = self._coarse(shape)
        return frames.space_vector((now[end] - now[begin]) - (then[end] - then[begin]))


@dataclass(frozen=True, eq=False)
class _Sums:
    """Integrals (N,) over a stretch from its first sample on, and how far its phase currents are from zero.

    ``least`` is the smallest absolute phase current of a sample, A, ``until`` the same up to the next sample: 0 where a
    phase crosses zero.

    If the drop steps from -D to D at a zero crossing that is t T earlier than linear interpolation between two samples
    predicts, its integral increases by ``2 D t T``. The current has a kink at the step and the shapes round its corner,
    so t is a few hundredths and about the same at all crossings. Each adds the vector of its phase, positive for a
    rising current, times 2/3 of the sample period to ``crossing``.
    """

    voltage: ComplexArray
    current: ComplexArray
    loaded: ComplexArray
    crossing: ComplexArray
    sensed: ComplexArray
    least: FloatArray
    until: FloatArray

    @classmethod
    def over(cls, stretch: _Stretch, period: float, shapes: CapacitiveShapes) -> _Sums:
        i_abc, u_s = stretch.i_abc, stretch.u_s[:-1]
        i_s = 0.5 * (stretch.i_s[:-1] + stretch.i_s[1:])  # mean over each sample
        power = 1.5 * (u_s.real * i_s.real + u_s.imag * i_s.imag)
        rising = np.where(i_abc[:-1] * i_abc[1:] < 0.0, np.sign(i_abc[1:]), 0.0)
        least, negative = np.abs(i_abc).min(axis=1), i_abc < 0.0
        crossed = (negative[:-1] != negative[1:]).any(axis=1)
        return cls(
            voltage=_summed(period * u_s),
            current=_summed(period * i_s),
            loaded=_summed(period * power * u_s),
            crossing=_summed(period * frames.space_vector(rising)),
            sensed=_sensed(i_abc, stretch.i_s, period, shapes.scales),
            least=least,
            until=np.append(np.where(crossed, 0.0, least[:-1]), least[-1]),
        )

    def clearance(self, begin: IntArray, end: IntArray) -> FloatArray:
        """Return the smallest absolute value (N,) of a phase current from ``begin`` to ``end``, 0 if one crosses."""
        within = np.minimum.reduceat(self.until, np.stack([begin, end], axis=1).ravel())[::2]
        return np.asarray(np.minimum(within, self.least[end]))


@compiled(
    "const f8[:, ::1], const f8[:, ::1], const f8[::1], const f8[:, ::1], b1, f8[:, ::1], f8[:, ::1], f8[:, ::1], "
    "f8[:, :, ::1]"
)
def _follow(
    i_abc: FloatArray,
    u_abc: FloatArray,
    angle: FloatArray,
    weights: FloatArray,
    first: bool,
    i_s: FloatArray,
    u_s: FloatArray,
    i_dq: FloatArray,
    lagged: FloatArray,
) -> None:
    """Compute the space vectors of a run and the lagging currents in one pass.

    Parameters
    ----------
    i_abc, u_abc : (N, 3) float
        A, V.
    angle : (N,) float
        rad.
    weights : (3, L) float
        Weights of the last lagging, the last and the present current, see :func:`_lag_weights`.
    first : bool
        Whether a run begins: lagging currents then start at the current itself; otherwise they are given.
    i_s, u_s, i_dq : (N, 2) float
        Output: current and voltage in the stator frame, current in the rotor frame.
    lagged : (N, L, 2) float
        Output: i_dq after the lags.
    """
    for k in range(len(angle)):
        a, b, c = i_abc[k, 0], i_abc[k, 1], i_abc[k, 2]
        i_s[k, 0], i_s[k, 1] = (2.0 * a - b - c) * THIRD, (b - c) * ROOT_THIRD
        cosine, sine = math.cos(angle[k]), math.sin(angle[k])
        i_dq[k, 0] = i_s[k, 0] * cosine + i_s[k, 1] * sine
        i_dq[k, 1] = i_s[k, 1] * cosine - i_s[k, 0] * sine
        a, b, c = u_abc[k, 0], u_abc[k, 1], u_abc[k, 2]
        u_s[k, 0], u_s[k, 1] = (2.0 * a - b - c) * THIRD, (b - c) * ROOT_THIRD
    for lag in range(weights.shape[1]):
        decay, before, now = weights[0, lag], weights[1, lag], weights[2, lag]
        for axis in range(2):
            if first:
                lagged[0, lag, axis] = i_dq[0, axis]
            for k in range(1, len(angle)):
                driven = now * i_dq[k, axis] + before * i_dq[k - 1, axis]
                lagged[k, lag, axis] = driven + decay * lagged[k - 1, lag, axis]


def _sensed(i_abc: FloatArray, i_s: ComplexArray, period: float, scales: FloatArray) -> ComplexArray:
    """Return the integrals (N, L, 5), see :class:`Windows`, from the first sample on."""
    out, (pairs, axes) = np.zeros((len(i_abc), len(scales), 5, 2)), (frames.as_pairs(x) for x in (i_s, _AXES))
    _integrate(i_abc, pairs, period, np.ascontiguousarray(scales), axes, out)
    return _complex(out)


@compiled("const f8[:, ::1], const f8[:, ::1], f8, const f8[::1], const f8[:, ::1], f8[:, :, :, ::1]")
def _integrate(
    i_abc: FloatArray, i_s: FloatArray, period: float, scales: FloatArray, axes: FloatArray, sensed: FloatArray
) -> None:
    """Integrate the slopes of the shapes, see :func:`_sensed`, of which the first are given.

    A change x of the measured currents changes the integral of a shape h(i) by that of h'(i) x, where h' is its
    difference quotient between two samples.
    """
    for k in range(1, len(i_abc)):
        alpha, beta = 0.5 * (i_s[k - 1, 0] + i_s[k, 0]), 0.5 * (i_s[k - 1, 1] + i_s[k, 1])
        for number in range(len(scales)):
            for effect in range(5):
                for axis in range(2):
                    sensed[k, number, effect, axis] = sensed[k - 1, number, effect, axis]
        for phase in range(3):
            before, now = i_abc[k - 1, phase], i_abc[k, phase]
            if before == now:
                continue
            cosine, sine = axes[phase, 0], axes[phase, 1]
            moved = (
                alpha * sine - beta * cosine, alpha * cosine - beta * sine, alpha * sine + beta * cosine, cosine, sine
            )  # fmt: skip
            for number in range(len(scales)):
                rise = drop_shape(now / scales[number]) - drop_shape(before / scales[number])
                share = 2.0 * THIRD * period * rise / (now - before)
                for effect in range(5):
                    sensed[k, number, effect, 0] += share * moved[effect] * cosine
                    sensed[k, number, effect, 1] += share * moved[effect] * sine


def interval(time: FloatArray, length: float) -> IntArray:
    """Return the number (N,) of the interval of ``length`` seconds of each time (N,), s."""
    return np.asarray((time + _ROUNDING) / length).astype(np.int64)


def kept_of(number: IntArray, every: int) -> BoolArray:
    """Tell (N,) which of the intervals of these numbers (N,) are kept where one of ``every`` is, as if by lot.

    At even distances, what varies with that period looks constant, and so it does at multiples of the golden section.
    The fractions of its products with squares have no period (Weyl 1916). What is kept of more is kept of fewer, too.
    """
    return np.asarray(np.square(number, dtype=np.float64) * _GOLDEN % 1.0 < 1.0 / every)


def _summed(steps: FloatArray | ComplexArray) -> ComplexArray:
    """Return the sums (N,), from the first sample on, of what follows each sample but the last one (N - 1,)."""
    return np.cumsum(np.append(0j, steps), dtype=np.complex128)


def _complex(pairs: FloatArray) -> ComplexArray:
    """Return real and imaginary parts (..., 2) as complex numbers (...), without a copy."""
    return pairs.view(np.complex128)[..., 0]


def _length_of_way(x: FloatArray | ComplexArray, way: float, begin: IntArray, step: int) -> IntArray:
    """Return after how many samples (W,) from ``begin`` ``x`` (N,) has gone a way; more than N if it has not.

    Steps of several samples are added up, so that noise does not lengthen the way.
    """
    rate = np.abs(x[step:] - x[:-step]) / step
    gone = np.concatenate([[0.0], np.cumsum(rate)])
    wanted = gone[np.minimum(begin, len(rate))] + way
    end = np.minimum(np.searchsorted(gone, wanted), len(rate))
    end -= (end > 0) & (gone[end] - wanted > wanted - gone[end - 1])  # the nearer one
    return np.where(wanted <= gone[-1], end - begin, 2 * len(x))


def _link(stretch: _Stretch, period: float, begin: IntArray, end: IntArray) -> ComplexArray:
    """Return int u_s u_dc (N,), V^2 s, NaN where the DC-link voltage is not known."""
    unknown = np.cumsum(np.append(0, np.isnan(stretch.link)[:-1]))
    link = period * _summed((stretch.u_s * np.nan_to_num(stretch.link))[:-1])
    return np.where(unknown[end] == unknown[begin], link[end] - link[begin], np.nan)


def _lag_weights(period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weights of the last lagging, the last and the present current; between samples it is linear."""
    lags = np.array(LAGS)
    decay = np.exp(-period / lags)
    now = 1 - (1 - decay) * lags / period
    return decay, 1 - decay - now, now


def spacing(period: float) -> int:
    """Return the samples, of a period in s, from one possible end of windows to the next; between, i is linear."""
    return max(1, int(1.001 * _FINEST / period))
