"""Axes of exported tables: chosen by the user, through zero."""

from __future__ import annotations

import math

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray

_MOST_POINTS = 2001  # of an axis: tables of both fluxes then take 64 MB
_HALF = 20  # steps from zero to i_max


def equal_steps(count: int, low: float, high: float) -> FloatArray:
    """Return equally spaced points from ``low`` to ``high``, A, one of which is exactly zero.

    Raises ConfigurationError when zero is not among them.
    """
    if not 4 <= count <= _MOST_POINTS:
        raise ConfigurationError(f"--grid is {count}: choose 4 to {_MOST_POINTS} points.")
    if not (math.isfinite(low) and math.isfinite(high) and low <= 0 <= high and low < high):
        raise ConfigurationError(f"--range is {low:g} to {high:g} A: it must be finite, increase and contain 0.")
    if not _has_zero(count, low, high):
        fitting = [n for n in range(max(4, count - 20), count + 21) if _has_zero(n, low, high)]
        nearest = min(fitting, key=lambda n: (abs(n - count), -n), default=None)
        remedy = "another range" if nearest is None else f"--grid {nearest}"
        raise ConfigurationError(f"{count} points from {low:g} to {high:g} A do not contain 0: choose {remedy}.")
    return clean(low + (high - low) / (count - 1) * np.arange(count, dtype=np.float64))


def _has_zero(count: int, low: float, high: float) -> bool:
    zero = -low * (count - 1) / (high - low)
    return abs(zero - round(zero)) <= 1e-6


def listed(text: str, name: str) -> FloatArray:
    """Return the axis that ``-300,-200,0`` or ``-300:20:0`` (first, step, last) lists, A.

    Raises ConfigurationError when it is no such list, does not increase strictly, or does not contain 0.
    """
    try:
        if ":" in text:
            low, step, high = (float(part) for part in text.split(":"))
            count = round((high - low) / step) + 1
            if not (4 <= count <= _MOST_POINTS and abs(low + (count - 1) * step - high) <= 1e-9 * abs(high - low)):
                raise ConfigurationError(f"--{name} {text}: the step must divide the range into 3 to 2000 parts.")
            values = low + step * np.arange(count, dtype=np.float64)
        else:
            values = np.array([float(part) for part in text.split(",")])
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        raise ConfigurationError(f"--{name} {text:.60} is neither of the form -300,-200,0 nor -300:20:0.") from error
    values = clean(values)
    if not (4 <= len(values) <= _MOST_POINTS and np.isfinite(values).all() and (np.diff(values) > 0).all()):
        raise ConfigurationError(f"--{name} must list 4 to {_MOST_POINTS} increasing currents, A.")
    if 0.0 not in values:
        raise ConfigurationError(f"--{name} does not contain 0: a table must contain zero current.")
    return values


def default_axis(i_max: float) -> FloatArray:
    """Return 41 equally spaced points from -i_max to i_max, A: the table reaches every current of the experiment."""
    return clean(i_max / _HALF * np.arange(-_HALF, _HALF + 1, dtype=np.float64))


def clean(values: FloatArray) -> FloatArray:
    """Return values without the rounding errors of added steps: 0.3, not 0.30000000000000004."""
    scale = float(np.abs(values).max(initial=0.0))
    rounded = [0.0 if abs(value) < 1e-9 * scale else float(f"{value:.12g}") for value in values.tolist()]
    return np.array(rounded)
