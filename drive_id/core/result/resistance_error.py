"""Why the standard error of R does not fall with the number of samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from drive_id.common.messages import Message
from drive_id.types import FloatArray

if TYPE_CHECKING:  # takes 0.1 s, which methods psm and joint do without
    from drive_id.core.full.fit import Assessment

LARGER = 1.2
"""Ratio of standard errors of R from which on that of more samples is larger: they are known to some 10 %."""
_BIASES = 4
"""Columns of the changes between those by batches of time and those by lack of fit."""


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

    changes = assessment.changes[RESISTANCE]
    fit = assessment.misfit.changes.shape[1]
    noise, misfit, curve = np.split(changes, [len(changes) - 1 - fit, len(changes) - 1])
    parts = {
        "resistance_error.misfit": _square(misfit),
        "resistance_error.curve": _square(curve),
        "resistance_error.noise": _square(noise[:-_BIASES]),
    }
    cause = max(parts, key=lambda name: parts[name])
    share = parts[cause] / max(_square(changes), np.finfo(np.float64).tiny)
    return Message(cause, sigma=sigma, before=before, samples=samples, share=share)


def _square(changes: FloatArray) -> float:
    return float(np.sum(changes**2))
