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
    """Mark in ``idle`` (N,) the samples after longer rests at zero current than allowed.

    Parameters
    ----------
    i_dq : (N, 2) float
        Currents of one run, A.
    least : float
        Amplitude below which the current counts as zero, A.
    period, longest : float
        Sample period and longest rest allowed, s.
    rest : int
        Preceding samples of rest.
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
