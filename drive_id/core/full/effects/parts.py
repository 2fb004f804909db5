"""What differs from one part of the data to the next: parts are recordings, and sections of one between pauses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.effect import (
    MOST_PARTS,
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
class OfParts(DriveEffect):
    """What each part but the first has of its own, relative to that."""

    width = MOST_PARTS - 1
    of_recordings, price_of_part = True, 2e-3

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return 1 < known.parts <= MOST_PARTS


@dataclass(frozen=True)
class AngleOfParts(OfParts):
    """Offset of the angle, as of an encoder without an index."""

    cause = "angle"  # with one speed in each, a late angle is among them
    price = 0.01

    def waves(self, at: Ends) -> list[FloatArray]:  # noqa: D102
        return [np.repeat(own[:, None], 2, axis=1).astype(np.float64) for own in at.of_parts()]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for number, part, x, dx in found.of_parts():
            yield found.entry(f"angle_offset_change_{number}", -x, dx, "rad", "angle_offset_change", **part)


@dataclass(frozen=True)
class DropOfParts(OfParts):
    """Inverter's drop, relative: another DC link, or other devices."""

    at_rest = True

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        return [at.drop * own for own in at.of_parts()]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for number, part, x, dx in found.of_parts():
            yield found.entry(f"inverter_drop_change_{number}", x, dx, "1", "inverter_drop_change", **part)


@dataclass(frozen=True)
class UnlikeParts(OfParts):
    """psi_d and psi_q, relative: another machine.

    Columns ``[e^{j theta} f_d]`` and ``[e^{j theta} j f_q]``.
    """

    width = 2 * (MOST_PARTS - 1)
    price, price_of_part = 0.03, 4e-3  # it explains what all others do

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        flux = [between(at.turn * psi) for psi in (at.psi.real, 1j * at.psi.imag)]
        return [column * own for own in at.of_parts() for column in flux]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for k, part in enumerate(found.parts[1:]):
            if not found.met(2 * k):
                continue
            (d, q), errors = found.value[2 * k : 2 * k + 2], found.sigma[2 * k : 2 * k + 2]
            told = part | {"d": d, "q": q, "sigma_d": errors[0], "sigma_q": errors[1]}
            for name, x, dx in zip(("psi_d", "psi_q"), (d, q), errors, strict=True):
                entry = found.entry(f"{name}_change_{k + 2}", x, dx, "1", "unlike_parts", **told)
                yield replace(entry, doubtful=True)
