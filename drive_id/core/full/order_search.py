"""Harmonics of the rotor position: which ones samples can separate, which are significant, and which are missing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from drive_id.core.full.model import FullModel
from drive_id.core.full.solver import FullSolution
from drive_id.core.full.windows import Windows
from drive_id.types import TINY, FloatArray

HIGHEST_ORDER = 48
"""Up to which harmonics are searched: bounds the time; those of two and three slots per pole and phase lie below."""

_ORDER_SIGNIFICANCE = 2.0
"""Mean square of a harmonic's amplitudes, relative to their variances: 1 for an absent one."""
_LEAST_HARMONIC = 1e-4
"""Rms amplitude relative to the largest flux: without noise, the misfit of the inverter's curve looks like less."""
_COINCIDENCE = 0.1
"""Orders by which two harmonics, as the samples see them, may differ and still be one within a record."""
_LEAST_SHARE = 0.03
"""Share of the squared residuals that a further harmonic must explain: by chance, its 12 unknowns explain 0.004."""
_ABOVE_OTHERS = 6.0
"""The same relative to the median over all orders: a broad misfit is explained by none of them."""


def distinct_orders(orders: Iterable[int], turn: float) -> tuple[int, ...]:
    """Return the harmonics that samples ``turn`` rad apart (rms) can separate from lower ones and from the map.

    The angles are known, so only an exact coincidence confounds two orders: with N samples per turn, h and k look the
    same where h + k or h - k is a multiple of N.
    """
    samples_per_turn = 2 * np.pi / max(turn, 1e-6)
    distinct: list[int] = []
    for order in sorted(orders):
        sums = np.array([order + sign * lower for lower in (0, *distinct) for sign in (-1, 1)]) / samples_per_turn
        multiple = np.rint(sums)
        if not np.any((multiple >= 1) & (np.abs(sums - multiple) * samples_per_turn < _COINCIDENCE)):
            distinct.append(order)
    return tuple(distinct)


def significant_orders(model: FullModel, solution: FullSolution, i_dq: FloatArray) -> tuple[int, ...]:
    """Return the harmonics whose amplitudes differ from zero by more than the noise explains.

    The mean square of the estimated amplitudes over their variances is 1 for an absent harmonic. Without noise, the
    misfit of the inverter curve appears as a harmonic of less than 1e-4 of the flux.
    """
    significant, largest = [], float(np.abs(model.flux.rows(i_dq).dot(solution.estimate[model.map])).max())
    for order in solution.spec.orders:
        columns = np.arange(model.harmonics[order].start, model.harmonics[order].stop)
        halves = [model.harmonic.rows(i_dq).dot(half) for half in np.split(solution.estimate[columns], 2)]
        if np.sqrt(np.mean(np.square(halves))) < _LEAST_HARMONIC * largest:
            continue
        unknowns = np.flatnonzero(np.asarray(abs(solution.basis[columns]).sum(axis=0)).ravel())
        half = solution.half_gain(np.eye(solution.basis.shape[1])[:, unknowns])
        covariance = solution.residual_rms**2 * (half.T @ half)
        estimate = np.linalg.lstsq(solution.basis[columns][:, unknowns].toarray(), solution.estimate[columns])[0]
        scale = np.sqrt(np.diag(covariance))
        values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
        usable = values > 1e-9 * values[-1]
        square = (vectors[:, usable].T @ (estimate / scale)) ** 2 / values[usable]
        if np.mean(square) > _ORDER_SIGNIFICANCE:
            significant.append(order)
    return tuple(significant)


def explained_shares(model: FullModel, estimate: FloatArray, kept: Sequence[Windows]) -> FloatArray:
    """Return which share of the squared residuals a harmonic of each order 1 to ``HIGHEST_ORDER`` would explain.

    The complex amplitudes are linear in the current, ``A + B i_d + C i_q`` for ``e^{+j h theta}`` and
    ``e^{-j h theta}`` each.

    Parameters
    ----------
    estimate : (size,) float
        See :class:`~drive_id.core.full.solver.FullSolution`.
    """
    windows = Windows.joined(list(kept)).scattered()
    left = model.residuals(windows, estimate)
    error = left[:, 0] + 1j * left[:, 1]
    currents = np.concatenate([np.ones((len(windows), 2, 1)), windows.i_dq / model.i_max], axis=2)
    turned = np.sqrt(windows.weights)[:, None, None] * np.exp(1j * windows.angle)[..., None] * currents  # (N, end, 3)
    step, phase = np.exp(1j * windows.angle), np.ones((len(windows), 2), np.complex128)
    shares = np.empty(HIGHEST_ORDER)
    for order in range(HIGHEST_ORDER):
        phase = phase * step
        both = np.concatenate([turned * phase[..., None], turned * phase.conj()[..., None]], axis=2)
        regressors = both[:, 1] - both[:, 0]
        moment, gram = regressors.conj().T @ error, regressors.conj().T @ regressors
        found = np.linalg.lstsq(gram, moment, rcond=1e-10)[0]
        shares[order] = float((moment.conj() @ found).real)
    return np.asarray(shares / max(float(np.sum(np.abs(error) ** 2)), TINY))


def unexpected_orders(
    model: FullModel, estimate: FloatArray, kept: Sequence[Windows], known: Sequence[int]
) -> tuple[int, ...]:
    """Return the orders, not in ``known``, that explain clearly more than noise does, strongest first.

    The other arguments are those of :func:`explained_shares`.
    """
    shares = explained_shares(model, estimate, kept)
    least = max(_LEAST_SHARE, _ABOVE_OTHERS * float(np.median(shares)))
    strongest = 1 + np.argsort(shares)[::-1]
    return tuple(int(order) for order in strongest if shares[order - 1] > least and order not in known)
