"""Lack of fit: residuals beyond noise, their location, and their contribution to the standard errors.

Current noise explains residuals of a known size. Residuals that recur beyond it in the same region of the current plane
or at the same rotor position do not average out over passes of the trajectory, as the covariance by batches of time
assumes. Summing the scores over such groups as well gives their contribution to the covariance (multiway clustering,
Cameron, Gelbach and Miller 2011).

Candidate causes are compared by score tests: the share of the squared residuals that the columns of each would save.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from drive_id.core.frames import ComplexArray
from drive_id.core.full.model import FullModel
from drive_id.core.full.solver import FullSolution
from drive_id.core.full.windows import Windows
from drive_id.core.maps.coverage import smoothed
from drive_id.types import TINY, FloatArray, IntArray

_CELLS = 12
"""Per axis of the current plane: with 10 s of data, a cell holds some 100 windows, but misfits of the map are wider."""
_POSITIONS = 48
"""Rotor positions: every 7.5 degrees, for harmonics to the 24th."""
_FEWEST = 8
"""Fewest windows of a group that is evaluated."""
_NEIGHBOURS = 2
"""Cells to each side over which the missed flux is averaged."""
_SIGNIFICANCE = 4.0
"""Standard deviations of the mean square of cells from which on a misfit recurs in them."""


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Residuals beyond noise."""

    ratio: float  # rms of the residuals over the rms that current noise explains
    i_dq: FloatArray  # (2,), centre of the region of the current plane with the largest residuals, A
    worst: float  # the same ratio there
    low: float  # the same ratio below a fifth of i_max
    # (C, C, 2), mean square flux, Wb^2, of d and q, that the data show and the model cannot follow, on equal cells of
    # the square around the current disc; 0 unless significant, see :func:`missed_flux`
    missed: FloatArray
    # (size, G), changes of the estimate by the groups beyond noise, see :class:`~drive_id.core.full.fit.FullFit`
    changes: FloatArray
    # share of the squared residuals that each possible cause would explain, see :func:`tested_causes`; empty if not
    # tested
    causes: Mapping[str, float] = field(default_factory=dict)

    def missed_at(self, i_dq: FloatArray, i_max: float) -> FloatArray:
        """Return the mean square of the missed flux (N, 2), Wb^2, at currents (N, 2), A."""
        d, q = divmod(_cell(i_dq, i_max), _CELLS)
        return np.asarray(self.missed[d, q])


class GroupSums:
    """Scores and residuals of windows, summed by cell of the current plane and by rotor position."""

    def __init__(self, unknowns: int) -> None:
        self._by_cell = np.zeros((_CELLS**2, unknowns + 10))  # scores, 5 facts, 5 flux facts
        self._by_position = np.zeros((_POSITIONS, unknowns + 5))  # scores, 5 facts

    def add(self, windows: Windows, rows: FloatArray, expected: FloatArray, i_max: float) -> None:
        """Add windows.

        Parameters
        ----------
        rows : (N, 2, unknowns + 1) float
            Z T and, last, the residuals.
        expected : (N,) float
            Squared residuals that current noise explains, (Vs)^2.
        i_max : float
            Radius of the current disc, A.
        """
        error = rows[..., -1]
        turned = (error[:, 0] + 1j * error[:, 1]) * np.exp(-1j * windows.angle.mean(axis=1))
        scores = np.einsum("nak,na->nk", rows[..., :-1], error)
        facts = np.stack([np.ones(len(windows)), turned.real, turned.imag, np.abs(turned) ** 2, expected], axis=1)
        cell = _cell(windows.i_dq.mean(axis=1), i_max)
        position = (np.mod(windows.angle[:, 0], 2 * np.pi) / (2 * np.pi) * _POSITIONS).astype(np.int64)
        position = np.minimum(position, _POSITIONS - 1)
        found = np.concatenate([scores, facts, _flux_facts(windows, turned)], axis=1)
        self._by_cell += _members(cell, _CELLS**2) @ found
        self._by_position += _members(position, _POSITIONS) @ found[:, :-5]

    def merge(self, other: GroupSums) -> None:
        """Add the sums over other windows."""
        self._by_cell += other._by_cell
        self._by_position += other._by_position

    def lack_of_fit(self, model: FullModel, solution: FullSolution, share: float) -> LackOfFit:
        """Compare the residuals with noise, by region of the current plane and by rotor position.

        Parameters
        ----------
        share : float
            Number of all windows over that of the windows added.
        """
        by_cell, cells, fluxes = np.split(self._by_cell, [-10, -5], axis=1)
        by_position, positions = np.split(self._by_position, [-5], axis=1)
        squares = cells[:, 3] / np.maximum(cells[:, 4], TINY)
        enough = cells[:, 0] > _FEWEST
        worst = int(np.argmax(np.where(enough, squares, 0.0)))
        ratios = [_repeating(facts) for facts in (cells, positions)]
        changes = [
            solution.basis @ solution.gain(np.sqrt(max(1 - 1 / ratio, 0.0)) * share * scores.T)
            for ratio, scores in zip(ratios, (by_cell, by_position), strict=True)
            if ratio > 1
        ]
        inner = enough & (np.hypot(*_centre(np.arange(_CELLS**2), 1.0)) < 0.2)
        return LackOfFit(
            ratio=_rms_ratio(cells[enough]),
            i_dq=_centre(worst, model.i_max),
            worst=float(np.sqrt(squares[worst])),
            low=_rms_ratio(cells[inner]),
            missed=missed_flux(fluxes),
            changes=np.concatenate(changes, axis=1) if changes else np.zeros((model.size, 0)),
        )


