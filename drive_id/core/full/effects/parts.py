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
class AngleOfParts(DriveEffect):
    """Offset of the angle in each part of the data minus that in the first, as of an encoder without an index."""

    width = MOST_PARTS - 1
    of_recordings, cause = True, "angle"  # with one speed in each, a late angle is among them
    price, price_of_part = 0.01, 2e-3

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return 1 < known.parts <= MOST_PARTS

    def waves(self, at: Ends) -> list[FloatArray]:  # noqa: D102
        return [np.repeat(own[:, None], 2, axis=1).astype(np.float64) for own in at.of_parts()]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for k, (x, dx) in enumerate(zip(found.value, found.sigma, strict=True)):
            if found.met(k):
                yield found.entry(
                    f"angle_offset_change_{k + 2}", -x, dx, "rad", "angle_offset_change", **found.parts[k + 1]
                )


@dataclass(frozen=True)
class UnlikeParts(DriveEffect):
    """psi_d, psi_q and the inverter's drop of each part, relative to those of the first: another drive.

    Columns ``[e^{j theta} f_d]``, ``[e^{j theta} j f_q]`` and the integral of the drop.
    """

    width = 3 * (MOST_PARTS - 1)
    of_recordings = True
    price, price_of_part = 0.04, 6e-3

    def possible(self, known: Recorded) -> bool:  # noqa: D102
        return 1 < known.parts <= MOST_PARTS

    def columns(self, at: Linearized) -> list[ComplexArray]:  # noqa: D102
        flux = [between(at.turn * psi) for psi in (at.psi.real, 1j * at.psi.imag)]
        return [column * own for own in at.of_parts() for column in (*flux, at.drop)]

    def report(self, found: Reported) -> Iterator[Calibration]:  # noqa: D102
        for k, part in enumerate(found.parts[1:]):
            if not found.met(3 * k):
                continue
            (d, q, drop), errors = found.value[3 * k : 3 * k + 3], found.sigma[3 * k : 3 * k + 3]
            told = part | dict(zip(("sigma_d", "sigma_q", "sigma_drop"), errors, strict=True))
            for name, x, dx in zip(("psi_d", "psi_q", "inverter_drop"), (d, q, drop), errors, strict=True):
                entry = found.entry(f"{name}_change_{k + 2}", x, dx, "1", "unlike_parts", **told, d=d, q=q, drop=drop)
                yield replace(entry, doubtful=True)
