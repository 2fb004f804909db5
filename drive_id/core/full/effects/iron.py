"""Iron loss: a current along the induced voltage, which the flux lacks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import Calibration, DriveEffect, Ends, Reported
from drive_id.types import TINY

_SLOWEST = 1.0
"""Speed below which hysteresis cannot be distinguished from noise, rad/s."""


@dataclass(frozen=True)
class OfIron(DriveEffect):
    """A current along the induced voltage: columns ``-[e^{j theta} f'(i) e]``, weighted."""

    reported: str
    unit: str
    turns, positive, cause = True, True, "iron_loss"

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry(self.reported, found.value[0], found.sigma[0], self.unit)


@dataclass(frozen=True)
class EddyCurrents(OfIron):
    """A conductance parallel to the induced voltage."""

    def shifts(self, at: Ends) -> list[ComplexArray]:  # noqa: D102
        return [-at.induced]


@dataclass(frozen=True)
class Hysteresis(OfIron):
    """A conductance that falls with the speed: the loss per turn is constant."""

    price = 1e-3  # where speeds hardly differ, it is iron loss

    def shifts(self, at: Ends) -> list[ComplexArray]:  # noqa: D102
        speed = np.abs(at.windows.speed)
        return [-at.induced / np.where(speed < _SLOWEST, np.inf, speed)]


@dataclass(frozen=True)
class Coercivity(OfIron):
    """A current of constant size along the induced voltage."""

    def shifts(self, at: Ends) -> list[ComplexArray]:  # noqa: D102
        return [-at.induced / np.maximum(np.abs(at.induced), TINY)]
