"""Tell from their values whether currents are readings of a converter, and where the zero of each phase lies."""

from __future__ import annotations

import numpy as np

from drive_id.inspection.points import PhaseGroup
from drive_id.types import FloatArray

_NEAR_HALF = 0.01
"""Difference of the means from a power of two, by it, up to which that is the zero: half of the converter's range."""
_OFF_ZERO = 0.25
"""Least mean of each phase by its range: over some turns, currents have none."""


def zero_reading(i: PhaseGroup) -> FloatArray:
    """Return the reading of each phase without current (2 or 3,); zeros where the values may be amperes.

    The phase currents of a machine sum to zero, so that they never have means of one sign.
    """
    means = i.values.mean(axis=0)
    size = means * np.sign(means[0])
    if i.group.frame != "abc" or np.any(size <= _OFF_ZERO * np.ptp(i.values, axis=0)):
        return np.zeros(len(means))
    half = 2.0 ** np.rint(np.log2(size.mean()))
    near = is_whole(i) and np.abs(size / half - 1).max() < _NEAR_HALF
    return np.full(len(means), half * np.sign(means[0])) if near else means


def is_whole(i: PhaseGroup) -> bool:
    """Tell whether all values are whole numbers, as counts are, and amperes hardly ever."""
    return bool(np.all(i.values == np.rint(i.values)))
