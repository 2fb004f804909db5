"""Integrals along a run of samples: those over a window are the differences of these between its ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ROOT_THIRD, THIRD, ComplexArray
from drive_id.core.maps.inverter_curve import drop_shape
from drive_id.core.numerics.compiled import compiled
from drive_id.types import BoolArray, FloatArray, IntArray, Samples

LAGS = (1e-3, 4e-3, 16e-3)
"""Time constants of flux lags, s."""

_FINEST = 1e-4
"""Spacing of the possible ends of windows if the sample period is shorter, s."""
_AXES = np.exp(1j * frames.PHASE_SHIFTS)


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples without a gap, with the quantities computed once per sample."""

    i_abc: FloatArray
    before: FloatArray  # currents of the sample before, turned with the rotor
    wanted: FloatArray  # references of the currents, or the currents where they are not known
    i_s: ComplexArray
    u_s: ComplexArray
    i_dq: ComplexArray
    angle: FloatArray
    idle: BoolArray
    path: FloatArray  # (N, 2), angle turned and heat
    sums: ComplexArray  # (N, 4), integrals that are ``voltage``, ``current``, ``crossing`` and ``loaded`` of windows
    least: FloatArray  # (N, 2), smallest absolute phase current, and the same, but 0 where one has crossed zero
    lagged: ComplexArray  # i_dq after each of LAGS
    link: FloatArray  # DC-link voltage, NaN where unknown
    winding: FloatArray  # temperature, degrees Celsius, NaN where unknown
    magnet: FloatArray

    def __len__(self) -> int:
        return len(self.angle)

    @property
    def turned(self) -> FloatArray:
        """Electrical angle turned since the start of the run (N,), rad."""
        return self.path[:, 0]

    def part(self, selected: slice) -> Stretch:
        """Return some of the samples."""
        return Stretch(*(getattr(self, field.name)[selected] for field in fields(self)))

    def followed_by(self, other: Stretch) -> Stretch:
        """Return these samples and further ones."""
        pairs = [(getattr(self, field.name), getattr(other, field.name)) for field in fields(self)]
        return Stretch(*(np.concatenate(pair) for pair in pairs))

    def clearance(self, begin: IntArray, end: IntArray) -> FloatArray:
        """Return the smallest absolute phase current (W,) from ``begin`` to ``end``, 0 if one crosses zero."""
        within = np.minimum.reduceat(self.least[:, 1], np.stack([begin + 1, end + 1], axis=1).ravel())[::2]
        return np.asarray(np.minimum(within, self.least[begin, 0]))

    def of_link(self, period: float, begin: IntArray, end: IntArray) -> ComplexArray:
        """Return int u_s u_dc (W,), V^2 s, NaN where the DC-link voltage is not known."""
        unknown = np.cumsum(np.append(0, np.isnan(self.link)[:-1]))
        link = period * np.cumsum(np.append(0j, (self.u_s * np.nan_to_num(self.link))[:-1]))
        return np.where(unknown[end] == unknown[begin], link[end] - link[begin], np.nan)

    def sensed(self, period: float, scales: FloatArray) -> ComplexArray:
        """Return the integrals (N, L, 7) from the first sample on, see :class:`~drive_id.core.full.windows.Windows`."""
        out = np.zeros((len(self), len(scales), 7, 2))
        i_s, turn, axes = (frames.as_pairs(x) for x in (self.i_s, np.exp(1j * self.angle), _AXES))
        _integrate(self.i_abc, i_s, turn, period, np.ascontiguousarray(scales), axes, out)
        return _complex(out)


@dataclass(frozen=True, eq=False)
class Reached:
    """Integrals up to a sample, after which those over further ones continue."""

    path: FloatArray  # (2,), see :class:`Stretch`, as the others
    sums: ComplexArray  # (4,)
    lagged: ComplexArray  # (L,)

    @classmethod
    def nothing(cls) -> Reached:
        """Return the integrals before the first sample."""
        return cls(np.zeros(2), np.zeros(4, np.complex128), np.zeros(len(LAGS), np.complex128))


