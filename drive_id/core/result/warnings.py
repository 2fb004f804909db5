"""What a fit's reader must be told: sentences on data that are weak and on models that do not hold."""

from __future__ import annotations

import numpy as np

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks.radius import radius_warnings
from drive_id.core.maps.flux_models import FluxModel
from drive_id.core.paper.rows import VOLTAGE
from drive_id.core.paper.solver import Jackknife, Solution, sigma
from drive_id.core.result.identification import FluxMap
from drive_id.types import BoolArray, FloatArray

_WEAK_FIT = 0.15
_LARGE_NOISE = 0.1
_LARGE_ASYMMETRY = 0.1
_FEW_POINTS = 0.005
_FEW_BLOCKS = 8
_OUTLYING_BLOCK = 10.0
_ZERO_SEQUENCE_SHARE = 0.02


def review(
    evidence: Evidence,
    coverage: float,
    solution: Solution,
    spread: Jackknife,
    flux_map: FluxMap,
    mad: tuple[float, float],
) -> tuple[str, ...]:
    """Return whole sentences on what is weak, most basic first."""
    return (*on_data(evidence, coverage), *_on_model(evidence, solution, spread, flux_map, mad))


def on_data(evidence: Evidence, coverage: float) -> list[str]:
    """Return sentences on what is weak about the samples, whatever is fitted to them."""
    warnings = []
    if evidence.zero_sequence > _ZERO_SEQUENCE_SHARE * evidence.i_max:
        warnings.append(
            f"The phase currents sum to {evidence.zero_sequence:.3g} A rms instead of zero: check gains and offsets of "
            "the current sensors."
        )
    warnings += radius_warnings(evidence, coverage)
    if evidence.noise_share > _LARGE_NOISE and evidence.settings.method != "full":
        warnings.append(
            f"The noise of the currents is large for this speed ({100 * evidence.noise_share:.0f} % of what the "
            "rotation shows), which biases the maps: record faster, or with less noise."
        )
    return warnings


def _on_model(
    evidence: Evidence, solution: Solution, spread: Jackknife, flux_map: FluxMap, mad: tuple[float, float]
) -> list[str]:
    warnings = [*_on_resistance(solution, spread), *_on_map(evidence, solution, flux_map)]
    rows = max(evidence.information.rows, 1)
    share = solution.residual_rms / np.sqrt(evidence.information.total[VOLTAGE, VOLTAGE] / rows)
    if share > _WEAK_FIT:
        warnings.append(
            f"The model leaves {100 * share:.1f} % of the voltage unexplained: check the order of the phases, the "
            "alignment of the signals in time, and their noise."
        )
    energy = _residual_energies(evidence, solution)
    moving = evidence.information.blocks[:, VOLTAGE, VOLTAGE] > 0  # at rest nothing is left, and all else stands out
    if moving.sum() > _FEW_BLOCKS and energy.max() > _OUTLYING_BLOCK * np.median(energy[moving]):
        at = (int(energy.argmax()) + 0.5) * evidence.information.block_duration
        warnings.append(
            f"The samples around {at:.2f} s of data stand out from all others: look there for a faulty angle, voltage "
            "or current."
        )
    if not np.isfinite(mad).all():
        warnings.append(
            "The simulated current diverged, so there is no MAD, and the identified model is not stable: check the "
            "order of the phases and the angle."
        )
    return warnings


def _on_resistance(solution: Solution, spread: Jackknife) -> list[str]:
    warnings = []
    uncertainty = sigma(spread.resistance)
    if not np.isfinite(uncertainty):
        warnings.append("The recording is too short to state deviations: record longer.")
    elif solution.resistance < -2 * uncertainty:
        warnings.append(
            f"The resistance is negative ({solution.resistance:.4g} ohm): currents or voltages have the wrong sign, or "
            "are shifted in time."
        )
    elif not solution.resistance > 2 * uncertainty:
        warnings.append(
            f"The resistance, {solution.resistance:.4g} ohm, is not distinct from zero (deviation {uncertainty:.2g} "
            "ohm): record slower or at several speeds."
        )
    if solution.voltage_error < -2 * sigma(spread.voltage_error):
        warnings.append(
            f"The voltage error is negative ({solution.voltage_error:.3g} V): the inverter is over-compensated, or "
            "commanded voltages and currents are not of the same instant."
        )
    return warnings


