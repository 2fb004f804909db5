"""Tell from their values whether currents are readings of a converter, and voltages duty cycles, and of what range."""

from __future__ import annotations

import numpy as np

from drive_id.inspection.names import doubtful_unit, printable, states_factor, words
from drive_id.inspection.points import PhaseGroup
from drive_id.types import FloatArray

_NEAR_HALF = 0.01
"""Difference of the means from a power of two, by it, up to which that is the zero: half of the converter's range."""
_OFF_ZERO = 0.25
"""Least mean of each phase by its range: over some turns, currents have none."""
LARGEST_SHARE = 1.17
"""Largest duty cycle with its zero sequence, 2 / sqrt(3), and a reserve; currents of this size may be shares, too."""
_PERCENT, _PERMILLE = 100.0, 1000.0
_SHARE = 1e-2  # by which duty cycles may exceed their range
_MIDDLE = 0.03
"""Difference of the mean of a phase from the middle of the range, by the range, up to which these are duty cycles."""
_FEWEST_COUNTS = 200
"""Counts of a timer that are no percent."""
_NAMES = {"duty", "pwm", "dutycycle", "mod", "modulation"}
_VOLTS = {"u", "v", "volt", "voltage", "spannung"}
_HALF = 2 / 3
"""Largest voltage of a phase by the DC link, that of six steps: duty cycles around zero up to it may be such shares."""
_POWER_INVARIANT = np.sqrt(2 / 3)
"""Amplitude of phase quantities by that of power-invariant components."""
_UNIT = 0.02  # below zero, up to which duty cycles reach from 0 to 1


def zero_reading(i: PhaseGroup) -> FloatArray:
    """Return the reading of each phase without current (2 or 3,); zeros where the values may be amperes.

    The phase currents of a machine sum to zero, so that they never have means of one sign.
    """
    means = i.values.mean(axis=0)
    size = means * np.sign(means[0])
    if i.group.frame != "abc" or np.any(size <= _OFF_ZERO * np.ptp(i.values, axis=0)):
        return np.zeros(len(means))
    half = 2.0 ** np.rint(np.log2(size.mean()))
    near = is_whole(i.values) and np.abs(size / half - 1).max() < _NEAR_HALF
    return np.full(len(means), half * np.sign(means[0])) if near else means


def is_whole(x: FloatArray) -> bool:
    """Tell whether all values are whole numbers, as counts are, and amperes, volts or seconds hardly ever."""
    return bool(np.all(x == np.rint(x)))


def full_scale(u: PhaseGroup) -> float:
    """Return the range of duty cycles; 0 for volts.

    It is 1 for 0 to 1, 2 for -1 to 1, 100 for percent, 1000 for permille, 200 for -100 to 100 %, or twice the mean of
    counts of a timer.

    Voltages of phases have no mean in common, and those to the negative rail half of the DC-link voltage.
    """
    low, high = float(u.values.min()), float(u.values.max())
    volts = u.unit_factor is not None  # mV or kV
    if max(-low, high) <= LARGEST_SHARE and not volts:
        return 1.0 if low >= -_UNIT else 2.0
    if u.group.frame != "abc" or volts:
        return 0.0
    named = bool(words(u.label) & _NAMES and not words(u.group.stem) & _VOLTS) or "%" in u.label
    means = u.values.mean(axis=0)
    for full in (_PERCENT, _PERMILLE):
        around_half = bool(np.all(np.abs(means - full / 2) < _MIDDLE * full))
        within = low >= -_SHARE * full and high <= (1 + _SHARE) * full
        if within and (around_half or (named and full == _PERCENT and low >= 0)):
            return full
    counts = is_whole(u.values) and low >= 0 and high > _FEWEST_COUNTS
    if counts and float(np.ptp(means)) < _MIDDLE * 2 * float(means.mean()):
        return float(2 * np.rint(means.mean()))
    if named and max(-low, high) <= LARGEST_SHARE * _PERCENT:
        return 2 * _PERCENT
    return 0.0


def may_be_half(u: PhaseGroup, full: float) -> bool:
    """Tell whether duty cycles around zero, of this range, may be voltages by the DC link, of half the range."""
    return full in (2.0, 2 * _PERCENT) and float(np.abs(u.values).max()) <= _HALF * full / 2


def open_by_name(name: str, given: str = "") -> list[str]:
    """Return what a name, and the unit that the log gives, leave open about a scale: rms values, no unit, a factor."""
    doubtful = doubtful_unit(name)
    found = [f"1, if {doubtful} in the name is no unit"] if doubtful else []
    if states_factor(f"{name} {given}"):
        found.append(f"or what {printable(f'{name} {given}'.strip())} says")
    if any(word.endswith("rms") for word in words(f"{name} {given}")):
        found.append(f"{np.sqrt(2):.6g}, if these are rms values, as their name says")
    return found


def open_scale(x: FloatArray, factor: float | None, unit: str, frame: str = "abc") -> list[str]:
    """Return what values leave open about the factor to their unit, of which the log states ``factor``, or None."""
    whole = factor is None and is_whole(x)
    found = [f"{unit} per count: these are whole numbers, without a unit"] if whole else []
    if frame in ("alpha_beta", "dq"):
        found.append(f"times {_POWER_INVARIANT:.4f} if these components are power-invariant, not amplitude-invariant")
    return found
