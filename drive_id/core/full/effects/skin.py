"""A resistance that rises with the frequency of the currents: skin and proximity effect of the winding."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import Calibration, DriveEffect, Linearized, Reported

_UNIT = 1000.0
"""Electrical speed, rad/s, at which its unknown is the rise of R, so that it is of the size of R."""


@dataclass(frozen=True)
class SkinEffect(DriveEffect):
    """Rise of R with the square of the electrical speed: ``int i_s`` times that square.

    Below the frequency at which the conductors are two skin depths high, that is what the loss in them does (Dowell
    1966). R is then that at standstill.
    """

    positive, of_speeds = True, True
    cause = "resistance"  # one speed per recording shows R of each, whatever causes it
    price = 1e-3  # what heat explains as well is heat

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [at.windows.current * (at.windows.speed.mean(axis=1) / _UNIT) ** 2]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        value, sigma, turns = found.value[0] / _UNIT**2, found.sigma[0] / _UNIT**2, found.fastest**2
        told = {"rise": value * turns, "error": sigma * turns, "change": value * turns / found.resistance}
        told |= {"speed": found.fastest, "resistance": found.resistance}
        yield found.entry("resistance_by_speed", value, sigma, "ohm s^2/rad^2", **told)
