"""Sums over samples that take no temporary arrays: rests near zero current, bends of the current."""

from __future__ import annotations

import math

from drive_id.core import vectorized
from drive_id.core.compiled import compiled_or
from drive_id.types import BoolArray, FloatArray


@compiled_or(vectorized.mark_rests)
def mark_rests(i_dq: FloatArray, least: float, period: float, longest: float, rest: int, idle: BoolArray) -> int:
    """Mark in ``idle`` (N,) the samples that come after a longer rest than allowed.

    Parameters
    ----------
    i_dq : (N, 2) float
        Of one run, A.
    least : float
        Amplitude below which the current rests, A.
    period, longest : float
        Sample period, and how long a rest may last, s.
    rest : int
        Samples of rest before these.
    idle : (N,) bool

    Returns
    -------
    int
        Samples of rest at the end.
    """
    for k in range(len(i_dq)):
        rest = rest + 1 if math.hypot(i_dq[k, 0], i_dq[k, 1]) < least else 0
        idle[k] = rest * period > longest
    return rest


@compiled_or(vectorized.bend_square)
def bend_square(i_dq: FloatArray) -> float:
    """Return the sum of the squared second differences of the currents (N, 2) of one run, A^2."""
    total = 0.0
    for k in range(2, len(i_dq)):
        for axis in range(2):
            bend = i_dq[k, axis] - 2.0 * i_dq[k - 1, axis] + i_dq[k - 2, axis]
            total += bend * bend
    return total
