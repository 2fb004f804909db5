"""An angle of coarse resolution, such as encoder counts, smoothed over its own motion."""

from __future__ import annotations

import itertools

import numpy as np

from drive_id.core.signals.signal import Signal
from drive_id.types import FloatArray

_FEWEST = 5  # samples to which parabolas are fitted


def smoothed_rotor(rotor: Signal, duration: float) -> tuple[Signal, float]:
    """Replace angle and speed by those of parabolas, fitted at each sample to the samples around it.

    The steps of a coarse angle average out; a change of acceleration within ``duration``, s, is lost. Gaps are not
    smoothed across; stretches shorter than the window stay as they are.

    Takes (N, 2) values, angle in rad and speed in rad/s, or (N, 1), the angle. Returns (N, 2) values, the angle not
    wrapped, and the root mean square change of the angle, rad.
    """
    order = np.argsort(rotor.stamp, kind="stable")
    stamp, values = rotor.stamp[order], rotor.values[order]
    steps = np.diff(stamp)
    period = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    if not period:
        return rotor, 0.0
    half = max(round(0.5e9 * duration / period), 1)
    starts = [0, *(np.flatnonzero((steps > 1.5 * period) | (steps <= 0)) + 1).tolist(), len(stamp)]
    angle = np.empty(len(stamp))
    speed = np.empty(len(stamp))
    square = 0.0
    for start, stop in itertools.pairwise(starts):
        raw = np.unwrap(values[start:stop, 0])
        angle[start:stop], speed[start:stop] = _parabolas(raw, half, period * 1e-9)
        square += float(np.sum((angle[start:stop] - raw) ** 2))
    found = Signal(
        rotor.name, stamp, np.column_stack([angle, speed]), rotor.sample_period, None, rotor.lost, rotor.losses
    )
    return found, float(np.sqrt(square / len(stamp)))


def _parabolas(x: FloatArray, half: int, period: float) -> tuple[FloatArray, FloatArray]:
    """Return value and slope of the parabola around each of equally spaced samples (N,)."""
    if len(x) < max(2 * half + 1, _FEWEST):
        return x, np.gradient(x, period) if len(x) > 1 else np.zeros(len(x))
    from scipy.signal import savgol_filter  # noqa: PLC0415  # few logs have a coarse angle

    value, slope = (savgol_filter(x, 2 * half + 1, 2, deriv=order, delta=period) for order in (0, 1))
    return value, slope
