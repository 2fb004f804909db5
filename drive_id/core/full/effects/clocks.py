"""Signals that were logged by clocks of their own, one of which runs faster than the others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drive_id.common.messages import Message
from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import Calibration, DriveEffect, Ends, Linearized, Reported
from drive_id.core.full.windows import held_shares
from drive_id.types import FloatArray

_LEAST, _MOST = 1e-6, 2e-4
"""By which clocks of their own differ: crystals keep within 100 ppm each, and hardly ever agree to 1. Magnets that warm
looked like 0.12 ppm, a sensor's gain that rises like 0.55, and what they may be instead is told less surely then."""


@dataclass(frozen=True)
class FastClock(DriveEffect):
    """The stamps of a signal grow too fast, so that it is late by x t, with the time t since the recording's middle.

    Late voltages are ``-[u_s]`` times the lateness, a late angle is omega times the tilt times it, and late currents
    are as both that are early: ``voltages`` and ``angle`` tell by how much each is late, per lateness of the signal.
    """

    signal: str
    voltages: float
    angle: float
    of_recordings, of_recorded_runs = True, True

    def plausible(self, value: FloatArray, _turn: float, _period: float) -> bool:  # noqa: D102
        return bool(_LEAST < abs(value[0]) < _MOST)

    def waves(self, at: Ends) -> list[FloatArray]:  # noqa: D102
        return [self.angle * at.windows.speed * at.elapsed[:, None]] if self.angle else []

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        by_angle = super().columns(at)[0] if self.angle else 0.0
        return [by_angle - self.voltages * at.elapsed * at.step]

    def beyond(self, at: Linearized, value: FloatArray) -> ComplexArray:  # noqa: D102
        if not self.voltages:
            return super().beyond(at, value)
        late = self.voltages * value[0] * at.elapsed
        taken = held_shares(at.delay - (late / at.windows.period)[:, None]) - held_shares(at.delay)
        exact = np.sum(taken * at.windows.shifted, axis=1)
        return np.asarray(exact + late * at.step)

    def refused(self, value: FloatArray, half: float, reach: float) -> Message | None:  # noqa: D102
        late = abs(float(value[0])) * half
        return Message("fast_clock.far", **self._told(float(value[0]))) if late > reach else None

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        value, sigma = float(found.value[0]), float(found.sigma[0])
        told = self._told(value) | {"sigma_ppm": 1e6 * sigma}
        yield replace(found.entry(self.name, value, sigma, "ppm", "fast_clock", scale=1e6, **told), doubtful=True)

    def _told(self, value: float) -> dict[str, Any]:
        return {"signal": self.signal, "fast": value > 0, "factor": 1 / (1 + value), "ppm": 1e6 * abs(value)}
