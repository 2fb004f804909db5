"""Signals that are late, and fluxes that lag."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import Calibration, DriveEffect, Ends, Linearized, Recorded, Reported, between
from drive_id.core.full.integrals import LAGS
from drive_id.core.full.windows import EARLIEST, MOST_DELAY, SHIFTS, Windows
from drive_id.types import TINY, FloatArray

_EARLIEST = 0.8
"""By which currents may be early, sample periods: the column holds below 1."""
_MOST_TURNED = 0.25
"""Angle, rad, by which a late angle or current may turn the flux."""
_OFF_MIDDLE = 0.25
"""Most time between sampling and the middle of the PWM period, periods: further off, legs switch."""
_DAMPED = 1.7
"""Twice the damping ratio of a tracking loop: 1.4 to 2 are usual."""
_SLOWEST_LOOP = 2.0
"""Least natural frequency of a tracking loop, Hz: those of converters and observers are 20 and more."""
_LARGEST_LAG = 0.2
"""Largest plausible share of the flux that lags behind the current, by eddy currents in magnets and sleeves."""
_OPPOSED = 0.1
"""Share of one axis, relative to the other, by which noise may make a flux that does not lag seem to lead."""
_MUCH_LAG = 0.05
"""Share of one flux from which on the map at rest depends on the time constant, which is one of three: of 2.8 % that
follow in 50 ms, the map was 0.15 % off, of 6.3 % 0.8 %."""


def _short(value: FloatArray, turn: float, period: float) -> bool:
    """Tell whether a lateness is one of few samples, which turns the flux by little."""
    return bool(abs(value[0]) < min(MOST_DELAY, _MOST_TURNED / turn) * period)


def _late(name: str, found: Reported, key: str = "", **more: Any) -> Iterator[Calibration]:
    x, dx = float(found.value[0]), float(found.sigma[0])
    yield found.entry(name, x, dx, "us", key, scale=1e6, size=abs(x), late=x > 0, **more)


def _filtered(windows: Windows, time: float, delay: float) -> ComplexArray:
    """Return the difference (N,) between the ends of the delayed voltage after a first-order lag, s; 0: that before.

    Before the oldest voltage that windows keep, it turned with the rotor. A delay as of a decimated log is left out: no
    voltage after an end may count, which answers to the noise there.
    """
    delay = 0.0 if EARLIEST < delay < 0 else delay
    rate = windows.period[:, None] / max(time, TINY)
    ago = -np.array(SHIFTS) - 1 - delay  # samples since a voltage ended
    shares = np.exp(-rate * np.maximum(ago, 0.0)) - np.exp(-rate * np.maximum(ago + 1, 0.0)) + 0j
    turn = np.exp(-1j * windows.speed.mean(axis=1) * windows.period)
    shares[:, 0] /= 1 - np.exp(-rate[:, 0]) * turn
    return np.asarray(np.sum(shares * windows.shifted, axis=1) / windows.period)


def _bent(angle: FloatArray) -> ComplexArray:
    """Return what a turn by angles (...), rad, is beyond the first order."""
    return np.asarray(np.expm1(1j * angle) - 1j * angle)


@dataclass(frozen=True)
class Latency(DriveEffect):
    """The angle is late: ``[(omega - omega_0) e^{j theta} (j f - f'(i) j i)]`` times the time.

    At one speed omega_0, the same angle at any time turns currents and fluxes together, as an offset does: only a speed
    that swings tells of it. What else it saves is a misfit of the map, which is larger than the swing's part.
    """

    turns, late, cause = True, True, "angle"

    def plausible(self, value: FloatArray, turn: float, period: float) -> bool:  # noqa: D102
        return _short(value, turn, period)

    def turned(self, at: Ends, value: FloatArray) -> FloatArray:  # noqa: D102
        return np.asarray(value[0] * (at.windows.speed - at.steady))

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [between((at.windows.speed - at.steady) * at.tilt)]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield from _late(self.name, found)


@dataclass(frozen=True)
class AngleTracking(DriveEffect):
    """The angle lags while the rotor accelerates, as that of a loop of the second type with a natural frequency w.

    The error of the angle is -(a - 2 zeta a' / w) / w^2 with the acceleration a, at swings slower than w; the unknown
    is 1 / w^2.
    """

    cause = "angle"

    def plausible(self, value: FloatArray, _turn: float, _period: float) -> bool:  # noqa: D102
        return bool(0 <= value[0] < 1 / (2 * np.pi * _SLOWEST_LOOP) ** 2)

    def waves(self, at: Ends) -> list[FloatArray]:  # noqa: D102
        acceleration, jerk = at.windows.acceleration, at.windows.jerk
        return [] if acceleration is None or jerk is None else [acceleration - _DAMPED * at.tracking * jerk]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        value, sigma = float(found.value[0]), float(found.sigma[0])
        frequency = 1 / (2 * np.pi * np.sqrt(max(value, TINY)))
        told = {"frequency": frequency, "sigma_frequency": 0.5 * frequency * sigma / max(value, TINY)}
        yield found.entry(self.name, value, sigma, "s^2", **told)


@dataclass(frozen=True)
class CurrentLatency(Latency):
    """The currents are filtered or early: ``[u_f - omega e^{j theta} (j f - f'(i) j i)]`` times the time.

    A filter with H = 1 / (1 + j omega tau) gives the currents H i and the flux H f(i), and u_f is the voltage after it.
    """

    rotates, moves_steps, cause = True, True, ""

    def plausible(self, value: FloatArray, turn: float, period: float) -> bool:  # noqa: D102
        return bool(value[0] > -_EARLIEST * period) and super().plausible(value, turn, period)

    def turned(self, at: Ends, value: FloatArray) -> FloatArray:  # noqa: D102
        return np.asarray(-value[0] * at.windows.speed)  # the currents belong to an earlier angle

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [_filtered(at.windows, at.filter, at.delay) - between(at.windows.speed * at.tilt)]


@dataclass(frozen=True)
class LogFrame(DriveEffect):
    """A log turned a signal from the rotor frame by a late angle: it holds d and q, and the drive advances its own."""

    signal: str
    of_log = True
    price = 0.03  # at one speed, a filter of the currents, which drives have more often, saves as much within 0.3 %

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return known.turned is None or self.signal in known.turned

    def plausible(self, value: FloatArray, turn: float, period: float) -> bool:  # noqa: D102
        return _short(value, turn, period)

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        advance = float(found.value[0]) / found.period
        yield from _late(self.name, found, "log_frame", signal=self.signal, advance=advance)


@dataclass(frozen=True)
class VoltageFrame(LogFrame):
    """The voltages: ``-j omega int u_s`` times the lateness of that angle.

    Voltages that are late are turned as well, but by that of their time. At one speed the map turns, which the
    reciprocity of another one shows.
    """

    rotates = True

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [-1j * at.windows.speed.mean(axis=1) * at.voltage]

    def beyond(self, at: Linearized, value: FloatArray) -> ComplexArray:  # noqa: D102
        return np.asarray(-_bent(at.windows.speed.mean(axis=1) * value[0]) * at.voltage)


@dataclass(frozen=True)
class CurrentFrame(LogFrame):
    """The currents: ``[e^{j theta} f'(i) x] + R int x + int h'(i) x``, x being j omega i, times the lateness."""

    late, of_speeds = True, True

    def shifts(self, at: Ends) -> list[ComplexArray]:  # noqa: D102
        return [1j * at.windows.speed * at.currents]

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        (column,) = super().columns(at)
        return [column + at.windows.speed.mean(axis=1) * at.dropped[0]]

    def shifted(self, at: Ends, value: FloatArray) -> ComplexArray:  # noqa: D102
        return np.asarray(np.expm1(1j * value[0] * at.windows.speed) * at.currents)

    def beyond(self, at: Linearized, value: FloatArray) -> ComplexArray:  # noqa: D102
        bent = _bent(at.windows.speed * value[0])
        return np.asarray(between(at.turn * at.through(bent * at.currents)) + bent.mean(axis=1) * at.ohmic)


@dataclass(frozen=True)
class Compensation(DriveEffect):
    """The drive compensates the drop by other currents than flow, in coarse shapes h.

    All shapes tend to 1: the first unknown, the others being differences from its shape, is the sum of all.
    """

    unit: str
    width = 4
    at_rest, positive = True, True

    @abstractmethod
    def shapes(self, at: Linearized) -> Iterable[ComplexArray]:
        """Return what is left (N,) of each coarse shape, the narrowest first, per unit."""

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        *others, widest = self.shapes(at)
        return [widest, *(other - widest for other in others)]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry(self.name, found.value[0], found.sigma[0], self.unit)


@dataclass(frozen=True)
class LateCompensation(Compensation):
    """By phase currents that are late: ``[h(i)_s]`` at the ends.

    Over the lateness t, ``int h(i)_s`` less that of the earlier currents is t times the difference between the
    ends, of currents half of it before.
    """

    def shapes(self, at: Linearized) -> Iterable[ComplexArray]:  # noqa: D102
        return at.compensations[: 2 * self.width : 2]


@dataclass(frozen=True)
class LateShape(DriveEffect):
    """That compensation has another curve than coarse shapes hold: the shapes between them, less the widest of those.

    A flux and the fundamental of late compensation look alike, and only the curve ties that to its harmonics: where the
    data ask for another one, such as a wide ramp, the standard errors of the flux hold what it leaves open.
    """

    width, beside = 4, "late_compensation"

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        shapes = at.compensations[: 2 * self.width]
        return [shape - shapes[-2] for shape in shapes[1::2]]

    def report(self, _found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield from ()


@dataclass(frozen=True)
class ReferenceCompensation(Compensation):
    """By the references of the currents: ``int h(i)_s - h(i_ref)_s``."""

    def shapes(self, at: Linearized) -> Iterable[ComplexArray]:  # noqa: D102
        return [*(at.windows.drop_scale[:, None] * at.windows.by_reference).T]


@dataclass(frozen=True)
class SamplingInstant(DriveEffect):
    """Currents are sampled before the middle of the PWM period: their mean is less by ``L^-1 e`` times that time.

    While all legs are alike, the stator's flux stands still: the map has no part in this, but R and the drop have. A
    filter of the currents does the same. Late samples are rare, and a hard dead time looks like 17 us of them.
    """

    def plausible(self, value: FloatArray, _turn: float, period: float) -> bool:  # noqa: D102
        return bool(0 <= value[0] < _OFF_MIDDLE * period)

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        moved = at.through_inverse(at.induced).mean(axis=1)
        return [-(moved.real * at.dropped[5] + moved.imag * at.dropped[6])]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield from _late(self.name, found)


@dataclass(frozen=True)
class FluxLag(DriveEffect):
    """A share of the flux lags by a short time: ``-[e^{j theta} f'(i) di/dt]`` times their product."""

    rotates, positive, cause = True, True, "flux"

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [-between(at.turn * at.through(at.windows.slope))]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield from _late(self.name, found)


@dataclass(frozen=True)
class LongFluxLag(DriveEffect):
    """A share of the flux lags by a known time, s: ``-[e^{j theta} (f(i) - f(i_lag))]`` times the share.

    The second unknown is by how much the share of psi_d exceeds the mean of both, and that of psi_q falls short.
    """

    lag: float
    width, rotates, cause = 2, True, "flux"

    def plausible(self, value: FloatArray, _turn: float, _period: float) -> bool:  # noqa: D102
        low, high = sorted(value[0] + value[1] * np.array([1.0, -1.0]))
        return bool(low > -_OPPOSED * high and high < _LARGEST_LAG)

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        lagging = at.windows.lagging[..., -1] - at.windows.lagging[..., LAGS.index(self.lag)]
        behind = at.leading - at.mean_flux(lagging)
        return [-between(at.turn * behind), -between(at.turn * behind.conj())]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        axes = np.array([[1.0, 1.0], [1.0, -1.0]])
        (d, q), (sigma_d, sigma_q) = axes @ found.value, found.sigma_of(axes)
        told = {"lag": self.lag, "d": d, "sigma_d": sigma_d, "q": q, "sigma_q": sigma_q}
        much = max(d, q) > _MUCH_LAG
        key = "flux_lag.much" if much else "flux_lag.share"
        entry = found.entry(self.name, found.value[0], found.sigma[0], "1", key, **told)
        yield replace(entry, doubtful=much)
