"""Heat of winding and magnets, within a recording, and from one part of the data to the next."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from drive_id.common.temperature import COPPER
from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import (
    CERTAIN,
    MOST_PARTS,
    Calibration,
    DriveEffect,
    Fitted,
    Linearized,
    Recorded,
    Reported,
    between,
)
from drive_id.types import TINY, FloatArray

_MOST_COOLED, _MOST_WARMED = -50.0, 130.0
"""Change of a winding's temperature since the first part of the data, K, beyond which another cause is likelier: class
F allows 105 K above the ambience (IEC 60034-1), and benches record cold machines first. A map that lacks 2 % of
reciprocity looked like -69 K."""
_COPPER = "copper_heating"
_MAGNET_LOSS = 1.2e-3
"""Share of their flux that magnets lose, 1/K: 0.11 to 0.12 % of NdFeB, 0.2 % of ferrites, which are warmed less."""


@dataclass(frozen=True)
class CopperHeating(DriveEffect):
    """Rise of R over a recording: ``int i_s h dt``, h being the winding's temperature, see ``winding_heat.py``.

    Where the winding settles, its time constant and the stator that warms around it more slowly have columns, too: what
    the data leave open of them, they leave open of R.
    """

    width = 3
    at_rest, of_recordings, attuned = True, True, True

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [at.windows.current * course for course in at.warmth]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        x, dx = float(found.value[0]), float(found.sigma[0])
        key, told, falls = "", _relative(found, x), x < -CERTAIN * dx
        if falls:
            key = "resistance_rise.falls"
        elif np.isfinite(found.time_constant):
            key, told = "resistance_rise.settling", {**told, "constant": found.time_constant}
        entry = found.entry("resistance_rise", x, dx, "ohm", key, **told)
        yield replace(entry, doubtful=True) if falls else entry


@dataclass(frozen=True)
class CopperRecordings(DriveEffect):
    """R of each part of the data minus that of the first: ``int i_s``."""

    width = MOST_PARTS - 1
    at_rest, of_recordings, cause = True, True, "resistance"
    price_of_part = 2e-3  # what a resistance that rises with the speed explains is that

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return 1 < known.parts <= MOST_PARTS and not known.temperatures

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [at.windows.current * own for own in at.of_parts()]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for number, part, x, dx in found.of_parts():
            name, told = f"resistance_change_{number}", _relative(found, x)
            odd = not _MOST_COOLED < told["kelvin"] < _MOST_WARMED
            key = "resistance_change.odd" if odd else "resistance_change"
            entry = found.entry(name, x, dx, "ohm", key, **part, **told)
            yield replace(entry, doubtful=True) if odd else entry


def _relative(found: Reported, x: float) -> dict[str, float]:
    change = x / found.resistance
    return {"change": change, "kelvin": change / COPPER, "resistance": found.resistance}


@dataclass(frozen=True)
class MagnetHeating(DriveEffect):
    """Change over a recording of psi_d and of the current that stands for the magnet, with the heat.

    Columns ``h [e^{j theta}]`` and ``h [e^{j theta} f'(i)]``.
    """

    width, of_recordings, cause = 2, True, "magnet"

    def expected(self, fit: Fitted) -> float:
        """As much as magnets lose that are as warm as the winding: so they are at most."""
        rise = fit.values[_COPPER][0] if _COPPER in fit.values else 0.0
        return float(_MAGNET_LOSS * abs(rise) / max(fit.resistance, TINY) / COPPER * fit.magnet)

    def course(self, at: Linearized) -> FloatArray:
        """Return the relative change (N,) over the recording."""
        return at.heat

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [column * self.course(at) for column in _of_magnet(at)]

    def magnetizing(self, at: Linearized, value: FloatArray) -> FloatArray:  # noqa: D102
        return np.asarray(value[1] * self.course(at)[:, None])

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for _, x, dx in _magnet_changes(found):
            yield found.entry("magnet_flux_change", x, dx, "Wb", flux=found.inductance * found.i_max)


@dataclass(frozen=True)
class LateMagnetHeating(MagnetHeating):
    """The same with the square of the heat, as of magnets that the copper warms."""

    def expected(self, _: Fitted) -> float:  # noqa: D102
        return 0.0

    def course(self, at: Linearized) -> FloatArray:  # noqa: D102
        return at.heat**2

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for entry in super().report(found):
            yield replace(entry, name="magnet_flux_change_late")


@dataclass(frozen=True)
class MagnetRecordings(MagnetHeating):
    """Change of psi_d and of that current in each part of the data minus that of the first."""

    width = 2 * (MOST_PARTS - 1)

    def expected(self, _: Fitted) -> float:  # noqa: D102
        return 0.0

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return 1 < known.parts <= MOST_PARTS and not known.temperatures

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [column * own for own in at.of_parts() for column in _of_magnet(at)]

    def magnetizing(self, at: Linearized, value: FloatArray) -> FloatArray:  # noqa: D102
        return np.asarray(value[1::2] @ np.array(at.of_parts(), np.float64))[:, None]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for k, x, dx in _magnet_changes(found):
            name, key = f"magnet_flux_change_{k + 2}", "magnet_flux_change.recording"
            yield found.entry(name, x, dx, "Wb", key, **found.parts[k + 1], flux=found.inductance * found.i_max)


def _of_magnet(at: Linearized) -> list[ComplexArray]:
    return [between(at.turn), between(at.turn * at.through(np.ones_like(at.turn)))]


def _magnet_changes(found: Reported) -> Iterator[tuple[int, float, float]]:
    """Yield the changes of psi_d at zero current, by flux and by the current of the magnet: number, value and error."""
    forms = np.asarray(np.kron(np.eye(len(found.value) // 2), [[1.0], [found.inductance]]), np.float64)
    for k, (x, dx) in enumerate(zip(forms.T @ found.value, found.sigma_of(forms), strict=True)):
        if found.met(2 * k):
            yield k, x, dx