def _on_map(evidence: Evidence, solution: Solution, flux_map: FluxMap) -> list[str]:
    warnings: list[str] = []
    i_dq = flux_map.grid()[flux_map.inside]
    i_dq = i_dq[np.hypot(*i_dq.T) <= evidence.i_max]
    if not len(i_dq):
        return warnings
    active = active_points(evidence.model, solution, i_dq)
    if active.mean() > _FEW_POINTS:
        d, q = i_dq[active].mean(axis=0)
        warnings.append(
            f"The inductance matrix is not positive definite at {active.sum()} of {len(i_dq)} points of the map, on "
            f"average at i_d = {d:.3g} A, i_q = {q:.3g} A: do not simulate or control with the map there."
        )
    asymmetry = mirror_asymmetry(evidence, solution, i_dq)
    if asymmetry > _LARGE_ASYMMETRY and evidence.settings.method != "psm":  # there, the inverter distorts the map
        warnings.append(
            f"The map deviates by {100 * asymmetry:.0f} % from being mirror-symmetric in i_q: the angle is offset, the "
            "phases are shifted, or the machine is asymmetric."
        )
    origin = evidence.model.rows(i_dq[[np.hypot(*i_dq.T).argmin()]]).dot(solution.gamma)[0]
    if origin[0] < -_LARGE_ASYMMETRY * np.abs(flux_map.psi_d[flux_map.inside]).max():
        warnings.append(
            f"The magnet's flux is negative ({origin[0]:.4g} Wb): the angle is offset by half a turn, or currents and "
            "voltages have the wrong sign."
        )
    return warnings


def active_points(model: FluxModel, solution: Solution, i_dq: FloatArray) -> BoolArray:
    """Tell (N,) where the symmetric part of the Jacobian D_f at currents (N, 2), A, is not positive definite."""
    by_d, by_q = (rows.dot(solution.gamma) for rows in model.slope_rows(i_dq))
    cross = 0.5 * (by_d[:, 1] + by_q[:, 0])
    return np.asarray((by_d[:, 0] <= 0) | (by_d[:, 0] * by_q[:, 1] <= cross**2))


def mirror_asymmetry(evidence: Evidence, solution: Solution, i_dq: FloatArray) -> float:
    """Return how far a map is from psi_d(i_d, -i_q) = psi_d, psi_q(i_d, -i_q) = -psi_q.

    An offset of the angle turns map and currents together, which no voltage shows; of a symmetric machine it breaks the
    symmetry.

    Parameters
    ----------
    evidence : Evidence
    solution : Solution
    i_dq : (N, 2) float
        Points with data, A; those whose mirror image has no data are left out.

    Returns
    -------
    float
        Root mean square of the larger of both deviations over the largest flux; 0 without any pair of points.
    """
    nearest = [
        np.abs(axis[:, None] - x).argmin(axis=0)
        for axis, x in zip((evidence.visits.i_d, evidence.visits.i_q), (i_dq[:, 0], -i_dq[:, 1]), strict=True)
    ]
    pairs = i_dq[evidence.inside()[nearest[0], nearest[1]]]
    if not len(pairs):
        return 0.0
    psi = evidence.model.rows(pairs).dot(solution.gamma)
    mirrored = evidence.model.rows(pairs * [1, -1]).dot(solution.gamma) * [1, -1]
    return float(np.sqrt(np.mean((psi - mirrored) ** 2, axis=0)).max() / np.abs(psi).max())


def _residual_energies(evidence: Evidence, solution: Solution) -> FloatArray:
    """Return the squared residuals of each block of time, (Vs)^2."""
    residual = np.concatenate(([solution.resistance, solution.voltage_error, -1.0], solution.gamma))
    return np.asarray(evidence.information.blocks @ residual @ residual)
