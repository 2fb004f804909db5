"""The rotor angle between its samples, by its own motion: for angles recorded at another rate than the currents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.common.quantity import counted
from drive_id.core.signals.signal import Signal
from drive_id.errors import DataError
from drive_id.types import FloatArray, IntArray

_FEWEST = 4
"""Fewest samples from which an angle is interpolated."""
_LONGEST = 3.5
"""Periods of the angle across which it is interpolated."""
_LARGEST_TURN = 2.6
"""Turn between two samples of the angle, rad, above which it is ambiguous without the speed."""


@dataclass(frozen=True, eq=False)
class InterpolatedRotor:
    """Angle and speed at other times."""

    signal: Signal  # (N, 2) values between its samples: angle, rad, not wrapped, and speed, rad/s
    error: float  # estimated root mean square error, rad, see :func:`_error`
    period: float  # of the recorded angle, s


def interpolated_rotor(rotor: Signal, clock: IntArray) -> InterpolatedRotor:
    """Interpolate angle and speed at increasing times (N,), ns, by cubics that pass through every sample of the angle.

    Where the speed is recorded ((M, 2) values instead of (M, 1)), it is the slope of the cubics (Hermite); otherwise
    the angle is a spline.

    Raises DataError when there are fewer than four samples, or the angle turns too far between them.
    """
    order = np.argsort(rotor.stamp, kind="stable")
    stamp = rotor.stamp[order]
    kept = np.append(True, np.diff(stamp) > 0) & np.isfinite(rotor.values[order]).all(axis=1)
    stamp, values = stamp[kept], rotor.values[order][kept]
    if len(stamp) < _FEWEST:
        raise DataError(
            f"{rotor.name} holds {counted(len(stamp), 'sample')}, too few to interpolate: record the angle throughout."
        )
    time = (stamp - stamp[0]) * 1e-9
    period = float(np.median(np.diff(time)))
    speed = values[:, 1] if values.shape[1] > 1 else None
    angle = _unwrapped(time, values[:, 0], speed, rotor.name)
    inside = clock[(clock >= stamp[0]) & (clock <= stamp[-1])]
    before = np.clip(np.searchsorted(stamp, inside, side="right") - 1, 0, len(stamp) - 2)
    inside = inside[(stamp[before + 1] - stamp[before]) <= _LONGEST * period * 1e9]
    at = (inside - stamp[0]) * 1e-9
    found, slope = _cubics(time, angle, speed, at)
    error = _error(time, angle, speed)
    signal = Signal(rotor.name, inside, np.column_stack([found, slope]))
    return InterpolatedRotor(signal, error, period)


def _error(time: FloatArray, angle: FloatArray, speed: FloatArray | None) -> float:
    """Return the root mean square error, rad, of the angle between its samples.

    Samples that are left out show the error at twice and at four times the spacing. Halving the spacing divides the
    error of a smooth motion by 16 and leaves that of noise unchanged; the ratio of the two is extrapolated once more.
    """
    errors = []
    for step in (2, 4):
        left_out = slice(step // 2, (len(time) - 1) // step * step, step)
        if len(time[::step]) < _FEWEST or not len(time[left_out]):
            break
        found, _ = _cubics(time[::step], angle[::step], None if speed is None else speed[::step], time[left_out])
        errors.append(float(np.sqrt(np.mean((found - angle[left_out]) ** 2))))
    if len(errors) < 2 or errors[1] <= errors[0]:
        return errors[0] if errors else 0.0
    return errors[0] ** 2 / errors[1]


def _unwrapped(time: FloatArray, angle: FloatArray, speed: FloatArray | None, name: str) -> FloatArray:
    """Return the angle without steps of 2 pi; by the speed, where that is known."""
    if speed is not None:
        expected = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])
        return np.asarray(np.unwrap(angle - expected) + expected)
    found = np.unwrap(angle)
    turn = float(np.quantile(np.abs(np.diff(found)), 0.99))
    if turn > _LARGEST_TURN:
        raise DataError(
            f"The angle of {name} turns by {np.rad2deg(turn):.0f} degrees electrical between its samples, too far to "
            "interpolate without the speed: record it more often, or name the speed in the signals file."
        )
    return np.asarray(found)


def _cubics(
    time: FloatArray, angle: FloatArray, speed: FloatArray | None, at: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the angle and its slope at the times (N,)."""
    from scipy.interpolate import CubicHermiteSpline, CubicSpline  # noqa: PLC0415  # takes as long to load as a bag

    curve = CubicSpline(time, angle) if speed is None else CubicHermiteSpline(time, angle, speed)
    slope = curve(at, 1) if speed is None else np.interp(at, time, speed)
    return np.asarray(curve(at)), np.asarray(slope)
