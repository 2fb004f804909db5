"""Phases that differ: resistances and inductances, half-bridges, gains of the voltages, and filters of the currents."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import (
    VOLTAGE_MISMATCH,
    Calibration,
    DriveEffect,
    Ends,
    Linearized,
    Recorded,
    Reported,
    between,
)
from drive_id.types import FloatArray


@dataclass(frozen=True)
class PhaseResistance(DriveEffect):
    """R of the phases a and b above the mean, c below it: of ``int i_a``, ``int i_b`` and ``int i_c``."""

    width = 2

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return _above_mean(frames.phases(at.windows.current))

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for phase, x, dx in _of_phases(found):
            name, more = f"resistance_{'abc'[phase]}", {"phase": phase, "resistance": found.resistance}
            yield found.entry(name, x, dx, "ohm", "resistance_of_phase", **more)


@dataclass(frozen=True)
class PhaseInductance(PhaseResistance):
    """Inductance of the phases a and b above the mean, c below it: of ``[i_a]``, ``[i_b]`` and ``[i_c]`` at the ends.

    As turns that are short-circuited, or an eccentric stator, cause.
    """

    price = 0.01  # of a misfit of the map, it explains what phases that differ in R do

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return _above_mean(frames.phases(between(at.currents * at.turn)))

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for phase, x, dx in _of_phases(found):
            yield found.entry(f"inductance_{'abc'[phase]}", x, dx, "H", "inductance_of_phase", phase=phase)


@dataclass(frozen=True)
class UnequalDrops(PhaseResistance):
    """Share of the drop of the phases a and b above the mean, c below it: dead times of the half-bridges differ."""

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return _above_mean(at.drops)

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for phase, x, dx in _of_phases(found):
            yield found.entry(f"inverter_drop_{'abc'[phase]}", x, dx, "1", "drop_of_phase", phase=phase)


@dataclass(frozen=True)
class CurrentFilters(DriveEffect):
    """Time constants of the current filters of the phases a and b above the mean, c below it: read are i - t di/dt.

    The voltage across R by the wrong currents is t times its difference between the ends; that across the inverter,
    half of it: as their zero sequence is left out, the current of a phase crosses zero later by t / 2.
    """

    width = 2
    of_sensors, of_speeds, harmonic = True, True, 2  # at one speed, unequal gains of the currents look alike
    price = 0.01  # of a misfit of the map, it explains some beside cross-talk

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return known.sensors

    def shifts(self, at: Ends) -> list[ComplexArray]:  # noqa: D102
        return [each / at.turn for each in _above_mean(frames.phases(at.turn * at.rate))]

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        across = frames.phases(at.windows.held - at.turn * at.induced)
        across = across + at.fallen.mean(axis=2, keepdims=True) - 0.5 * at.fallen
        read = _above_mean(across[:, 1] - across[:, 0])
        return [column + own for column, own in zip(super().columns(at), read, strict=True)]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for phase, x, dx in _of_phases(found):
            more = {"phase": phase, "size": abs(x), "late": x > 0}
            yield found.entry(f"current_filter_{'abc'[phase]}", x, dx, "us", "filter_of_phase", scale=1e6, **more)


def _above_mean(of_phases: FloatArray) -> list[ComplexArray]:
    """Return the space vectors (...,) of what (..., 3) the phases a and b have, less that of phase c."""
    a, b, c = np.moveaxis(2 / 3 * of_phases * np.exp(1j * frames.PHASE_SHIFTS), -1, 0)
    return [a - c, b - c]


def _of_phases(found: Reported) -> Iterator[tuple[int, float, float]]:
    values, sigmas = (*found.value, -found.value.sum()), (*found.sigma, np.hypot(*found.sigma))
    for phase, (x, dx) in enumerate(zip(values, sigmas, strict=True)):
        yield phase, float(x), float(dx)


@dataclass(frozen=True)
class DropAsymmetry(DriveEffect):
    """By how much the drop of each phase is larger for positive, and smaller for negative current.

    Upper and lower devices of a half-bridge differ in their thresholds, of ``int abs(drop(i_a))`` and so on, and in
    their resistances, ohm, of ``int abs(i_a)``.
    """

    width = 6

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        axes = 2 / 3 * np.exp(1j * frames.PHASE_SHIFTS)
        return [*(at.rectified * axes).T, *(at.windows.rectified[:, -1] * axes).T]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        forms = np.concatenate([found.drop * np.eye(3), found.i_max * np.eye(3)])  # at i_max
        for phase, (x, dx) in enumerate(zip(found.value @ forms, found.sigma_of(forms), strict=True)):
            yield found.entry(f"drop_asymmetry_{'abc'[phase]}", x, dx, "V", self.name, phase=phase)


@dataclass(frozen=True)
class VoltageGains(DriveEffect):
    """Mismatch g of the voltages' gains, complex, the voltage being u + g conj(u): ``-conj(int u_s)``.

    A phase k with the gain 1 + e has g = -e/3 e^{2j phi_k}.
    """

    width = 2

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [-at.windows.voltage.conj(), -1j * at.windows.voltage.conj()]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        g = complex(*found.value)
        along = np.real(g * np.exp(-2j * frames.PHASE_SHIFTS))
        phase = int(np.argmax(np.abs(along)))
        sigma = float(np.linalg.norm(found.sigma))
        yield found.entry(VOLTAGE_MISMATCH, abs(g), sigma, "1", phase=phase, off=-3 * along[phase])
