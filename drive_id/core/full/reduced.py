"""The normal equations of a variant after one elimination, from which any set of effects follows at once.

All unknowns of the variant but its effects and its delay are projected out of the columns ``C`` of the voltages, their
shifts, the effects and the remainder: ``S = C'C - C'Z (Z'Z + P)^-1 Z'C``. Of this matrix of some hundred columns, a set
of effects E with the voltages v leaves the sum of squares ``v'(S_vv - S_vE S_EE^-1 S_Ev) v``, and the effects are
``S_EE^-1 S_Ev v``. The linear part of the map follows by substitution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from drive_id.core.full.model import SHIFT, VOLTAGE, FullModel, delay_shares
from drive_id.core.full.windows import EARLIEST, SHIFTS
from drive_id.types import TINY, FloatArray, IntArray

_DEPENDENT = 1e-9
"""Singular value, relative to the largest, from which on columns of effects depend on one another."""


def voltage_columns(model: FullModel) -> IntArray:
    """Return the columns of the voltages, their shifts, and the remainder, of which a delay is a combination."""
    return np.asarray(np.r_[VOLTAGE, SHIFT, model.effect("remainder")], np.int64)


@lru_cache(maxsize=1024)
def delayed(delay: float) -> FloatArray:
    """Return the combination of :func:`voltage_columns` that is the integral of the delayed voltages."""
    combination = np.concatenate([[1.0], -delay_shares(delay), [-1.0, -1.0]])
    combination.flags.writeable = False
    return combination


_BASE = len(delayed(0.0))
"""Number of :func:`voltage_columns`."""
_EDGES = np.array(sorted({*SHIFTS, SHIFTS[-1] + 1, EARLIEST}), np.float64)
"""Delays, samples, between which the columns are a straight line of the delay; at the earliest they change over."""
_STARTS = np.array([delayed(low) for low in np.nextafter(_EDGES[:-1], np.inf)])
_LENGTHS = np.diff(_EDGES)
_HELD = int(np.searchsorted(_EDGES, EARLIEST))
"""Number of the line along which early voltages are those held before the ends."""
_STEPS = (np.array([delayed(high) for high in _EDGES[1:]]) - _STARTS) / _LENGTHS[:, None]


def best_delay(left: FloatArray) -> tuple[float, float, float]:
    """Return the delay, samples, that leaves least of a form over :func:`voltage_columns`, that, and the bend there."""
    along = _STEPS @ left
    bend, slope = np.sum(along * _STEPS, axis=1), np.sum(along * _STARTS, axis=1)
    where = np.clip(-slope / np.maximum(bend, TINY), 0.0, _LENGTHS)
    at = _STARTS + where[:, None] * _STEPS
    squares = np.sum(at @ left * at, axis=1)
    if where[_HELD] == 0.0:  # earlier ones are not such: of filtered voltages, it left least at its end
        squares[_HELD] = np.inf
    best = int(np.argmin(squares))
    return float(_EDGES[best] + where[best]), float(squares[best]), float(bend[best])


@dataclass(frozen=True, eq=False)
class Subset:
    """A set of effects, solved for every combination of voltages."""

    names: frozenset[str]
    left: FloatArray  # (B, B), form over the voltages' columns that this set leaves, (Vs)^2
    values: dict[str, FloatArray]  # (K, B), value of each effect per column of the voltages

    def squares(self, delay: float) -> float:
        """Return the sum of squares, (Vs)^2, with the penalties' share, for a delay, samples."""
        voltage = delayed(delay)
        return max(float(voltage @ self.left @ voltage), 0.0)

    def value(self, name: str, delay: float) -> FloatArray:
        """Return the values (K,) of an effect."""
        return np.asarray(self.values[name] @ delayed(delay))


@dataclass(frozen=True, eq=False)
class Reduced:
    """The columns that are left after one elimination.

    Parameters
    ----------
    form : (C, C) float
        S over the columns of the voltages, then those of the effects.
    half : (M, C) float
        Products of the eliminated unknowns with these columns.
    back : callable
        Returns the eliminated columns (summed.size,) of the sums for combinations (M,) of these.
    """

    model: FullModel
    form: FloatArray
    half: FloatArray
    back: Callable[[FloatArray], FloatArray]
    known: dict[frozenset[str], Subset] = field(default_factory=dict)  # solved sets

    @staticmethod
    def columns(model: FullModel) -> IntArray:
        """Return the columns (C,) of the sums that are not eliminated; those of the voltages come first."""
        effects = np.arange(model.effects.start, model.effects.stop)
        base = voltage_columns(model)
        return np.concatenate([base, np.setdiff1d(effects, base)])

    def _own(self, names: Iterable[str]) -> list[tuple[str, IntArray]]:
        first = _BASE - self.model.effects.start
        return [(name, first + np.arange(own.start, own.stop)) for name in names for own in [self.model.effect(name)]]

    def subset(self, names: frozenset[str]) -> Subset:
        """Return a set of effects by their names in ``EFFECTS``, solved."""
        if names not in self.known:
            self.known[names] = self._solved(names)
        return self.known[names]

    def _solved(self, names: frozenset[str]) -> Subset:
        own = self._own(sorted(names))
        if not own:
            return Subset(names, self.form[:_BASE, :_BASE], {})
        places = np.concatenate([place for _, place in own])
        within, across = self.form[places[:, None], places], self.form[places, :_BASE]
        diagonal = np.diag(within)
        scale = np.where(diagonal > 0, np.sqrt(np.maximum(diagonal, TINY)), np.inf)  # without data, a value is zero
        values = np.linalg.lstsq(within / scale[:, None] / scale, across / scale[:, None], rcond=_DEPENDENT)[0]
        values /= scale[:, None]
        left = self.form[:_BASE, :_BASE] - across.T @ values
        ends = np.cumsum([len(place) for _, place in own])
        by_name = {name: values[end - len(place) : end] for (name, place), end in zip(own, ends, strict=True)}
        return Subset(names, left, by_name)

    def estimate(self, found: Subset, delay: float) -> FloatArray:
        """Return the estimate (size,) of a set with a delay, see :class:`~drive_id.core.full.solver.FullSolution`."""
        right = np.zeros(len(self.form))
        right[:_BASE] = delayed(delay)
        for name, place in self._own(found.names):
            right[place] = -found.value(name, delay)
        summed = self.back(self.half @ right)
        summed[self.columns(self.model)] -= right
        return np.asarray(self.model.expansion @ summed)
