"""How recordings differ that were added up: the sums of each, projected onto the solution of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drive_id.core.paper.rows import FLUX, RESISTANCE, VOLTAGE, VOLTAGE_ERROR
from drive_id.core.paper.solver import Solution
from drive_id.types import TINY, FloatArray

_TOLERATED = np.array([0.05, 0.03, np.log(1.65)])
"""Differences of psi_d, psi_q and of the logarithm of R that one drive may have besides the errors.

Heat of 50 K takes 5 % of a magnet's flux, which is in psi_d; 130 K add 51 % to R, as method full allows. The rest is
what the model neglects.
"""
_SIGNIFICANT = 6.0
"""Standard errors besides: at low speeds, noise of the currents lowers a flux by up to 5.5 of them."""
_ALIKE = 1.5
"""Ratio of rms currents up to which R is compared: for small ones, most of the voltage is the inverter's."""
_LEAST = 1e-3  # ratio of resistances; what is less, or negative, is another drive in any case


@dataclass(frozen=True, eq=False)
class Differences:
    """What each recording but the first has relative to the first, minus 1: psi_d, psi_q and R."""

    value: FloatArray  # (K - 1, 3)
    sigma: FloatArray  # (K - 1, 3), standard errors; infinite where a recording does not tell

    def of_another_drive(self) -> list[int]:
        """Return the recordings, from 1, that differ by more than heat and the model explain, the worst one first."""
        size = np.abs(self.value)
        ratio = np.maximum(1.0 + self.value[:, 2], _LEAST)
        size[:, 2], error = np.abs(np.log(ratio)), self.sigma.copy()
        error[:, 2] /= ratio
        excess = (size - _SIGNIFICANT * error) / _TOLERATED
        worst = excess.max(axis=1)
        return [int(k) + 1 for k in np.argsort(-worst) if worst[k] > 1.0]


def differences(recordings: Sequence[FloatArray], solution: Solution) -> Differences:
    """Compare recordings by four numbers each: factors on the fluxes of all, R and the inverter's voltage error.

    The rows of a recording are ``v = R q_1 + u_e q_4 + a (Q_2 + Q_3) gamma_d + b (Q_2 + Q_3) gamma_q``, with the flux
    parameters gamma of all recordings. So the map needs no data of its own in each recording, and most errors of the
    model are the same in all and cancel. The voltage error is an unknown for ``psm`` as well, or R would depend on the
    size of the currents.

    Parameters
    ----------
    recordings : sequence of (B, 3 + P, 3 + P) float
        Z'Z per block of time, of each recording.
    solution : Solution
        Of their sum, with the voltage error.
    """
    half = FLUX + len(solution.gamma) // 2
    directions = np.zeros((FLUX + len(solution.gamma), 4))
    directions[FLUX:half, 0], directions[half:, 1] = np.split(solution.gamma, 2)
    directions[RESISTANCE, 2] = directions[VOLTAGE_ERROR, 3] = 1.0
    found = [_estimate(own, directions) for own in recordings]
    value, sigma = (np.array(each)[:, :3] for each in zip(*found, strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = value / value[0]
        error = np.abs(ratio) * np.hypot(sigma / value, sigma[0] / value[0])
    known = np.isfinite(ratio) & np.isfinite(error)
    known[:, 2] &= np.abs(np.log(_currents(recordings))) < np.log(_ALIKE)
    return Differences(np.where(known, ratio - 1.0, 0.0)[1:], np.where(known, error, np.inf)[1:])


def _currents(recordings: Sequence[FloatArray]) -> FloatArray:
    """Return the rms currents (K,), by that of the first: the inverter's shape is nearly 1 at all but small ones."""
    energy = np.array([[own[:, k, k].sum() for k in (RESISTANCE, VOLTAGE_ERROR)] for own in recordings])
    rms: FloatArray = np.maximum(np.sqrt(energy[:, 0] / np.maximum(energy[:, 1], TINY)), TINY)
    return np.asarray(rms / rms[0])


def _estimate(blocks: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares coefficients of the directions (4,), and their errors by a delete-a-block jackknife."""
    projected = blocks @ directions  # (B, 3 + P, 4)
    normal, right = directions.T @ projected, projected[:, VOLTAGE]
    scale = np.sqrt(np.einsum("bkk->k", normal))
    scale[scale == 0.0] = 1.0
    normal, right = normal / (scale * scale[:, None]), right / scale
    whole = np.linalg.lstsq(normal.sum(axis=0), right.sum(axis=0), rcond=None)[0]
    count = len(blocks)
    if count < 2:
        return whole / scale, np.full(len(whole), np.inf)
    without = np.linalg.pinv(normal.sum(axis=0) - normal) @ (right.sum(axis=0) - right)[..., None]
    spread = np.sum((without[..., 0] - whole) ** 2, axis=0) * (count - 1) / count
    return whole / scale, np.sqrt(spread) / scale
