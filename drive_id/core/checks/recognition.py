"""Tell from its values what a recorded column may be: a rotor angle, a running count, a constant."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from drive_id.types import BoolArray, FloatArray, IntArray

_FEWEST = 50  # values, to tell a shape
_WRAP = 0.6
"""Step relative to the range above which a column starts again."""
_LARGEST_STEP = 0.45  # of the range: an angle that moves further between samples is ambiguous
_GLITCHES = 0.005
"""Share of the steps that may be larger: a glitch, or a blank cell at a wrap that was interpolated, makes two."""
_TURNS = 4 * np.pi
"""Range from which on what is named as an angle, and never starts again, may be one that reverses."""
_STEADY = 0.9  # share of steps in one direction where the column wraps: noise reverses some
_MONOTONE = 0.98  # the same where it does not, which drifts of other signals do, too
_GAP = 1.5  # usual times between rows, from which on rows may be missing
_NO_GAPS = 0.9  # share of the rows that count however much the stamps jitter
_UNEVEN = 20  # largest over median step of an angle without wraps
_MANY = 1000  # range from which on whole numbers are counts
_EXACT = 5e-4
"""Relative difference of a turn from usual counts, up to which counts may have fractions, as in a resampled log."""
_UNITS = ((2 * np.pi, "rad"), (360.0, "deg"), (1.0, "rev"), (2.0, "rev"), (400.0, "rev"))
"""Range of an angle and the unit it is drafted in; the last two are half turns and gradians."""
_NEAR = 0.02
"""Difference of a turn from that of a unit, by it."""
_FULL_COUNTS = (
    *(4 * lines for lines in (500, 600, 720, 900, 1000, 1250, 1500, 2000, 2500, 3600, 4000, 5000, 10_000)),
    *(2**n for n in range(8, 25)),
)
"""Usual counts of an encoder per revolution: four per line, or powers of two."""


@dataclass(frozen=True, eq=False)
class AngleLike:
    """A column that moves like the angle of a rotor."""

    unit: str  # ``rad``, ``deg``, ``rev`` or ``counts``
    # by how much it changes per revolution (of whatever it counts); 0 if it never starts again and has no known unit
    turn: float
    wraps: bool  # whether it starts again
    certain: bool  # whether the unit follows from the values

    def unwrapped(self, x: FloatArray) -> FloatArray:
        """Return the column (N,) without the steps where it starts again."""
        return np.asarray(np.unwrap(x, period=self.turn)) if self.wraps else x


def angle_like(x: FloatArray, stamp: IntArray | None = None, *, named: bool = False) -> AngleLike | None:
    """Tell whether a column (N,) moves like an angle, and in which unit; None if it does not.

    The longest steps of the stamps (N,), if given, do not count: an angle moves anywhere while rows are missing. One
    that never starts again may reverse where it is ``named`` as an angle.
    """
    there = np.isfinite(x)
    x = x[there]
    spread, steps = (float(np.ptp(x)), np.diff(x)) if len(x) >= _FEWEST else (0.0, x)
    if stamp is not None and spread:
        elapsed = np.diff(stamp[there])
        steps = steps[elapsed <= max(_GAP * np.median(elapsed), np.quantile(elapsed, _NO_GAPS))]
    if not spread > 0:
        return None
    wraps = np.abs(steps) > _WRAP * spread
    small = steps[~wraps]
    moving = small[small != 0]
    if len(moving) < _FEWEST // 2 or np.mean(np.abs(small) > _LARGEST_STEP * spread) > _GLITCHES:
        return None
    forward = float(np.mean(moving > 0))
    steady = max(forward, 1 - forward)
    if wraps.sum() >= 2:
        against = np.sign(steps[wraps]) == -np.sign(np.median(moving))
        turn = float(np.median(np.abs(steps[wraps]))) + float(np.median(np.abs(moving)))
        good = steady >= _STEADY and against.mean() >= _STEADY
        return _in_unit(turn, x) if good or _reverses_seldom(steps, wraps) else None
    if wraps.sum() == 1 and steady >= _MONOTONE:
        turn = float(np.abs(steps[wraps])[0]) + float(np.median(np.abs(moving)))
        found = _in_unit(turn, x) if np.sign(steps[wraps])[0] == -np.sign(np.median(moving)) else None
        return found if found is not None and found.unit == "counts" and found.certain else None
    reverses = named and spread > _TURNS and _keeps_direction(np.sign(moving)) >= _MONOTONE
    if (steady < _MONOTONE and not reverses) or np.abs(steps).max() > _UNEVEN * np.median(np.abs(steps)) + 2:
        return None
    whole = bool(np.all(x == np.rint(x))) and spread > _MANY
    return AngleLike("counts" if whole else "rad", 0.0 if whole else 2 * np.pi, wraps=False, certain=False)


def _reverses_seldom(steps: FloatArray, wraps: BoolArray) -> bool:
    """Tell whether steps (N,) mostly keep their direction, and the wraps among them go against it."""
    moves = np.flatnonzero(~wraps & (steps != 0))
    direction = np.sign(steps[moves])
    before = direction[np.maximum(np.searchsorted(moves, np.flatnonzero(wraps)) - 1, 0)]
    return bool(_keeps_direction(direction) >= _MONOTONE and np.mean(np.sign(steps[wraps]) == -before) >= _STEADY)


def _keeps_direction(direction: FloatArray) -> float:
    """Return the share of the steps (N,) that have the direction, 1 or -1, of the one before."""
    return float(np.mean(direction[1:] == direction[:-1]))


def _in_unit(turn: float, x: FloatArray) -> AngleLike | None:
    whole = bool(np.all(x == np.rint(x)))
    for value, name in _UNITS:
        if abs(turn / value - 1) < _NEAR and not (whole and name != "deg"):
            return AngleLike(name, value, wraps=True, certain=True)
    if turn > _FEWEST and (whole or any(abs(count / turn - 1) < _EXACT for count in _FULL_COUNTS)):
        reach = float(x.max()) + 1 - min(float(x.min()), 0.0)
        near = [count for count in _FULL_COUNTS if abs(count / turn - 1) < 0.02 and count >= reach - 1]
        best = min(near, key=lambda count: abs(count - turn), default=round(reach))
        return AngleLike("counts", float(best), wraps=True, certain=bool(near))
    return None


def is_count(x: FloatArray) -> bool:
    """Tell whether a column (N,) is a running count of its rows, with losses perhaps."""
    if len(x) < _FEWEST or not np.isfinite(x).all():
        return False
    steps = np.diff(x)
    return bool(np.all(x == np.rint(x))) and float(np.mean(steps == 1)) > _STEADY


def likely_counts(turns: float, moved: float) -> list[tuple[int, int]]:
    """Return usual counts per revolution, each with the pole pairs by which they explain the electrical turns.

    Of those with the same ratio, which nothing in the log tells apart, that with the fewest pole pairs.

    Parameters
    ----------
    turns : float
        Electrical revolutions.
    moved : float
        Counts meanwhile.
    """
    pairs = [(count, turns * count / moved) for count in _FULL_COUNTS]
    good = [(count, round(abs(p)), abs(abs(p) - round(abs(p))) / max(abs(p), 1)) for count, p in pairs]
    likely = sorted(
        (round(away, 9), pole_pairs, count) for count, pole_pairs, away in good if 1 <= pole_pairs <= 24 and away < 0.03
    )
    by_ratio: dict[Fraction, tuple[int, int]] = {}
    for _, pole_pairs, count in likely:
        by_ratio.setdefault(Fraction(count, pole_pairs), (count, pole_pairs))
    return list(by_ratio.values())


def rotation_of(z: NDArray[np.complex128]) -> float:
    """Return the rotation, rad, of a vector (N,) over its samples by its strongest frequency; negative: backwards."""
    if len(z) < _FEWEST:
        return 0.0
    spectrum = np.abs(np.fft.fft(z * np.hanning(len(z)), 4 * len(z)))
    frequency = np.fft.fftfreq(4 * len(z))
    return float(2 * np.pi * frequency[int(spectrum.argmax())] * len(z))
