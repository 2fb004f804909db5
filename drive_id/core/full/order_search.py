"""Harmonics of the rotor position that nobody thought of, found in what a fit leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drive_id.core.full.model import FullModel
from drive_id.core.full.windows import Windows
from drive_id.types import FloatArray

HIGHEST_ORDER = 48
_MOST_WINDOWS = 1500
_LEAST_SHARE = 0.03
_ABOVE_OTHERS = 6.0


def explained_shares(model: FullModel, residual: FloatArray, kept: Sequence[Windows], highest: int) -> FloatArray:
    """Return what share of the squared residuals a harmonic of each order 1 to ``highest`` would take away.

    The amplitudes are taken as linear in the current, ``A + B i_d + C i_q`` for ``e^{+j h theta}`` and
    ``e^{-j h theta}`` each, all of them complex.

    Parameters
    ----------
    model : FullModel
    residual : (size,) float
        r with ``Z r`` the residuals, see :class:`~drive_id.core.full.solver.FullSolution`.
    kept : sequence of Windows
    highest : int

    Returns
    -------
    (highest,) float
    """
    windows = Windows.joined(list(kept))
    windows = windows.part(np.arange(0, len(windows), -(-len(windows) // _MOST_WINDOWS)))
    left = model.design(windows) @ residual
    error = left[:, 0] + 1j * left[:, 1]
    currents = np.concatenate([np.ones((len(windows), 2, 1)), windows.i_dq / model.i_max], axis=2)
    turned = np.exp(1j * windows.angle)[..., None] * currents  # (N, end, 3)
    step, phase = np.exp(1j * windows.angle), np.ones((len(windows), 2), np.complex128)
    shares = np.empty(highest)
    for order in range(highest):
        phase = phase * step
        both = np.concatenate([turned * phase[..., None], turned * phase.conj()[..., None]], axis=2)
        regressors = both[:, 1] - both[:, 0]
        moment, gram = regressors.conj().T @ error, regressors.conj().T @ regressors
        found = np.linalg.lstsq(gram, moment, rcond=1e-10)[0]
        shares[order] = float((moment.conj() @ found).real)
    return np.asarray(shares / max(float(np.sum(np.abs(error) ** 2)), np.finfo(np.float64).tiny))


def unexpected_orders(
    model: FullModel, residual: FloatArray, kept: Sequence[Windows], known: Sequence[int], highest: int
) -> tuple[int, ...]:
    """Return orders up to ``highest``, not among ``known``, that explain clearly more than noise does, strongest first.

    The arguments are those of :func:`explained_shares`.
    """
    shares = explained_shares(model, residual, kept, highest)
    least = max(_LEAST_SHARE, _ABOVE_OTHERS * float(np.median(shares)))
    strongest = 1 + np.argsort(shares)[::-1]
    return tuple(int(order) for order in strongest if shares[order - 1] > least and order not in known)