def integrated(
    samples: Samples, idle: BoolArray, run: slice, before: Reached, *, continues: bool
) -> tuple[Stretch, Reached]:
    """Return the new samples of a run with the quantities integrated over them, and the integrals up to the last one.

    Parameters
    ----------
    before : Reached
        Up to the sample before; if the run ``continues``, that is its first one.
    """
    count, lags = run.stop - run.start, len(LAGS)
    i_abc, earlier, i_s, u_s, i_dq, path, least = (np.empty((count, width)) for width in (3, 3, 2, 2, 2, 2, 2))
    lagged, sums = np.empty((count, lags), np.complex128), np.zeros((count, 4), np.complex128)
    path[0] = before.path if continues else before.path * [0.0, 1.0]
    if continues:
        lagged[0], sums[0] = before.lagged, before.sums
    _follow(
        samples.i_abc[run], samples.u_abc[run], samples.angle[run], samples.sample_period, frames.as_pairs(_AXES),
        np.stack(lag_weights(samples.sample_period)), not continues, i_abc, earlier, i_s, u_s, i_dq,
        lagged.view(np.float64).reshape(count, lags, 2), sums.view(np.float64), path, least,
    )  # fmt: skip
    new, later = slice(run.start + continues, run.stop), slice(int(continues), None)
    stretch = Stretch(
        i_abc=i_abc[later],
        before=earlier[later],
        wanted=_wanted(samples, new, i_abc[later]),
        i_s=_complex(i_s)[later],
        u_s=_complex(u_s)[later],
        i_dq=_complex(i_dq)[later],
        angle=samples.angle[new],
        idle=idle[new],
        path=path[later],
        sums=sums[later],
        least=least[later],
        lagged=lagged[later],
        link=samples.or_unknown("dc_link_voltage")[new],
        winding=samples.or_unknown("winding_temperature")[new],
        magnet=samples.or_unknown("magnet_temperature")[new],
    )
    return stretch, Reached(path[-1].copy(), sums[-1].copy(), lagged[-1].copy())


def _wanted(samples: Samples, new: slice, i_abc: FloatArray) -> FloatArray:
    """Return the references (N, 3) of the phase currents, or the currents where they are not known, A."""
    if samples.i_dq_reference is None:
        return i_abc
    wanted = frames.to_abc(samples.i_dq_reference[new], samples.angle[new])
    return np.where(np.isfinite(wanted), wanted, i_abc)


@compiled(
    "const f8[:, ::1], const f8[:, ::1], const f8[::1], f8, const f8[:, ::1], const f8[:, ::1], b1, f8[:, ::1], "
    "f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1]"
)
def _follow(
    measured: FloatArray,
    u_abc: FloatArray,
    angle: FloatArray,
    period: float,
    axes: FloatArray,
    weights: FloatArray,
    first: bool,
    i_abc: FloatArray,
    before: FloatArray,
    i_s: FloatArray,
    u_s: FloatArray,
    i_dq: FloatArray,
    lagged: FloatArray,
    sums: FloatArray,
    path: FloatArray,
    least: FloatArray,
) -> None:
    """Compute in one pass what windows need of the samples of a run; the first of ``sums`` and ``path`` are given.

    If the drop steps from -D to D at a zero crossing that is t T earlier than linear interpolation between two samples
    predicts, its integral increases by ``2 D t T``. The current has a kink at the step and the shapes round its corner,
    so t is a few hundredths and about the same at all crossings. Each adds the vector of its phase, positive for a
    rising current, times 2/3 of the sample period to the third of the sums.

    Parameters
    ----------
    measured, u_abc : (N, 3) float
        A, V.
    angle : (N,) float
        rad.
    period : float
        s.
    axes : (3, 2) float
        Vectors of the phases.
    weights : (3, L) float
        Weights of the last lagging, the last and the present current, see :func:`lag_weights`.
    first : bool
        Whether a run begins: lagging currents then start at the current itself; otherwise they are given.
    i_abc, before : (N, 3) float
        Output: currents without their sum, which shift the zero crossings as those of two sensors do, and the same of
        the sample before, turned with the rotor.
    i_s, u_s, i_dq : (N, 2) float
        Output: current and voltage in the stator frame, current in the rotor frame.
    lagged : (N, L, 2) float
        Output: i_dq after the lags.
    sums : (N, 8) float
        Output: see :class:`Stretch`, as ``path`` and ``least``.
    path, least : (N, 2) float
    """
    for k in range(len(angle)):
        a, b, c = u_abc[k, 0], u_abc[k, 1], u_abc[k, 2]
        u_s[k, 0], u_s[k, 1] = (2.0 * a - b - c) * THIRD, (b - c) * ROOT_THIRD
        a, b, c = measured[k, 0], measured[k, 1], measured[k, 2]
        i_s[k, 0], i_s[k, 1], zero = (2.0 * a - b - c) * THIRD, (b - c) * ROOT_THIRD, (a + b + c) * THIRD
        i_abc[k, 0], i_abc[k, 1], i_abc[k, 2] = a - zero, b - zero, c - zero
        cosine, sine = math.cos(angle[k]), math.sin(angle[k])
        i_dq[k, 0] = i_s[k, 0] * cosine + i_s[k, 1] * sine
        i_dq[k, 1] = i_s[k, 1] * cosine - i_s[k, 0] * sine
        last = max(k - 1, 0)
        x = i_dq[last, 0] * cosine - i_dq[last, 1] * sine
        y = (i_dq[last, 0] * sine + i_dq[last, 1] * cosine) * 1.5 * ROOT_THIRD
        before[k, 0], before[k, 1], before[k, 2] = x, y - 0.5 * x, -y - 0.5 * x
        least[k, 0] = least[k, 1] = min(abs(i_abc[k, 0]), abs(i_abc[k, 1]), abs(i_abc[k, 2]))
        if k == 0:
            continue
        step = (angle[k] - angle[last]) / (2.0 * math.pi)
        path[k, 0] = path[last, 0] + 2.0 * math.pi * (step - np.rint(step))
        path[k, 1] = path[last, 1] + 2.0 * THIRD * period * (a * a + b * b + c * c)
        x, y = 0.5 * period * (i_s[last, 0] + i_s[k, 0]), 0.5 * period * (i_s[last, 1] + i_s[k, 1])
        energy = 1.5 * (u_s[last, 0] * x + u_s[last, 1] * y)
        sums[k, 4], sums[k, 5] = sums[last, 4], sums[last, 5]
        for phase in range(3):
            if (i_abc[last, phase] < 0.0) != (i_abc[k, phase] < 0.0):
                least[k, 1] = 0.0
                if i_abc[last, phase] * i_abc[k, phase] < 0.0:
                    rise = math.copysign(2.0 * THIRD * period, i_abc[k, phase])
                    sums[k, 4] += rise * axes[phase, 0]
                    sums[k, 5] += rise * axes[phase, 1]
        sums[k, 0], sums[k, 1] = sums[last, 0] + period * u_s[last, 0], sums[last, 1] + period * u_s[last, 1]
        sums[k, 2], sums[k, 3] = sums[last, 2] + x, sums[last, 3] + y
        sums[k, 6], sums[k, 7] = sums[last, 6] + energy * u_s[last, 0], sums[last, 7] + energy * u_s[last, 1]
    for lag in range(weights.shape[1]):
        decay, by_last, by_now = weights[0, lag], weights[1, lag], weights[2, lag]
        for axis in range(2):
            if first:
                lagged[0, lag, axis] = i_dq[0, axis]
            for k in range(1, len(angle)):
                driven = by_now * i_dq[k, axis] + by_last * i_dq[k - 1, axis]
                lagged[k, lag, axis] = driven + decay * lagged[k - 1, lag, axis]


