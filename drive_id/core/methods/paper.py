"""Methods ``psm`` and ``joint``: the paper's regression, without and with the inverter's voltage error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.origins import JOINT, PSM
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.maps.continuation import LongerGrid
from drive_id.core.maps.error_modes import ErrorModes, error_modes
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.maps.flux_models import FluxModel
from drive_id.core.methods.method import CURVE_POINTS, Estimate, Limits, check_sums
from drive_id.core.methods.parameters import FitReport
from drive_id.core.paper.recordings import differences
from drive_id.core.paper.regression import RegressionSums
from drive_id.core.paper.rows import VOLTAGE
from drive_id.core.paper.solver import Jackknife, Solution, jackknife, sigma, solve
from drive_id.types import BoolArray, FloatArray

if TYPE_CHECKING:  # takes 0.1 s, which methods psm and joint do without
    from drive_id.core.full.fit import EarlierFit

_AT_A_TIME = 512  # points of the map, which bounds the memory of dense rows
_TANH_REACH = 10.0  # i_s to both sides over which the drop is simulated as a curve: 1 - tanh(10) is 4e-9
_TANH_POINTS = 4001  # of it: linear pieces of 0.005 i_s are off by less than 3e-6 u_e
_LARGE_NOISE = 0.1  # energy that noise adds to the differences of functions, over that of their rotation
_LARGE_ASYMMETRY = 0.1  # over the largest flux
_FEW_BLOCKS = 8  # of which none stands out
_OUTLYING_BLOCK = 10.0  # energy of the residuals of a block that stands out, over the median
_LIMITS = Limits(unexplained=0.6, refused=0.8, mad=np.inf, reversed=0.1)  # noise leaves up to half of it per sample


@dataclass(frozen=True)
class PaperMethod:
    """``eq:ls_regression``, accumulated per block of time."""

    inverter: bool  # whether the voltage error is an unknown
    limits: Limits = _LIMITS

    def conclude(
        self,
        evidence: Evidence,
        inside: BoolArray,
        earlier: EarlierFit | None = None,  # noqa: ARG002  # there is nothing to select
    ) -> Estimate:
        """Solve the regression, continue the map beyond the data and estimate standard errors by the jackknife."""
        information = evidence.information
        assert information is not None
        blocks, total, model = information.blocks, information.total, information.model
        check_sums([total], total[VOLTAGE, VOLTAGE])
        solution = solve(total, information.rows, with_inverter=self.inverter)
        spread = jackknife(blocks, solution)
        grid = evidence.visits.grid()
        psi, error = np.zeros(grid.shape), np.full(grid.shape, np.nan)
        psi[inside] = model.rows(grid[inside]).dot(solution.gamma)
        error[inside] = _sigma(model, spread, grid[inside])
        known = FluxMap.of(evidence.visits.i_d, evidence.visits.i_q, psi, error, inside)
        curve = np.linspace(-evidence.i_max, evidence.i_max, CURVE_POINTS)
        tanh = np.linspace(-_TANH_REACH, _TANH_REACH, _TANH_POINTS)
        scale = evidence.settings.inverter_current_scale
        rms = np.sqrt(total[VOLTAGE, VOLTAGE] / max(information.rows, 1))
        return Estimate(
            resistance=solution.resistance,
            sigma_resistance=sigma(spread.resistance),
            voltage_error=solution.voltage_error,
            sigma_voltage_error=sigma(spread.voltage_error),
            inverter_current=curve,
            inverter_voltage=solution.voltage_error * information.shape(curve),
            flux_map=replace(LongerGrid.around(known).flux_map(), inner=None),
            drop=(scale * tanh, solution.voltage_error * np.tanh(tanh)),
            report=FitReport(
                samples_used=information.rows // 2,
                rows=information.rows,
                parameters=len(solution.columns),
                rank=solution.rank,
                unseen=int((np.diag(total)[-model.parameters :] == 0).sum()),
                condition=solution.condition,
                residual_rms=solution.residual_rms / evidence.sample_period,
            ),
            unexplained=float(solution.residual_rms / rms),
            outlying_time=_outlying_time(blocks, information.block_duration, solution),
            warnings=(
                *self._on_recordings(information, solution),
                *_on_noise(evidence),
                *self._on_inverter(evidence, solution, spread, inside),
            ),
            error_modes=_error_modes(information, spread, grid, inside, error, curve),
            statements=(Message("scatter_only"),),
        )

    def _on_inverter(
        self, evidence: Evidence, solution: Solution, spread: Jackknife, inside: BoolArray
    ) -> Iterator[Message]:
        """Judge the voltage error and the symmetry of the map, which an unmodelled inverter distorts."""
        if not self.inverter:
            return
        if solution.voltage_error < -2 * sigma(spread.voltage_error):
            yield Message("voltage_error_negative", voltage_error=solution.voltage_error)
        assert evidence.information is not None
        asymmetry = mirror_asymmetry(evidence, evidence.information.model, solution.gamma, inside)
        if not any(finding.code == "angle_offset" for finding in evidence.findings) and asymmetry > _LARGE_ASYMMETRY:
            yield Message("mirror_asymmetry", asymmetry=asymmetry)

    def _on_recordings(self, information: RegressionSums, solution: Solution) -> Iterator[Message]:
        """Tell of recordings that cannot be of the drive of the first one."""
        recordings = information.recordings
        if len(recordings) < 2:
            return
        whole = solution if self.inverter else solve(information.total, information.rows, with_inverter=True)
        found = differences(recordings, whole)
        others = found.of_another_drive()
        if not others:
            return
        (d, q, r), (sigma_d, sigma_q, sigma_r) = found.value[others[0] - 1], found.sigma[others[0] - 1]
        told = {"recording": others[0] + 1, "others": len(others) - 1 or None, "d": d, "q": q}
        told |= {"sigma_d": sigma_d, "sigma_q": sigma_q}
        if np.isfinite(sigma_r):
            yield Message("unlike_parts.recording", r=r, sigma_r=sigma_r, **told)
        else:
            yield Message("unlike_parts.flux", **told)


PAPER_METHODS = {origin.name: PaperMethod(origin.inverter) for origin in (PSM, JOINT)}


def _sigma(model: FluxModel, spread: Jackknife, i_dq: FloatArray) -> FloatArray:
    """Return the standard errors of both fluxes (N, 2), Wb, at currents (N, 2), A; infinite where unknown."""
    out = np.full(i_dq.shape, np.inf)
    if not spread.known:
        return out
    for start in range(0, len(i_dq), _AT_A_TIME):
        part = slice(start, start + _AT_A_TIME)
        out[part] = np.linalg.norm(model.rows(i_dq[part]).dense(model.parameters) @ spread.gamma.T, axis=-1)
    return out


def _error_modes(
    information: RegressionSums,
    spread: Jackknife,
    grid: FloatArray,
    inside: BoolArray,
    error: FloatArray,
    current: FloatArray,
) -> ErrorModes | None:
    """Return the joint errors; ``error`` (D, Q, 2) are the standard errors of the fluxes, Wb."""
    if not spread.known:
        return None
    curve = information.shape(current)[:, None] * spread.voltage_error
    others = np.concatenate([spread.resistance[None], spread.voltage_error[None], curve])
    errors = np.linalg.norm(others, axis=1)
    return error_modes(spread.gamma.T, information.model.rows(grid[inside]), error, inside, (others, errors))


def _outlying_time(blocks: FloatArray, duration: float, solution: Solution) -> float | None:
    """Return the middle of the block of time whose residuals stand out, s; None if there is none."""
    residual = np.concatenate(([solution.resistance, solution.voltage_error, -1.0], solution.gamma))
    energy = blocks @ residual @ residual
    moving = blocks[:, VOLTAGE, VOLTAGE] > 0  # at rest there are no residuals, and all else would stand out
    if moving.sum() > _FEW_BLOCKS and energy.max() > _OUTLYING_BLOCK * np.median(energy[moving]):
        return (int(energy.argmax()) + 0.5) * duration
    return None


def _on_noise(evidence: Evidence) -> Iterator[Message]:
    if evidence.noise_share > _LARGE_NOISE:
        yield Message("current_noise", share=evidence.noise_share)


def mirror_asymmetry(evidence: Evidence, model: FluxModel, gamma: FloatArray, inside: BoolArray) -> float:
    """Return how far a map of parameters (P,), Wb, is from psi_d(i_d, -i_q) = psi_d, psi_q(i_d, -i_q) = -psi_q.

    An offset of the angle turns map and currents together, which no voltage shows; in a symmetric machine's map it
    breaks the symmetry.

    It is the larger one of the root mean square differences of both fluxes, over the largest flux. Points without data
    (``inside`` (D, Q)) at their mirror image are skipped; 0 without mirrored points.
    """
    grid = evidence.visits.grid()
    i_dq = grid[inside & (np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max)]
    nearest = [
        np.abs(axis[:, None] - x).argmin(axis=0)
        for axis, x in zip((evidence.visits.i_d, evidence.visits.i_q), (i_dq[:, 0], -i_dq[:, 1]), strict=True)
    ]
    pairs = i_dq[inside[nearest[0], nearest[1]]]
    if not len(pairs):
        return 0.0
    psi = model.rows(pairs).dot(gamma)
    mirrored = model.rows(pairs * [1, -1]).dot(gamma) * [1, -1]
    return float(np.sqrt(np.mean((psi - mirrored) ** 2, axis=0)).max() / np.abs(psi).max())
