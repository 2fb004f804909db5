"""Cells of the maps: how fine they are, where the residuals show that they are too coarse, and finer ones there.

A window's residual holds the flux error at both of its ends. The misfit beyond current noise is therefore attributed to
the cells along i_d and i_q that the ends lie in, by nonnegative least squares: m_c >= 0 for every cell in

    |r_n|^2 = noise_n + sum of m_c over the cells c of both ends of window n.

A machine whose iron bridges saturate at small i_q misfits around i_q = 0 and nowhere else. What spreads evenly (iron
loss, delays, the inverter's curve, which follows the phase currents) does not stand out in any cell, and finer cells do
not predict it better, which is tested on data left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from drive_id.core.maps.coenergy import bent_edges
from drive_id.core.maps.coverage import FLUX_CELLS
from drive_id.core.numerics.normal_equations import nonnegative
from drive_id.types import TINY, FloatArray, IntArray

HARMONIC_CELLS = 4
"""Usual cells per axis of the amplitudes of its harmonics."""
_MOST_CELLS = 1200
"""Of the plane, at most: memory grows with their square, time with their third power."""
_OF_LARGEST = 1 / 30
"""Smallest misfit of a cell that is divided, relative to the largest: the next division shows what remains."""
_FEWER = (1.0, 3.0, 10.0)
"""Factors of the least misfit of a cell that is divided, tried in turn until there are no more cells than allowed."""
_LEAST = 0.5
"""Misfit over noise, both squared, from which on a cell is too coarse: it recurs in each pass, noise averages out."""
_BENT = 0.25
"""Change of an inductance over a cell, relative to the largest: of smooth saturation, a cell meets a tenth."""
_STRONG = 64.0
"""Squared misfit relative to the least one from which on a cell is divided by four instead of two: the flux between
knots is off by the third power of their distance, so halves leave 1/64 of the squared misfit of smooth saturation."""


@dataclass(frozen=True, eq=False)
class Resolution:
    """Cells of the map and of its harmonics."""

    d: FloatArray  # (C + 1,), edges of the map's cells along i_d and i_q, increasing, A
    q: FloatArray
    harmonic: int = HARMONIC_CELLS  # cells per axis of the amplitudes of harmonics
    halved: bool = False  # whether cells were halved where the map bends

    @classmethod
    def usual(cls, low: FloatArray, high: FloatArray) -> Resolution:
        """Return the usual cells of the rectangle from ``low`` (2,) to ``high`` (2,), A."""
        d, q = (bent_edges(start, end, FLUX_CELLS) for start, end in zip(low, high, strict=True))
        return cls(d, q)

    @property
    def finer_than_usual(self) -> bool:
        """Whether there are more cells than usual."""
        return max(len(self.d), len(self.q)) > FLUX_CELLS + 1 or self.harmonic > HARMONIC_CELLS

    def finer(self, misfit: Misfit) -> Resolution:
        """Return a resolution with the cells divided where the misfit exceeds noise, the worst where not all may be.

        If none may be, return this one.
        """
        for factor in _FEWER:
            d, q = (_divided(*of_axis, factor * misfit.least) for of_axis in ((self.d, misfit.d), (self.q, misfit.q)))
            if len(self.d) * len(self.q) < len(d) * len(q) <= _MOST_CELLS:
                return replace(self, d=d, q=q)
        return self

    def where_bent(self, change_d: FloatArray, change_q: FloatArray) -> Resolution:
        """Return a resolution with the cells halved over which the inductance along their axis changes much.

        If there are none, return this one.

        Parameters
        ----------
        change_d, change_q : (C,) float
            Change over each cell, relative to the largest inductance.
        """
        d, q = (_divided(edges, change, _BENT) for edges, change in ((self.d, change_d), (self.q, change_q)))
        more = len(self.d) * len(self.q) < len(d) * len(q) <= _MOST_CELLS
        return replace(self, d=d, q=q, halved=True) if more else self


@dataclass(frozen=True, eq=False)
class Misfit:
    """Squared residuals beyond noise in the cells of each axis, relative to the mean noise."""

    d: FloatArray  # (C,)
    q: FloatArray
    least: float  # from which on a cell is too coarse

    @property
    def shows(self) -> bool:
        """Whether any cell is too coarse."""
        return bool(max(self.d.max(), self.q.max()) > self.least)


def misfit_by_cell(
    resolution: Resolution, i_dq: FloatArray, squares: FloatArray, expected: FloatArray, negligible: float
) -> Misfit:
    """Attribute residuals beyond noise to cells.

    Parameters
    ----------
    resolution : Resolution
    i_dq : (N, 2, 2) float
        Currents at both ends of windows, A.
    squares, expected : (N,) float
        Squared residuals, and what noise explains of them, (Vs)^2.
    negligible : float
        Squared residual that matters to nobody, (Vs)^2.
    """
    of_axes = []
    for axis, edges in enumerate((resolution.d, resolution.q)):
        ends = np.stack([_cell(edges, i_dq[:, end, axis]) for end in (0, 1)], axis=1)
        of_axes.append(
            np.stack([(ends == cell).sum(axis=1) for cell in range(len(edges) - 1)], axis=1, dtype=np.float64)
        )
    columns = np.concatenate([*of_axes, np.ones((len(i_dq), 1))], axis=1)
    unit = max(float(expected.mean()), TINY)
    excess, least = (squares - expected) / unit, max(_LEAST, negligible / unit)
    found = np.zeros(columns.shape[1])
    if np.max(columns.T @ excess / np.maximum(columns.sum(axis=0), 1.0)) > least:
        found = nonnegative(columns.T @ columns, columns.T @ excess)
    split = of_axes[0].shape[1]
    return Misfit(found[:split], found[split:-1], max(least, _OF_LARGEST * float(found[:-1].max())))


def _cell(edges: FloatArray, current: FloatArray) -> IntArray:
    return np.clip(np.searchsorted(edges, current, side="right") - 1, 0, len(edges) - 2)


def _divided(edges: FloatArray, misfit: FloatArray, least: float) -> FloatArray:
    """Divide cells where the misfit is too large, and their neighbours in two, so that widths change gradually."""
    parts = np.where(misfit > _STRONG * least, 4, np.where(misfit > least, 2, 1))
    beside = np.maximum(np.r_[parts[1:], 1], np.r_[1, parts[:-1]])
    parts = np.maximum(parts, np.minimum(beside, 2))
    inner = [
        np.linspace(low, high, count, endpoint=False) for (low, high), count in zip(pairwise(edges), parts, strict=True)
    ]
    return np.concatenate([*inner, edges[-1:]])
