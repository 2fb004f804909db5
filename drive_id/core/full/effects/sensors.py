"""Faults of the current sensors: the currents of the map are others than those that are read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import Calibration, DriveEffect, Ends, Linearized, Recorded, Reported


@dataclass(frozen=True)
class OfSensors(DriveEffect):
    """Its columns hold the voltage across R and the inverter by the wrong current as well.

    ``read`` are the rows of :attr:`Linearized.dropped` with that voltage.
    """

    unit: str
    read: slice
    of_sensors = True

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return known.sensors

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [column - read for column, read in zip(super().columns(at), at.dropped[self.read], strict=True)]


@dataclass(frozen=True)
class CurrentRotation(OfSensors):
    """Cross-talk a: the currents read are i (1 + j a)."""

    rotates, beside = True, "current_gains"  # sensors that turn the currents have unequal gains as well

    def shifts(self, at: Ends) -> list[ComplexArray]:  # noqa: D102
        return [-1j * at.currents]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        yield found.entry(self.name, found.value[0], found.sigma[0], self.unit)


@dataclass(frozen=True)
class OfAxes(OfSensors):
    """A complex fault, by the axes alpha and beta."""

    reported: str
    width = 2

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        size = found.i_max if self.unit == "A" else 1.0
        for axis, x, dx in zip(("alpha", "beta"), found.value, found.sigma, strict=True):
            name, key = f"{self.reported}_{axis}", f"{self.reported}.fit"
            yield found.entry(name, x, dx, self.unit, key, axis=axis, share=abs(x) / size)


@dataclass(frozen=True)
class CurrentGains(OfAxes):
    """Mismatch g of the gains: the currents read are i + g conj(i)."""

    harmonic = 2

    def shifts(self, at: Ends) -> list[ComplexArray]:  # noqa: D102
        mirrored = (at.currents * at.turn).conj() / at.turn
        return [-mirrored, -1j * mirrored]


@dataclass(frozen=True)
class CurrentOffset(OfAxes):
    """Offset o: the currents read are i + o."""

    harmonic = 1

    def shifts(self, at: Ends) -> list[ComplexArray]:  # noqa: D102
        return [-at.turn.conj(), -1j * at.turn.conj()]
