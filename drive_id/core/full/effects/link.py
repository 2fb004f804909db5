"""Voltages that follow the DC link."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import (
    CERTAIN,
    MOST_RUNS,
    Calibration,
    DriveEffect,
    Fitted,
    Linearized,
    Recorded,
    Reported,
)
from drive_id.core.full.windows import Windows
from drive_id.types import TINY, FloatArray

_SMALL = 1e-4
"""Angle, rad, that stands for smaller ones, by which nothing may be divided: both moments are then exact to 1e-4."""
_MISSED = 0.05
"""Share of the variation that noise of the log may hide or feign: of variations of 1 %, 0.05 % of the voltage."""
_LEVELS = 0.005
"""Relative difference of the link's means, each of a second, from which on their reference matters: five times what
maps are off by."""
_MOST_SHARE = 0.5
"""Beyond none or all of the drop that may seem to follow the link: the curve is that at its mean."""
_MOST = 0.2
"""Amplitude of a ripple, relative to the link, beyond which a drive would have tripped."""
_MOST_DRIFT = 0.03
"""Rise within a recording, relative to the link, that no supply has: at low speed, a winding that warms by 26 K looks
like one of 10 %."""
_USUAL_DRIFT = 5e-3
"""By which it may rise or fall unnoticed: rectified mains drift by up to 1 %, laboratory supplies by a tenth of it."""
_FEW_TURNS = 3.0
"""Turns of a ripple within a run up to which it may stand for a step or a drift, after which the mean is another."""


@dataclass(frozen=True)
class DcLink(DriveEffect):
    """Share of the recorded link's variation that acts on the voltages: ``-int u_s (u_dc / mean - 1) dt``."""

    at_rest = True

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return known.link

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [-np.nan_to_num(at.windows.link / at.link - at.windows.voltage)] if np.isfinite(at.link) else []

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        share, sigma = found.value[0], found.sigma[0]
        (low, high), far = found.links, max(_MISSED, CERTAIN * sigma)
        key, told, doubtful = "", {}, True
        if abs(share + 1) < far:  # duty cycles were multiplied by the noise of a constant link
            key, doubtful = "dc_link_share.noise", False
        elif not -far < share < 1 + far:
            key = "dc_link_share.impossible"
        elif far < share < 1 - far:
            key = "dc_link_share.partial"
        elif share > 0.5 and high > (1 + _LEVELS) * low:
            key, told = "dc_link_share.levels", {"low": low, "high": high}
            told |= {"rise": found.link / low - 1, "fall": found.link / high - 1}
        level = 0.5 * abs(share) * (high / low - 1)  # the link at which the commands are right is one of those met
        entry = found.entry("dc_link_share", share, sigma, "1", key, mean=found.link, level=level, **told)
        yield replace(entry, doubtful=bool(key) and doubtful)


@dataclass(frozen=True)
class DropByLink(DriveEffect):
    """Share of the inverter's drop that follows the recorded link, as that of a dead time: its integral by the link."""

    at_rest = True

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return known.link

    def plausible(self, value: FloatArray, _turn: float, _period: float) -> bool:  # noqa: D102
        return bool(-_MOST_SHARE < value[0] < 1 + _MOST_SHARE)

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        square = np.maximum(np.abs(at.windows.voltage) ** 2, TINY)
        varied = (at.windows.link * at.windows.voltage.conj()).real / square / at.link - 1.0
        return [at.drop * np.clip(np.nan_to_num(varied), -_MOST, _MOST)] if np.isfinite(at.link) else []

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry("inverter_drop_by_link", found.value[0], found.sigma[0], "1", mean=found.link)


@dataclass(frozen=True)
class LinkRipple(DriveEffect):
    """Cosine and sine of a ripple of the link that was not recorded, relative, in each run.

    The voltages exceed those commanded by the share ``a cos 2 pi f t + b sin 2 pi f t``; the phase is unknown after a
    gap.
    """

    width = 2 * MOST_RUNS
    of_link, at_rest, of_recordings, of_recorded_runs, attuned = True, True, True, True, True

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return known.runs <= MOST_RUNS and not known.link

    def plausible(self, value: FloatArray, _turn: float, _period: float) -> bool:  # noqa: D102
        return bool(abs(value[0]) < _MOST)

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return at.in_runs(RippleShape.of(at.windows).columns(at.ripple).T) if at.ripple else []

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        if found.turns > _FEW_TURNS:
            yield found.entry("link_ripple", *found.amplitude, "1", frequency=found.ripple)
        else:
            told = {"span": 1.0 / found.ripple, "level": found.amplitude[0]}
            yield replace(found.entry("link_ripple", *found.amplitude, "1", "link_ripple.slow", **told), doubtful=True)


