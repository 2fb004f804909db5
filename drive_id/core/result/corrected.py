"""Recordings as they would be without the sensor faults that were found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from drive_id.types import Samples

if TYPE_CHECKING:
    from drive_id.core.full.calibration import Calibration


def corrected_pieces(pieces: Sequence[Samples], calibrations: Sequence[Calibration]) -> Sequence[Samples]:
    """Return the pieces corrected for the faults that are applied; the same pieces if none was looked for."""
    if not calibrations:
        return pieces
    from drive_id.core.full.calibration import corrected  # noqa: PLC0415  # takes 0.1 s

    return [corrected(piece, calibrations) for piece in pieces]