def _members(group: IntArray, count: int) -> sparse.csr_array:
    """Return the matrix (count, N) that sums rows (N, ...) over their groups (N,)."""
    return sparse.csr_array((np.ones(len(group)), (group, np.arange(len(group)))), shape=(count, len(group)))


def _flux_facts(windows: Windows, turned: ComplexArray) -> FloatArray:
    """Return count, h^2, h times the flux that would cause the residual in d and q, and the residual's square (N, 5).

    A flux error x in the rotor frame, equal at both ends, causes the residual ``j h x`` in the frame of the mean angle,
    with ``h = 2 sin(turn / 2)``.
    """
    h = 2 * np.sin(0.5 * np.diff(windows.angle, axis=1)[:, 0]) * np.sqrt(windows.weights)
    flux = -1j * h * turned
    return np.stack([np.ones(len(windows)), h**2, flux.real, flux.imag, np.abs(turned) ** 2], axis=1)


def missed_flux(facts: FloatArray) -> FloatArray:
    """Return the mean square flux (C, C, 2), Wb^2, of d and q, that recurs in the residuals of cells.

    The mean residual of a cell over passes and rotor positions shows a flux that the model cannot follow: any other
    flux error would have been fitted. Its mean square less that of noise is averaged over neighbouring cells. It is set
    to 0 unless its mean over all cells is significant in d or q.

    Parameters
    ----------
    facts : (C^2, 5) float
        Sums over the windows of each cell, see :func:`_flux_facts`.
    """
    enough = facts[:, 0] > _FEWEST
    count, weight, *flux, square = np.where(enough, facts.T, 1.0)
    weight = np.maximum(weight, TINY)  # a rotor that stands still shows none
    mean = np.stack(flux, axis=1) / weight[:, None]
    noise = np.maximum(square / count - weight / count * np.sum(mean**2, axis=1), 0.0) / 2 / weight
    side = (_CELLS, _CELLS)
    excess = np.where(enough[:, None], mean**2 - noise[:, None], 0.0).reshape(*side, 2)
    cells = max(int(enough.sum()), 1)
    relative = excess.sum(axis=(0, 1)) / max(float(noise[enough].sum()), TINY)
    if not enough.any() or relative.max() < _SIGNIFICANCE * np.sqrt(2 / cells):
        return np.zeros_like(excess)
    local = [smoothed(excess[..., k], enough.reshape(side), _NEIGHBOURS) for k in range(2)]
    return np.maximum(np.stack(local, axis=-1), 0.0)


def _rms_ratio(facts: FloatArray) -> float:
    """Return the rms of the residuals of groups over that of noise; 1 without any."""
    return float(np.sqrt(facts[:, 3].sum() / max(facts[:, 4].sum(), TINY))) if len(facts) else 1.0


def _cell(i_dq: FloatArray, i_max: float) -> IntArray:
    """Return the number (N,) of the cell of currents (N, 2), A."""
    place = np.clip((i_dq / i_max + 1) / 2, 0.0, 1.0 - 1e-9)
    cell = (place * _CELLS).astype(np.int64)
    return np.asarray(cell[:, 0] * _CELLS + cell[:, 1])


def _centre(cell: int | IntArray, i_max: float) -> FloatArray:
    """Return the currents (2, ...) in the middle of cells, A."""
    return np.asarray((2 * (np.array(divmod(cell, _CELLS)) + 0.5) / _CELLS - 1) * i_max)


def _repeating(facts: FloatArray) -> float:
    """Return the mean square of the groups' mean residuals over that of white ones; 1 unless it is significant.

    ``facts`` (G, 5) are count, sum of both parts, sum of squares, and that of noise, of each group.
    """
    count, real, imag, square, _ = facts[facts[:, 0] > _FEWEST].T
    if not len(count):
        return 1.0
    white = square.sum() / count.sum()
    found = (real**2 + imag**2) / count / max(white, TINY)
    ratio = float(found.mean())
    return ratio if ratio > 1 + _SIGNIFICANCE / np.sqrt(len(count)) else 1.0