@compiled("const f8[:, ::1], const f8[:, ::1], const f8[:, ::1], f8, const f8[::1], const f8[:, ::1], f8[:, :, :, ::1]")
def _integrate(
    i_abc: FloatArray, i_s: FloatArray, turn: FloatArray, period: float, scales: FloatArray, axes: FloatArray,
    sensed: FloatArray,
) -> None:  # fmt: skip
    """Integrate the slopes of the shapes, see :meth:`Stretch.sensed`, of which the first are given.

    A change x of the measured currents changes the integral of a shape h(i) by that of h'(i) x, where h' is its
    difference quotient between two samples.
    """
    for k in range(1, len(i_abc)):
        alpha, beta = 0.5 * (i_s[k - 1, 0] + i_s[k, 0]), 0.5 * (i_s[k - 1, 1] + i_s[k, 1])
        real, imag = 0.5 * (turn[k - 1, 0] + turn[k, 0]), 0.5 * (turn[k - 1, 1] + turn[k, 1])
        for number in range(len(scales)):
            for effect in range(7):
                for axis in range(2):
                    sensed[k, number, effect, axis] = sensed[k - 1, number, effect, axis]
        for phase in range(3):
            before, now = i_abc[k - 1, phase], i_abc[k, phase]
            if before == now:
                continue
            cosine, sine = axes[phase, 0], axes[phase, 1]
            moved = (
                alpha * sine - beta * cosine, alpha * cosine - beta * sine, alpha * sine + beta * cosine, cosine, sine,
                real * cosine + imag * sine, real * sine - imag * cosine,
            )  # fmt: skip
            for number in range(len(scales)):
                rise = drop_shape(now / scales[number]) - drop_shape(before / scales[number])
                share = 2.0 * THIRD * period * rise / (now - before)
                for effect in range(7):
                    sensed[k, number, effect, 0] += share * moved[effect] * cosine
                    sensed[k, number, effect, 1] += share * moved[effect] * sine


def _complex(pairs: FloatArray) -> ComplexArray:
    """Return real and imaginary parts (..., 2) as complex numbers (...), without a copy."""
    return pairs.view(np.complex128)[..., 0]


def lag_weights(period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weights of the last lagging, the last and the present current; between samples it is linear."""
    lags = np.array(LAGS)
    decay = np.exp(-period / lags)
    now = 1 - (1 - decay) * lags / period
    return decay, 1 - decay - now, now


def spacing(period: float) -> int:
    """Return the samples, of a period in s, from one possible end of windows to the next; between, i is linear."""
    return max(1, int(1.001 * _FINEST / period))
