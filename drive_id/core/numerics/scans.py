"""Single passes over long arrays without temporaries: order and rests."""

from __future__ import annotations

import math

import numpy as np

from drive_id.core.numerics.compiled import compiled
from drive_id.types import BoolArray, FloatArray, IntArray


def all_finite(values: FloatArray) -> bool:
    """Tell whether all values are finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = values.sum()  # finite for finite values, unless they overflow
    return bool(np.isfinite(total) or np.isfinite(values).all())


@compiled("const i8[::1]")
def rising(stamp: IntArray) -> bool:
    """Tell whether the stamps (N,) are strictly increasing."""
    falls = 0
    for k in range(1, len(stamp)):
        falls += stamp[k] <= stamp[k - 1]
    return falls == 0


@compiled("const f8[:, ::1], f8, f8, f8, i8, b1[::1]")
def mark_rests(i_dq: FloatArray, least: float, period: float, longest: float, rest: int, idle: BoolArray) -> int:
    """Mark in ``idle`` (N,) the samples after too long rests at zero current; return the samples of rest at the end.

    Takes the currents (N, 2) of one run, A, the amplitude below which they count as zero, A, the sample period and the
    longest rest allowed, s, and how many samples of rest precede.
    """
    for k in range(len(i_dq)):
        rest = rest + 1 if math.hypot(i_dq[k, 0], i_dq[k, 1]) < least else 0
        idle[k] = rest * period > longest
    return rest
