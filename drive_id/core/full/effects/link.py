"""Voltages that follow the DC link."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import (
    CERTAIN,
    MOST_RUNS,
    Calibration,
    DriveEffect,
    Linearized,
    Recorded,
    Reported,
)
from drive_id.core.full.windows import Windows
from drive_id.types import FloatArray

_SMALL = 1e-4
"""Angle, rad, that stands for smaller ones, by which nothing may be divided: both moments are then exact to 1e-4."""
_MISSED = 0.05
"""Share of the variation that noise of the log may hide or feign: of variations of 1 %, 0.05 % of the voltage."""
_LEVELS = 0.005
"""Relative difference of the link's means from which on their reference matters: five times what maps are off by."""


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
        key, told = "", {}
        if not -far < share < 1 + far:
            key = "dc_link_share.impossible"
        elif far < share < 1 - far:
            key = "dc_link_share.partial"
        elif share > 0.5 and high > (1 + _LEVELS) * low:
            key, told = "dc_link_share.levels", {"low": low, "high": high}
            told |= {"rise": found.link / low - 1, "fall": found.link / high - 1}
        entry = found.entry("dc_link_share", share, sigma, "1", key, mean=found.link, **told)
        yield replace(entry, doubtful=True) if key else entry


@dataclass(frozen=True)
class LinkRipple(DriveEffect):
    """Cosine and sine of a ripple of the link that was not recorded, relative, in each run.

    The voltages exceed those commanded by the share ``a cos 2 pi f t + b sin 2 pi f t``; the phase is unknown after a
    gap.
    """

    width = 2 * MOST_RUNS
    of_link, at_rest, of_recordings, of_recorded_runs = True, True, True, True

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return known.runs <= MOST_RUNS and not known.link

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return at.in_runs(ripple_columns(at.windows)(at.ripple).T) if at.ripple else []

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry("link_ripple", *found.amplitude, "1", frequency=found.ripple)


@dataclass(frozen=True)
class LinkSag(DriveEffect):
    """Relative fall of the link per power p that is taken: ``int u_s p``."""

    of_link, at_rest, positive = True, True, True

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return not known.link

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [at.windows.loaded]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry("link_sag", 1e5 * found.value[0], 1e5 * found.sigma[0], "%/kW")


def ripple_columns(windows: Windows) -> Callable[[float], ComplexArray]:
    """Return the function of a frequency, Hz, that gives the columns (N, 2) of cosine and sine of a ripple, Vs.

    The voltage in the rotor frame is taken as a straight line over a window, with the slope between the voltages held
    before its ends, and with the recorded integral.
    """
    speed, duration = windows.speed.mean(axis=1), windows.duration
    at = windows.time + 0.5 * duration
    turned = np.exp(0.5j * speed * duration)  # from the middle to the end
    steps = windows.held[:, 1] / turned - windows.held[:, 0] * turned
    slope = 0.5 * duration * steps * np.exp(0.5j * speed * windows.period)  # held from half a sample ago on average
    constant, linear = _moments(0.5 * speed * duration)
    mean = (windows.voltage - slope * linear) / constant

    def columns(frequency: float) -> ComplexArray:
        turns = 2 * np.pi * frequency
        sides = []
        for sign in (1, -1):
            constant, linear = _moments(0.5 * (speed + sign * turns) * duration)
            sides.append(np.exp(1j * sign * turns * at) * (mean * constant + slope * linear))
        return np.stack([-0.5 * (sides[0] + sides[1]), 0.5j * (sides[0] - sides[1])], axis=1)

    return columns


def _moments(x: FloatArray) -> tuple[FloatArray, ComplexArray]:
    """Return the means (N,) of e^{j x s} and s e^{j x s} over s from -1 to 1."""
    x = np.where(np.abs(x) < _SMALL, _SMALL, x)
    mean = np.sin(x) / x
    return mean, np.asarray(1j * (mean - np.cos(x)) / x, np.complex128)
