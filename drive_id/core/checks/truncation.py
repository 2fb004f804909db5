"""Readings that were cut off to multiples of a step, as by a conversion to integers, and not rounded.

Such a reading lies half a step nearer to zero than what was read, on average, and that has the shape of a voltage drop.
The level at zero tells it from rounding: it takes what lies within a whole step to both sides, twice as much as others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.numerics.largest import USUAL_QUANTILE
from drive_id.types import FloatArray, Samples

_ZERO = 1e-6
"""Of the largest reading, below which one is zero: float32, and the rotation of dq readings to phases and back."""
_APART = 0.02
"""Of a step, by which readings may lie off its multiples, as far as digits of a log go."""
_LEAST_SHIFT = 1e-3
"""Mean shift by the amplitude, from which on it matters."""
_FEWEST = 100
"""Readings at the levels beside zero, so that as many at zero are certain, and not half as many."""
_EVEN = 1.25
"""Largest ratio of the readings at zero to those at the two levels beside it, and of these to those at the next two: a
signal that rests at zero, or passes it slowly, says nothing. Rounded, half as many are at zero."""


def truncation_findings(runs: Sequence[Samples]) -> Iterator[Message]:
    """Yield currents or voltages that were cut off, of phases or in the rotor frame, from excerpts of one run each."""
    angle = np.concatenate([run.angle for run in runs])
    for name, unit in (("current", "A"), ("voltage", "V")):
        x_abc = np.concatenate([run.i_abc if name == "current" else run.u_abc for run in runs])
        x_dq = frames.to_dq(x_abc, angle)
        size = np.hypot(*x_dq.T)
        amplitude = float(np.quantile(size, USUAL_QUANTILE))
        moving = size > _ZERO * amplitude
        for x, bias in ((x_abc, 4 / np.pi), (x_dq, 1.0)):
            if step := _step(x[moving].ravel(), _LEAST_SHIFT * amplitude / bias):
                yield Message("truncated", signal=name, step=step, unit=unit, share=0.5 * step * bias / amplitude)
                break


def _step(x: FloatArray, least: float) -> float:
    """Return the step to multiples of which readings (N,) are cut off; 0 where half of it is below ``least``."""
    size = np.abs(x)
    beside = size[size > _ZERO * float(size.max(initial=0.0))]
    step = float(beside.min(initial=np.inf))
    if not 2 * least < step < np.inf:
        return 0.0
    levels = np.rint(size / step)
    if np.abs(size / step - levels).max() > _APART:
        return 0.0
    zero, first, second = (np.count_nonzero(levels == level) for level in range(3))
    even = max(zero, first, second) < _EVEN * min(zero, first, second)
    return step if even and first > _FEWEST else 0.0
