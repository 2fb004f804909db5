"""Signals that are late, and fluxes that lag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import Calibration, DriveEffect, Linearized, Reported, between
from drive_id.core.full.windows import LAGS
from drive_id.types import FloatArray

_LONGEST_LATENCY = 0.8
"""Of angle or currents, sample periods: the columns hold below 1."""
_MOST_TURNED = 0.25
"""Angle, rad, by which a late angle or current may turn the flux: the columns are linear in it."""
_LARGEST_LAG = 0.2
"""Largest plausible share of the flux that lags behind the current, by eddy currents in magnets and sleeves."""


def _late(name: str, found: Reported) -> Iterator[Calibration]:
    x, dx = float(found.value[0]), float(found.sigma[0])
    yield found.entry(name, x, dx, "us", scale=1e6, size=abs(x), late=x > 0)


@dataclass(frozen=True)
class Latency(DriveEffect):
    """The angle is late: ``[omega e^{j theta} (j f - f'(i) j i)]`` times the time."""

    turns, late, rotates = True, True, True

    def plausible(self, value: float, turn: float, period: float) -> bool:  # noqa: D102
        return abs(value) < min(_LONGEST_LATENCY, _MOST_TURNED / turn) * period

    def turned(self, at: Linearized, value: FloatArray) -> FloatArray:  # noqa: D102
        return np.asarray(value[0] * at.windows.speed)

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [between(at.windows.speed * at.tilt)]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield from _late(self.name, found)


@dataclass(frozen=True)
class CurrentLatency(Latency):
    """The currents are late or filtered: ``[u_s - omega e^{j theta} (j f - f'(i) j i)]`` times the time."""

    def turned(self, at: Linearized, value: FloatArray) -> FloatArray:  # noqa: D102
        return -super().turned(at, value)  # the currents belong to an earlier angle

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [between(at.windows.held - at.windows.speed * at.tilt)]  # with the ripple of a held voltage


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
    """A share of the flux lags by a known time, s: ``-[e^{j theta} (f(i) - f(i_lag))]`` times the share."""

    lag: float
    rotates, cause = True, "flux"

    def plausible(self, value: float, _turn: float, _period: float) -> bool:  # noqa: D102
        return 0 <= value < _LARGEST_LAG

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        lagging = at.windows.lagging[..., -1] - at.windows.lagging[..., LAGS.index(self.lag)]
        return [-between(at.turn * (at.leading - at.mean_flux(lagging)))]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry(self.name, found.value[0], found.sigma[0], "1", "flux_lag.share", lag=self.lag)