@dataclass(frozen=True)
class LinkDrift(DriveEffect):
    """Relative rise of the link within each recording, in proportion to time: ``-int u_s`` times the time.

    The middle of a recording has the mean link, on which the scale of the map rests.
    """

    of_link, at_rest, of_recordings, of_recorded_runs = True, True, True, True

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return not known.link

    def plausible(self, value: FloatArray, _turn: float, _period: float) -> bool:  # noqa: D102
        return bool(abs(value[0]) < _MOST_DRIFT)

    def expected(self, fit: Fitted) -> float:  # noqa: D102
        return 0.0 if fit.link else _USUAL_DRIFT

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [-at.windows.voltage * at.course]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        value, sigma = float(found.value[0]), float(found.sigma[0])
        yield replace(found.entry("link_drift", value, sigma, "1", level=0.5 * abs(value)), doubtful=True)


@dataclass(frozen=True)
class FallPerPower(DriveEffect):
    """A relative fall per power p that is taken from a link that was not recorded, told by the name of its entry."""

    entry: str
    at_rest, positive = True, True

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return not known.link

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry(self.entry, 1e5 * found.value[0], 1e5 * found.sigma[0], "%/kW")


@dataclass(frozen=True)
class LinkSag(FallPerPower):
    """The link falls: ``int (u_s - drop) (p - p_drop)``.

    A dead time takes its drop from the link's voltage: the drop falls as well, and its power is not taken.
    """

    of_link = True

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [at.windows.loaded - _of_drop(at)]


@dataclass(frozen=True)
class DeviceSag(FallPerPower):
    """The share of the drop that is of the devices: it stays as it is, and its power is taken from the link."""

    beside = "link_sag"

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [_of_drop(at)]


@dataclass(frozen=True)
class DropBySag(FallPerPower):
    """The drop falls, and nothing else: ``-int drop (p - p_drop)``.

    As under a link that falls where the drive corrects its voltages for that.
    """

    price = 0.03  # a map that is a little too stiff saves 1 to 2 %; a link that falls by 3 % saved 12 %

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [-at.drop * (at.power - at.spared)]


@dataclass(frozen=True)
class LinkRise(DriveEffect):
    """Relative rise of the link while power flows back, as to where a brake chopper begins: ``-int u_s`` there."""

    of_link, at_rest, positive = True, True, True

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return not known.link

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        windows, voltage = at.windows, at.windows.voltage
        ends = 1.5 * (windows.held * (at.currents * at.turn).conj()).real
        half = np.maximum(0.5 * np.abs(ends[:, 1] - ends[:, 0]), TINY)
        return [-voltage * (0.5 - 0.5 * np.clip(at.power, -half, half) / half)]  # the share of a line that is negative

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry("link_rise", found.value[0], found.sigma[0], "1")


def _of_drop(at: Linearized) -> ComplexArray:
    """Return ``int (u_s p - (u_s - drop) (p - p_drop))`` (N,), V^2 A s."""
    return np.asarray(at.windows.voltage * at.spared + at.drop * (at.power - at.spared))


@dataclass(frozen=True, eq=False)
class RippleShape:
    """The voltage in windows, as the columns of a ripple of any frequency need it; build it by :meth:`of`.

    The voltage in the rotor frame is taken as a straight line over a window, with the slope between the voltages held
    before its ends, and with the recorded integral.
    """

    middle: FloatArray  # (N,), s
    duration: FloatArray  # (N,), s
    speed: FloatArray  # (N,), rad/s
    mean: ComplexArray  # (N,), Vs
    slope: ComplexArray  # (N,), Vs, from the middle to the end

    @classmethod
    def of(cls, windows: Windows) -> RippleShape:
        """Take what windows hold."""
        speed, duration = windows.speed.mean(axis=1), windows.duration
        turned = np.exp(0.5j * speed * duration)  # from the middle to the end
        steps = windows.held[:, 1] / turned - windows.held[:, 0] * turned
        slope = 0.5 * duration * steps * np.exp(0.5j * speed * windows.period)  # held from half a sample ago on average
        constant, linear = _moments(0.5 * speed * duration)
        mean = (windows.voltage - slope * linear) / constant
        return cls(windows.time + 0.5 * duration, duration, speed, mean, slope)

    def integrals(self, frequency: float) -> tuple[ComplexArray, ComplexArray]:
        """Return those (N,) of ``u_s e^{j 2 pi f t}`` and ``u_s e^{-j 2 pi f t}`` with t from a window's middle, Vs."""
        sides = []
        for sign in (1, -1):
            constant, linear = _moments(0.5 * (self.speed + sign * 2 * np.pi * frequency) * self.duration)
            sides.append(self.mean * constant + self.slope * linear)
        return sides[0], sides[1]

    def columns(self, frequency: float) -> ComplexArray:
        """Return the columns (N, 2) of cosine and sine of a ripple of a frequency, Hz, Vs."""
        turned = np.exp(2j * np.pi * frequency * self.middle)
        ahead, behind = self.integrals(frequency)
        ahead, behind = ahead * turned, behind * turned.conj()
        return np.stack([-0.5 * (ahead + behind), 0.5j * (ahead - behind)], axis=1)


def _moments(x: FloatArray) -> tuple[FloatArray, ComplexArray]:
    """Return the means (N,) of e^{j x s} and s e^{j x s} over s from -1 to 1."""
    x = np.where(np.abs(x) < _SMALL, _SMALL, x)
    mean = np.sin(x) / x
    return mean, np.asarray(1j * (mean - np.cos(x)) / x, np.complex128)
