"""Voltage balance over windows in the stator frame: exact at any speed, with the flux at two instants only.

With psi_s = e^{j theta} f(i, theta), integrating u_s = R i_s + drop_s + d psi_s / dt from t_0 to t_1 gives

    e^{j theta_1} f(i_1, theta_1) - e^{j theta_0} f(i_0, theta_0) = int u_s - R int i_s - int drop_s.

It contains neither speed nor derivatives, so current noise enters at the ends only. During a window the rotor turns by
about 60 degrees electrical, never by a whole period, over which a constant flux would cancel.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from drive_id.common.temperature import REFERENCE_TEMPERATURE
from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.integrals import Reached, Stretch, integrated, lag_weights, spacing
from drive_id.core.maps.inverter_curve import CapacitiveShapes
from drive_id.types import TINY, BoolArray, FloatArray, IntArray, Samples

Own = TypeVar("Own", bound="Terms")

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
_ACCELERATED = 0.01
"""To each side of an end, over which the slope of the speeds is its acceleration, s: follows swings up to 20 Hz."""
_FILLED = 1 / 16
"""Of its square, the least variance of the times of these speeds: 1/12 if one side is filled."""
_FEWEST = 4096
"""Samples collected before windows are cut, so that overlaps cost little."""
_ADJACENT = 4096
"""Most adjacent windows that are cut at once, so that memory does not grow with the recording."""
_PAUSE = 1.0
"""Gap in the stamps, s, after which winding and magnets may have another temperature: 10 A/mm2 heat by 0.5 K/s."""
_SOME = 4
"""Of short windows with a zero crossing, one in so many is cut: they only show whether crossings disturb."""
_WAY_STEP = 5e-4
"""Step in which the way of rotor and current is added up, s: noise lengthens shorter ones."""
_GOLDEN = 0.6180339887498949
"""Golden section: shifts windows evenly, and never in step with the rotor or the trajectory."""


def held_shares(delay: FloatArray | float) -> FloatArray:
    """Return the shares (..., len(SHIFTS)) of the voltages kept around an end that a delay (..., 1), samples, takes.

    The commanded voltage is held, so a fractional delay takes exactly that fraction of the previous sample.
    """
    shifts = np.array(SHIFTS)
    return np.where(shifts < 0, np.clip(delay + shifts + 1, 0.0, 1.0), -np.clip(-delay - shifts, 0.0, 1.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Terms:
    """Terms of the balance over N windows as far as the columns of the sums need them."""

    time: FloatArray  # (N,), time of the start, gaps not counted, s
    i_dq: FloatArray  # (N, 2, 2), measured currents at [start, end], A
    angle: FloatArray  # (N, 2), electrical angle at [start, end], rad
    voltage: ComplexArray  # (N,), int u_s, Vs
    current: ComplexArray  # (N,), int i_s, As
    duration: FloatArray  # (N,), s
    # (N, len(SHIFTS)), T (u_s[end + shift] - u_s[start + shift]): change of the integral per sample of delay, Vs
    shifted: ComplexArray
    shape: FloatArray  # (N, S, 3), integrals of the inverter's shapes of each phase's current, s
    # (N, L), integrals of the coarse shapes minus those for the current one sample earlier, turned with the rotor, by
    # which a drive compensates the drop, s
    lag: ComplexArray
    crossing: ComplexArray  # (N,), sum over the zero crossings of the phase currents, see
    # :mod:`drive_id.core.full.integrals`, s
    # (N,), temperature of winding and, below, magnet above the reference temperature of resistance and flux map, K. The
    # winding: as recorded, else as set for the recording; the magnet: as recorded, else that of the winding.
    heating: FloatArray
    magnet_heating: FloatArray
    drop_scale: FloatArray  # (N,), DC-link voltage over the reference voltage of the inverter's curve
    period: FloatArray  # (N,), sample period, s
    held: ComplexArray  # (N, 2), voltage u_s held before [start, end], V
    speed: FloatArray  # (N, 2), electrical speed at [start, end], rad/s
    short: BoolArray  # (N,), whether the rotor turns by SHORT_ANGLE instead of WINDOW_ANGLE
    # (N, 2), ``i_dq`` minus the measured currents, A, and ``angle`` minus the measured angle, rad, see
    # ``EffectColumns.moved``; default: 0
    moved: ComplexArray | None = None
    righted: FloatArray | None = None
    # (N, 2), second and third derivative of the angle at [start, end], rad/s^2 and rad/s^3, see ``Windows.accelerated``
    acceleration: FloatArray | None = None
    jerk: FloatArray | None = None
    # (N, EFFECT_COLUMNS), columns of the regression that depend on a map, see :mod:`drive_id.core.full.effects`
    effects: ComplexArray | None = None
    weight: FloatArray | None = None  # (N,), of the squared residuals; default: 1

    def __len__(self) -> int:
        return len(self.time)

    def part(self: Own, selected: slice | IntArray | BoolArray) -> Own:
        """Return some of the windows."""
        return type(self)(**{name: x[selected] for name, x in vars(self).items() if x is not None})

    @classmethod
    def joined(cls: type[Own], parts: Sequence[Terms]) -> Own:
        """Concatenate windows."""
        arrays = {field.name: [getattr(part, field.name) for part in parts] for field in fields(cls)}
        known = {name: x for name, x in arrays.items() if all(own is not None for own in x)}
        return cls(**{name: np.concatenate(x) if len(x) > 1 else x[0] for name, x in known.items()})

    def held_after(self, samples: float) -> ComplexArray:
        """Return the voltages (N, 2) held before [start, end], turned on with the rotor by samples, V."""
        return np.asarray(self.held * np.exp(1j * samples * self.speed * self.period[:, None]))

    @property
    def conditioned(self) -> bool:
        """Whether a temperature or the DC link differs from its reference."""
        return bool(self.heating.any() or self.magnet_heating.any() or (self.drop_scale != 1).any())

    @property
    def weights(self) -> FloatArray:
        """Weights (N,) of the squared residuals."""
        return np.ones(len(self)) if self.weight is None else self.weight


@dataclass(frozen=True, eq=False, kw_only=True)
class Windows(Terms):
    """Terms of the balance over N windows, with what effects and reports need."""

    gaps: FloatArray  # (N,), sum of the gaps since the start of the recording, s
    # (N, L + 1, 3), integrals of the magnitudes of the coarse shapes, s, and last of the phase currents, As
    rectified: FloatArray
    # (N, L), integrals of the coarse shapes minus those for the references of the currents, s; 0 where there are none
    by_reference: ComplexArray
    # (N, L, 7), int h'(i) x of the phase currents for the coarse shapes h, x = j i_s, conj(i_s), j conj(i_s), 1, j,
    # e^{j theta} and j e^{j theta}: by how much errors of the currents change their integrals, s, the last four s/A
    sensed: ComplexArray
    # (N, 2), d i_dq / dt before [start, end], A/s, from earlier samples only: the controller responds to the noise of a
    # sample later, so that noise and slope are independent
    slope: ComplexArray
    # (N, 2, len(LAGS) + 1), i_dq at [start, end], interpolated between neighbouring samples to exclude the noise of the
    # sample itself, minus the same after first-order lags of LAGS seconds; last, the interpolated current itself, A
    lagging: ComplexArray
    turned: FloatArray  # (N, 2), electrical angle turned since the start of the run at [start, end], rad
    heat: FloatArray  # (N,), int |i_s|^2 dt from the start of the recording to the start of the window, A^2 s
    link: ComplexArray  # (N,), int u_s u_dc, V^2 s, NaN where the DC-link voltage is not known
    loaded: ComplexArray  # (N,), int u_s p with the power p = 3/2 Re(u_s conj(i_s)) that the machine takes, V^2 A s
    run: IntArray  # (N,), number of the gap-free run, below of the recording, and of a part of one between pauses
    recording: IntArray
    section: IntArray
    # (N,), smallest absolute value of a phase current within the window, 0 where one crosses zero, A
    clearance: FloatArray

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

    def accelerated(self) -> Windows:
        """Return the windows with acceleration and jerk, from the speeds around their ends; 0 where there are few."""
        acceleration, jerk = np.zeros((2, *self.speed.shape))
        ends = self.time[:, None] + self.duration[:, None] * [0.0, 1.0]
        for run in np.unique(self.run):
            own = self.run == run
            at, speed = ends[own] - ends[own][0, 0], self.speed[own]
            acceleration[own] = _slopes(at, speed - speed[0, 0], _ACCELERATED)
            jerk[own] = _slopes(at, acceleration[own], _ACCELERATED)
        return replace(self, acceleration=acceleration, jerk=jerk)

    @property
    def measured(self) -> ComplexArray:
        """Measured currents (N, 2) in the frame of ``angle`` at [start, end], A."""
        i_dq: ComplexArray = self.i_dq[..., 0] + 1j * self.i_dq[..., 1]
        return i_dq if self.moved is None else i_dq - self.moved


_ADDED = ("moved", "righted", "acceleration", "jerk", "effects", "weight")
MEASURED = tuple(field.name for field in fields(Windows) if field.name not in _ADDED)
"""Arrays of windows that are computed from samples alone."""


class WindowCutter:
    """Cuts a stream of samples into windows; the result does not depend on how the stream is divided.

    Parameters
    ----------
    shapes : CapacitiveShapes
        Of the inverter.
    segment : float, optional
        Interval of time, s, of which one in :attr:`every` is kept, see :func:`kept_of`: of the others, only
        :class:`Terms` are cut. In those kept, cut short windows as well, from the same beginnings: those without a zero
        crossing of a phase current, those at small current, and a quarter of the others.
    """

    def __init__(self, shapes: CapacitiveShapes, segment: float | None = None) -> None:
        self._shapes, self._segment = shapes, segment
        self.every = 1
        self._heating, self._drop_scale = 0.0, 1.0
        self._reached = Reached.nothing()
        self._run, self._recording, self._section = -1, 0, -1
        self._paused = -np.inf  # since when, ns; infinite before a recording
        self._gaps = 0.0  # s
        self._rest: Stretch | None = None  # samples that later windows need
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
        self._time, self._recording, self._paused, self._gaps = time, recording, -np.inf, 0.0
        self._reached = replace(self._reached, path=self._reached.path * [1.0, 0.0])
        self._run, self._section = last or (self._run, self._section)

    def cut(self, samples: Samples, idle: BoolArray | None = None, *, continues: bool = False) -> Iterator[Terms]:
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
                self._rest, self._period = self._stretch(samples, idle, run), samples.sample_period
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
            stretch = self._stretch(samples, np.zeros(len(samples), np.bool_), run)
            every = np.arange(-_PAST[0], len(stretch) - length - _REACH, length)
            for begin in np.split(every, range(_ADJACENT, len(every), _ADJACENT)) if len(every) else ():
                first = max(int(begin[0] + _PAST[0]) // grain - 1, 0) * grain
                self._time = first * self._period
                part = stretch.part(slice(first, int(begin[-1]) + length + _REACH + 1))
                shapes = self._integrated(part)
                yield run.start + int(begin[0]), self._windows(part, shapes, begin - first, begin - first + length)

    def _begin(self, stamp: float) -> None:
        self._run += 1
        gap = (stamp - self._paused) * 1e-9
        self._section += gap > _PAUSE
        self._gaps += gap if np.isfinite(gap) else 0.0

    def _stretch(self, samples: Samples, idle: BoolArray, run: slice, *, continues: bool = False) -> Stretch:
        stretch, self._reached = integrated(samples, idle, run, self._reached, continues=continues)
        return stretch

    def finish(self) -> Iterator[Terms]:
        """Yield the last windows of a run."""
        if self._rest is not None:
            yield from self._cut(self._rest)
            self._time += len(self._rest) * self._period
            self._rest = None

    def _cut(self, stretch: Stretch) -> Iterator[Terms]:
        """Yield the windows that end within ``stretch``, the beginning of the rest; drop samples no longer needed."""
        assert self._rest is not None  # for the type checker
        begin, length = self._places(stretch)
        complete = begin + length + max(_REACH, self._way_step) < len(stretch)
        count = len(begin) if complete.all() else int(complete.argmin())
        begin_used, end_used = begin[:count], begin[:count] + length[:count]
        moving = ~(stretch.idle[begin_used] & stretch.idle[end_used])
        if moving.any():
            begin_used, end_used = begin_used[moving], end_used[moving]
            shapes = self._integrated(stretch)
            kept = np.ones(len(begin_used), np.bool_)
            if self._segment is not None:
                kept = kept_of(interval(self._time + self._period * begin_used, self._segment), self.every)
            for part in np.split(np.arange(len(kept)), np.flatnonzero(np.diff(kept)) + 1):
                terms = self._windows if kept[part[0]] else self._terms
                yield terms(stretch, shapes, begin_used[part], end_used[part])
        self._number += count
        grain = spacing(self._period)
        past = max(0, int(begin[count]) - grain * -(_PAST[0] // grain)) if count < len(begin) else 0
        self._rest, self._origin = self._rest.part(slice(past, None)), self._origin + past
        self._time += past * self._period

    def _places(self, stretch: Stretch) -> tuple[IntArray, IntArray]:
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

    def _integrated(self, stretch: Stretch) -> tuple[FloatArray, FloatArray]:
        """Integrate all shapes (G, S, 3), and coarse ones of the currents before (G, L, 3), up to each possible end."""
        period, grain = self._period, spacing(self._period)
        coarse = self._shapes.coarse.integrals(stretch.before[::grain], period * grain)
        return self._shapes.integrals(stretch.i_abc[::grain], period * grain), coarse

    def _with_short(self, stretch: Stretch, begin: IntArray, end: IntArray) -> tuple[IntArray, IntArray]:
        """Append the places of the short windows."""
        grain = spacing(self._period)
        turns = np.rint((end - begin) * (SHORT_ANGLE / WINDOW_ANGLE) / grain).astype(np.int64)
        sooner = begin + grain * np.maximum(turns, 1)
        current = np.maximum(np.abs(stretch.i_s[begin]), np.abs(stretch.i_s[sooner]))
        scales = self._shapes.scales
        useful = (stretch.clearance(begin, sooner) > scales[1]) | (current < scales[self._shapes.usual - 1])
        useful |= (self._origin + begin) // grain % _SOME == 0
        return np.append(begin, begin[useful]), np.append(end, sooner[useful])

    def _terms(self, stretch: Stretch, shapes: tuple[FloatArray, FloatArray], begin: IntArray, end: IntArray) -> Terms:
        period, grain, u_s = self._period, spacing(self._period), stretch.u_s
        ends = np.stack([begin, end], axis=1)
        shape, before = (x[end // grain] - x[begin // grain] for x in shapes)
        voltage, current, crossing, _ = (stretch.sums[end] - stretch.sums[begin]).T
        winding, magnet = (x[begin] - REFERENCE_TEMPERATURE for x in (stretch.winding, stretch.magnet))
        heating = np.where(np.isnan(winding), self._heating, winding)
        return Terms(
            time=self._time + period * begin.astype(np.float64),
            i_dq=frames.as_pairs(stretch.i_dq[ends]),
            angle=stretch.angle[ends],
            voltage=voltage,
            current=current,
            duration=period * (end - begin).astype(np.float64),
            shifted=period * (u_s[end[:, None] + SHIFTS] - u_s[begin[:, None] + SHIFTS]),
            shape=shape,
            lag=frames.space_vector(self._shapes.coarse_of(shape) - before),
            crossing=crossing,
            heating=heating,
            magnet_heating=np.where(np.isnan(magnet), heating, magnet),
            drop_scale=np.full(len(begin), self._drop_scale),
            period=np.full(len(begin), period),
            held=u_s[ends - 1],
            speed=stretch.turned[ends[..., None] + _NEAR] @ _NEAR / (period * np.sum(_NEAR**2)),
            short=np.zeros(len(begin), np.bool_),
        )

    def _windows(
        self, stretch: Stretch, shapes: tuple[FloatArray, FloatArray], begin: IntArray, end: IntArray
    ) -> Windows:
        """Return these windows and, where segments are kept, short ones behind them."""
        period, grain, whole, i_dq = self._period, spacing(self._period), len(begin), stretch.i_dq
        if self._segment is not None:
            begin, end = self._with_short(stretch, begin, end)
        ends = np.stack([begin, end], axis=1)
        now = i_dq[ends[..., None] + _BESIDE] @ _CUBIC
        decay, by_last, by_now = lag_weights(period)
        lagged = decay * stretch.lagged[ends - 1] + by_last * i_dq[ends - 1, None] + by_now * now[..., None]
        first, last = int(begin.min()) // grain * grain, int(end.max()) + 1
        near, (one, other) = stretch.part(slice(first, last)), (ends - first).T
        rectified = self._rectified(near, shapes[0][first // grain : (last - 1) // grain + 1])
        sensed = near.sensed(period, self._shapes.coarse.scales)
        wanted = self._shapes.coarse.integrals(near.wanted[::grain], period * grain)
        terms = self._terms(stretch, shapes, begin, end)
        of_references = wanted[other // grain] - wanted[one // grain]
        return Windows(
            **vars(terms) | {"short": np.arange(len(begin)) >= whole},
            by_reference=frames.space_vector(self._shapes.coarse_of(terms.shape) - of_references),
            gaps=np.full(len(begin), self._gaps),
            rectified=rectified[other // grain] - rectified[one // grain],
            sensed=sensed[other] - sensed[one],
            slope=i_dq[ends[..., None] + _PAST] @ (_LINE / period),
            lagging=np.concatenate([now[..., None] - lagged, now[..., None]], axis=-1),
            turned=stretch.turned[ends],
            heat=stretch.path[begin, 1],
            link=near.of_link(period, one, other),
            loaded=stretch.sums[end, 3] - stretch.sums[begin, 3],
            run=np.full(len(begin), self._run),
            recording=np.full(len(begin), self._recording),
            section=np.full(len(begin), self._section),
            clearance=stretch.clearance(begin, end),
        )

    def _rectified(self, stretch: Stretch, shape: FloatArray) -> FloatArray:
        """Return the integrals (G, L + 1, 3), see :class:`Windows`, from those of all shapes (G, S, 3).

        Only in a step in which a current changes its sign, one of some hundred, are they too small.
        """
        grain = spacing(self._period)
        current = stretch.i_abc[::grain]
        charge = 0.5 * self._period * grain * (current[1:] + current[:-1])
        steps = np.concatenate([np.diff(self._shapes.coarse_of(shape), axis=0), charge[:, None]], axis=1)
        return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(np.abs(steps), axis=0)])


def interval(time: FloatArray, length: float) -> IntArray:
    """Return the number (N,) of the interval of ``length`` seconds of each time (N,), s."""
    return np.asarray((time + _ROUNDING) / length).astype(np.int64)


def _slopes(time: FloatArray, x: FloatArray, reach: float) -> FloatArray:
    """Return the slopes of lines by least squares through all x (...) at times within ``reach`` of each time (...)."""
    order = np.argsort(time, axis=None)
    t, y = time.ravel()[order], x.ravel()[order]
    sums = np.cumsum(np.pad([np.ones_like(t), t, y, t * t, t * y], ((0, 0), (1, 0))), axis=1)
    count, by_t, by_y, by_tt, by_ty = (
        sums[:, np.searchsorted(t, t + reach, "right")] - sums[:, np.searchsorted(t, t - reach)]
    )
    variance = by_tt / count - (by_t / count) ** 2
    slopes, filled = np.zeros_like(x), variance > _FILLED * reach**2
    slopes.ravel()[order[filled]] = ((by_ty - by_t * by_y / count) / count / np.maximum(variance, TINY))[filled]
    return slopes


def kept_of(number: IntArray, every: int) -> BoolArray:
    """Tell (N,) which of the intervals of these numbers (N,) are kept where one of ``every`` is, as if by lot.

    At even distances, what varies with that period looks constant, and so it does at multiples of the golden section.
    The fractions of its products with squares have no period (Weyl 1916). What is kept of more is kept of fewer, too.
    """
    return np.asarray(np.square(number, dtype=np.float64) * _GOLDEN % 1.0 < 1.0 / every)


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
