"""Why the standard error of R does not fall with the number of samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from drive_id.common.messages import Message
from drive_id.types import TINY

if TYPE_CHECKING:  # takes 0.1 s, which methods psm and joint do without
    from drive_id.core.full.fit import Assessment

LARGER = 1.2
"""Ratio of standard errors of R from which on that of more samples is larger: they are known to some 10 %."""
_KEYS = {
    "misfit": "resistance_error.misfit",
    "curve": "resistance_error.curve",
    "noise": "resistance_error.noise",
    "open": "resistance_error.open",
}
"""Statement of each source of the changes."""


def growth(assessment: Assessment, sigma: float, known: tuple[int, float]) -> Message | None:
    """Return why R is less certain than it was from fewer samples; None if it is not.

    Parameters
    ----------
    assessment : Assessment
        Of the present fit.
    sigma : float
        Present standard error of R, ohm.
    known : (int, float)
        Number of samples of an earlier fit, and its standard error of R, ohm.
    """
    samples, before = known
    if not before > 0 or sigma <= LARGER * before:
        return None
    from drive_id.core.full.model import RESISTANCE  # noqa: PLC0415  # takes 0.1 s

    squares, sources = np.square(assessment.changes[RESISTANCE]), np.array(assessment.sources)
    parts = {key: float(squares[sources == name].sum()) for name, key in _KEYS.items()}
    cause = max(parts, key=lambda key: parts[key])
    return Message(cause, sigma=sigma, before=before, samples=samples, share=parts[cause] / max(squares.sum(), TINY))
