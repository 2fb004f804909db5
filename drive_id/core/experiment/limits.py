"""Limits of the current references: amplitude (the current disc) and slew rate."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drive_id.core.signals.signal import finite_rows
from drive_id.types import FloatArray

_LARGEST = 1e100  # A; differences of larger values overflow
_MARGIN = 4 * float(np.finfo(np.float32).eps)
"""Relative distance from the rim that keeps the amplitude inside when it is computed in float32, too."""


def inside_disc(i_dq: FloatArray, i_max: float) -> NDArray[np.float32]:
    """Round references to float32 within the disc.

    Parameters
    ----------
    i_dq : (N, 2) float
        A; values that are not finite become zero, those outside are scaled to the rim.
    i_max : float
        Radius of the disc, A.

    Returns
    -------
    (N, 2) float32
        hypot(d, q) <= i_max, exactly and in float32.
    """
    wanted = np.where(finite_rows(i_dq)[:, None], i_dq, 0.0)
    with np.errstate(over="ignore"):
        radius = np.hypot(wanted[:, 0], wanted[:, 1])
    scale = np.minimum(1.0, i_max * (1 - _MARGIN) / np.maximum(radius, 1e-300))
    wanted = wanted * scale[:, None]
    single = wanted.astype(np.float32)
    outward = np.abs(single.astype(np.float64)) > np.abs(wanted)
    single[outward] = np.nextafter(single[outward], np.float32(0))
    return single


def follow(start: FloatArray, targets: FloatArray, step: float) -> FloatArray:
    """Follow targets with limited steps.

    Parameters
    ----------
    start : (2,) float
        Reference before the first target, A.
    targets : (N, 2) float
        A; values that are not finite count as zero.
    step : float
        Largest distance from one reference to the next, A.

    Returns
    -------
    (N, 2) float
        The targets where they are within reach, else a step towards them, which stays in any disc that holds both.
    """
    targets = np.clip(np.where(finite_rows(targets)[:, None], targets, 0.0), -_LARGEST, _LARGEST)
    steps = np.diff(targets, axis=0, prepend=start[None, :])
    if np.all(np.hypot(steps[:, 0], steps[:, 1]) <= step * (1 + 1e-9)):
        return targets
    d, q = float(start[0]), float(start[1])
    out = np.empty_like(targets)
    for k, (target_d, target_q) in enumerate(targets.tolist()):
        distance = math.hypot(target_d - d, target_q - q)
        share = 1.0 if distance <= step else step / distance
        d += share * (target_d - d)
        q += share * (target_q - q)
        out[k] = d, q
    return out


def approach(start: FloatArray, end: FloatArray, step: float, count: int) -> FloatArray:
    """Go straight to a point with limited steps.

    Parameters
    ----------
    start, end : (2,) float
        A; ``start`` itself is not repeated.
    step : float
        Distance from one reference to the next, A.
    count : int
        Most references to return.

    Returns
    -------
    (K, 2) float
        K <= count; if fewer, the last is ``end``.
    """
    distance = math.hypot(*(end - start))
    needed = math.ceil(distance / step * (1 - 1e-12)) if distance > 0 else 0
    share = np.arange(1, min(needed, count) + 1) * (step / distance) if needed else np.zeros(0)
    points = start + np.minimum(share, 1.0)[:, None] * (end - start)
    if 0 < needed <= count:
        points[-1] = end
    return points
