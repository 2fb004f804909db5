"""Errors of the resolver over a turn, and an eccentric rotor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import (
    MOST_RUNS,
    Calibration,
    DriveEffect,
    Ends,
    Linearized,
    Recorded,
    Reported,
    between,
)
from drive_id.core.full.windows import Windows
from drive_id.types import FloatArray


def mechanical_waves(windows: Windows, pole_pairs: float) -> tuple[FloatArray, FloatArray]:
    """Return cosine and sine (N, 2) of the mechanical angle."""
    mechanical = windows.turned / pole_pairs
    return np.cos(mechanical), np.sin(mechanical)


@dataclass(frozen=True)
class ResolverOrder(DriveEffect):
    """Error of the angle: cosine and sine of a multiple of the electrical angle."""

    order: int
    width = 2

    def waves(self, at: Ends) -> list[FloatArray]:  # noqa: D102
        return [f(self.order * at.windows.angle) for f in (np.cos, np.sin)]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry(self.name, *found.amplitude, "rad", pole_pairs=found.pole_pairs)


@dataclass(frozen=True)
class Eccentricity(DriveEffect):
    """Error of the angle: cosine and sine of a multiple of the mechanical angle, in each run."""

    order: int = 1
    width, of_recordings = 2 * MOST_RUNS, True
    price = 2e-3  # what a late angle explains as well, where the speed swings, is that

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return known.runs <= MOST_RUNS

    def waves(self, at: Ends) -> list[FloatArray]:  # noqa: D102
        turns = (at.pole_pairs or 0) / self.order  # one electrical turn has the orders of the resolver
        return at.in_runs(mechanical_waves(at.windows, turns)) if turns > 1 else []

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        name = "resolver_eccentricity" if self.order == 1 else "resolver_second_mechanical"
        yield found.entry(name, *found.amplitude, "rad", pole_pairs=found.pole_pairs)


@dataclass(frozen=True)
class EccentricRotor(Eccentricity):
    """A share of the flux that varies with the mechanical angle: ``[e^{j theta} cos f]`` and the same with the sine."""

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        # such a flux looks like a map where the trajectory repeats at the same rate: the pole pairs must be known
        return known.runs <= MOST_RUNS and known.pole_pairs

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [between(at.turn * at.psi * wave) for wave in super().waves(at)]

    def waves(self, _: Ends) -> list[FloatArray]:  # noqa: D102
        return []

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry("rotor_eccentricity", *found.amplitude, "1", pole_pairs=found.pole_pairs)
