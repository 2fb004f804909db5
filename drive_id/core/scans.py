"""Questions about whole arrays, answered without a temporary array of their size."""

from __future__ import annotations

import numpy as np

from drive_id.core.compiled import compiled_or
from drive_id.types import FloatArray, IntArray


def _rising(stamp: IntArray) -> bool:
    return bool((stamp[1:] > stamp[:-1]).all())


def _apart(clock: IntArray, stamp: IntArray, shift: int) -> bool:
    return bool((stamp[: len(clock)] - clock == shift).all())


def all_finite(values: FloatArray) -> bool:
    """Tell whether all values are finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = values.sum()  # of finite values it is finite, unless they are absurd
    return bool(np.isfinite(total) or np.isfinite(values).all())


@compiled_or(_rising)
def rising(stamp: IntArray) -> bool:
    """Tell whether each stamp (N,) exceeds the one before."""
    falls = 0
    for k in range(1, len(stamp)):
        falls += stamp[k] <= stamp[k - 1]
    return falls == 0


@compiled_or(_apart)
def apart(clock: IntArray, stamp: IntArray, shift: int) -> bool:
    """Tell whether the first stamps (M,) lie ``shift`` behind the entries of the clock (N,), one by one."""
    others = 0
    for k in range(len(clock)):
        others += stamp[k] - clock[k] != shift
    return others == 0
