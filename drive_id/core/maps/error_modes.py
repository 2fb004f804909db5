"""Joint errors of everything that a fit finds, as few modes: what carries standard errors over to derived figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drive_id.core.maps.flux_models import BasisRows
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.types import TINY, BoolArray, FloatArray, IntArray

MOST_MODES = 48  # that a result keeps
_LARGEST = 2**23  # values of all modes of both fluxes; fine grids get fewer modes
_HELD = 0.995  # share of the variance that the modes hold before each value is scaled to its standard error
_SITES = 200  # points of the map, about, by whose fluxes and slopes the modes are chosen
_WAVES = 4
"""Further modes that hold what these lack of the errors of inductances."""
_TURN = 0.7
"""Phase of their waves from one grid point to the next, rad: central differences find 92 % of their slope."""
_ACROSS = 3**-0.5
"""The same along the other axis, relative: that of an error which is the gradient of an isotropic co-energy."""
_SHARE_OF_OTHERS = 0.1  # weight of the other values in this choice, relative to that of the fluxes


@dataclass(frozen=True, eq=False)
class ErrorModes:
    """A factor of the joint covariance of fluxes, resistance, inverter curve and voltage error.

    Mode k changes all of them at once, by one standard error of an independent cause. A figure g(x) derived from them
    has the variance ``sum_k (g(x + m_k) - g(x))^2``. The squares of all modes of a value add up to the square of its
    standard error.
    """

    psi_d: NDArray[np.float32]  # (M, D, Q), Wb; 0 where data do not even enclose the current
    psi_q: NDArray[np.float32]  # likewise
    resistance: FloatArray  # (M,), ohm
    inverter_voltage: FloatArray  # (M, C), V
    voltage_error: FloatArray  # (M,), V

    @cached_property
    def known(self) -> BoolArray:
        """Where on the grid (D, Q) the errors of both fluxes are known."""
        return np.asarray(self.psi_d.any(axis=0) & self.psi_q.any(axis=0))

    def __len__(self) -> int:
        return len(self.resistance)


@one_blas_thread()
def error_modes(
    changes: FloatArray,
    rows: BasisRows,
    sigma: FloatArray,
    inside: BoolArray,
    others: tuple[FloatArray, FloatArray],
    frame: Callable[[FloatArray], FloatArray] | None = None,
    slopes: tuple[BasisRows, FloatArray] | None = None,
) -> ErrorModes | None:
    """Reduce the changes of a fit's unknowns by its batches of time to modes, and to waves if slopes are given.

    Parameters
    ----------
    changes : (P, B) float
        Of the flux parameters; ``changes @ changes.T`` is their covariance.
    rows : BasisRows
        The basis at N grid points.
    sigma : (D, Q, 2) float
        Standard errors of the fluxes, Wb.
    inside : (D, Q) bool
        Those grid points.
    others : (2 + C, B) float, (2 + C,) float
        Changes of resistance, voltage error and inverter curve, and their standard errors.
    frame : callable, optional
        Turns fluxes (..., 2) of the rows into those of the map.
    slopes : BasisRows, (N, 2) float, optional
        Rows of dpsi_d/di_d and dpsi_q/di_q, per step of the grid, and their standard errors, Wb. Waves then hold what
        the modes lack of these: few modes are smoother than the errors of a map.

    Returns
    -------
    ErrorModes or None
        None when the standard errors are not known.
    """
    wanted, (beside, sigma_beside) = sigma[inside], others
    if not (len(wanted) and np.isfinite(wanted).all() and np.isfinite(changes).all() and np.isfinite(beside).all()):
        return None
    fluxes, differences = _sampled(changes, rows, inside)
    samples = np.concatenate([_normalized(fluxes), *map(_normalized, differences)])
    weight = np.sqrt(_SHARE_OF_OTHERS * len(samples) / len(beside))
    samples = np.concatenate([samples, weight * _relative(beside, sigma_beside)])
    causes = _causes(samples, min(MOST_MODES, max(1, _LARGEST // (2 * inside.size))))
    psi = rows.dot(changes @ causes)  # (N, 2, M)
    if frame is not None:
        psi = np.moveaxis(frame(np.moveaxis(psi, 1, -1)), -1, 1)
    held, waves = wanted, np.zeros((*wanted.shape, 0))
    if slopes is not None:
        rows_of_slopes, of_slopes = slopes
        rest = _incoherent(psi, rows_of_slopes.dot(changes @ causes), wanted, of_slopes)
        held, waves = np.sqrt(np.maximum(wanted**2 - rest**2, 0.0)), _waves(rest, inside)
    modes = np.concatenate([_scaled(psi, held), waves], axis=-1)
    numbers = np.pad(_scaled(beside @ causes, sigma_beside), ((0, 0), (0, waves.shape[-1])))
    maps = np.zeros((2, modes.shape[-1], *inside.shape), np.float32)
    maps[:, :, inside] = np.moveaxis(modes, (1, 2, 0), (0, 1, 2))
    return ErrorModes(maps[0], maps[1], numbers[0], numbers[2:].T.copy(), numbers[1])


def _incoherent(psi: FloatArray, slope: FloatArray, sigma: FloatArray, of_slopes: FloatArray) -> FloatArray:
    """Return the part (N, 2) of the standard errors of the fluxes that waves must hold for those of the slopes, Wb.

    ``psi`` and ``slope`` (N, 2, M) are those of the modes, before they are scaled; slopes are per step of the grid.
    With x for the square of this part, modes and waves hold ``(sigma^2 - x) w + _TURN^2 x`` of the slope's variance, w
    being the ratio of the modes' own variances of slope and flux.
    """
    own, steep = np.sum(psi**2, axis=-1), np.sum(slope**2, axis=-1)
    ratio = np.divide(steep, own, out=np.zeros_like(own), where=own > 0)
    room = _TURN**2 - ratio
    lacking = np.divide(of_slopes**2 - sigma**2 * ratio, room, out=np.zeros_like(own), where=room > 0)
    return np.asarray(np.sqrt(np.clip(lacking, 0.0, sigma**2)))


def _waves(size: FloatArray, inside: BoolArray) -> FloatArray:
    """Return modes (N, 2, 4) of standard errors (N, 2): a sine and a cosine of psi_d, mainly along d, and of psi_q."""
    out, steps = np.zeros((len(size), 2, _WAVES)), np.stack(np.nonzero(inside), axis=-1)
    for axis in range(2):
        phase = _TURN * (steps[:, axis] + _ACROSS * steps[:, 1 - axis])
        out[:, axis, 2 * axis] = size[:, axis] * np.cos(phase)
        out[:, axis, 2 * axis + 1] = size[:, axis] * np.sin(phase)
    return out


def _sampled(changes: FloatArray, rows: BasisRows, inside: BoolArray) -> tuple[FloatArray, list[FloatArray]]:
    """Return the changes (2 S, B) of both fluxes at some points, Wb, and their differences along both axes."""
    number = np.cumsum(inside).reshape(inside.shape) - 1
    chosen = np.argwhere(inside)[:: max(1, int(inside.sum()) // _SITES)]

    def at(points: IntArray) -> FloatArray:
        some = number[tuple(points.T)]
        return BasisRows(rows.column[some], rows.value[some]).dot(changes)  # (S, 2, B)

    fluxes, slopes, batches = at(chosen), [], changes.shape[1]
    for step in np.eye(2, dtype=np.int64):
        own = np.flatnonzero((chosen + step < inside.shape).all(axis=1))
        own = own[inside[tuple((chosen[own] + step).T)]]
        slopes.append((at(chosen[own] + step) - fluxes[own]).reshape(-1, batches))
    return fluxes.reshape(-1, batches), slopes


def _causes(samples: FloatArray, most: int) -> FloatArray:
    """Return orthonormal combinations (B, M) of the batches that hold most of the variance of samples (S, B)."""
    wide = samples.shape[1] > samples.shape[0]
    squares, vectors = np.linalg.eigh(samples @ samples.T if wide else samples.T @ samples)
    squares, vectors = np.maximum(squares[::-1], 0.0), vectors[:, ::-1]
    total = max(float(squares.sum()), TINY)
    count = min(most, int(np.searchsorted(np.cumsum(squares), _HELD * total)) + 1, int((squares > 0).sum()))
    vectors = vectors[:, :count]
    return np.asarray(samples.T @ (vectors / np.sqrt(squares[:count])) if wide else vectors)


def _normalized(changes: FloatArray) -> FloatArray:
    return _relative(changes, np.linalg.norm(changes, axis=1))


def _relative(changes: FloatArray, sigma: FloatArray) -> FloatArray:
    return np.asarray(np.divide(changes, sigma[:, None], out=np.zeros_like(changes), where=sigma[:, None] > 0))


def _scaled(modes: FloatArray, sigma: FloatArray) -> FloatArray:
    """Scale modes (..., M) so that their squares add up to those of standard errors (...)."""
    size = np.linalg.norm(modes, axis=-1)
    known = np.isfinite(sigma)
    factor = np.divide(sigma, size, out=np.zeros_like(size), where=known & (size > 0))
    return np.asarray(modes * factor[..., None])
