"""From accumulated evidence to an identified drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks.radius import check_radius
from drive_id.core.maps.flux_models import FluxModel, TensorSpline, as_tensor_spline, extend
from drive_id.core.numerics.bspline import Axis
from drive_id.core.paper.rows import VOLTAGE
from drive_id.core.paper.solver import Jackknife, Solution, jackknife, sigma, solve
from drive_id.core.result.identification import FitReport, FluxMap, Identification
from drive_id.core.result.warnings import review
from drive_id.core.validation.current_simulation import simulate_current, typical_inductances
from drive_id.core.validation.metrics import mean_absolute_deviation
from drive_id.errors import DataError
from drive_id.types import BoolArray, FloatArray, Samples

_CURVE_POINTS = 201
_WEAK_COEFFICIENT = 0.1
_FINE_COUNT = 24
_AT_A_TIME = 512


def conclude(
    evidence: Evidence, validation: Sequence[Samples], on_map: Callable[[FluxMap], None] = lambda _: None
) -> Identification:
    """Solve for the parameters, draw up the maps and judge them.

    Parameters
    ----------
    evidence : Evidence
        Of all samples.
    validation : sequence of Samples
        Samples whose currents are simulated for the MAD; NaN without any.
    on_map : callable, optional
        Told of the flux map as soon as there is one, its deviations still NaN: what comes then takes its time.

    Returns
    -------
    Identification

    Raises
    ------
    CoverageError, DataError
        When no trustworthy map can come of this evidence.
    """
    information, inside, coverage = evidence.information, evidence.inside(), evidence.coverage()
    check_radius(evidence, coverage)
    total = information.total
    if not (np.isfinite(total).all() and total[VOLTAGE, VOLTAGE] > 0):
        raise DataError(
            "The commanded voltages are zero or equal in all phases, or voltages or currents are beyond all measure: "
            "check their fields and scales."
        )
    if evidence.settings.method == "full":
        from drive_id.core.result.full_conclusion import conclude_full  # noqa: PLC0415  # scipy takes longer than other methods

        return conclude_full(evidence, validation, inside, coverage, on_map)
    solution = solve(total, information.rows, with_inverter=evidence.settings.method == "joint")
    first = _first_map(evidence, solution, inside)
    on_map(first)
    spread = jackknife(information.blocks, solution)
    extended = _extended(evidence, solution, spread, inside)
    flux_map = _flux_map(first, evidence, spread, extended)
    mad = _mad(validation, extended, solution, evidence.settings.inverter_current_scale)
    curve = np.linspace(-evidence.i_max, evidence.i_max, _CURVE_POINTS)
    report = FitReport(
        samples_read=evidence.samples,
        samples_used=information.rows // 2,
        gaps=evidence.gaps,
        rows=information.rows,
        parameters=len(solution.columns),
        rank=solution.rank,
        unseen=int((np.diag(total)[-evidence.model.parameters :] == 0).sum()),
        condition=solution.condition,
        residual_rms=solution.residual_rms / evidence.sample_period,
        mad_d=mad[0],
        mad_q=mad[1],
        coverage=coverage,
        warnings=review(evidence, coverage, solution, spread, flux_map, mad if validation else (0.0, 0.0)),
    )
    return Identification(
        method=evidence.settings.method,
        i_max=evidence.i_max,
        resistance=solution.resistance,
        sigma_resistance=sigma(spread.resistance),
        voltage_error=solution.voltage_error,
        sigma_voltage_error=sigma(spread.voltage_error),
        inverter_current=curve,
        inverter_voltage=solution.voltage_error * information.shape(curve),
        model=evidence.model,
        gamma=solution.gamma,
        flux_map=flux_map,
        report=report,
    )


def _extended(
    evidence: Evidence, solution: Solution, spread: Jackknife, inside: BoolArray
) -> tuple[TensorSpline, FloatArray]:
    """Return the map as splines with sane values beyond the data."""
    model, gamma = evidence.model, solution.gamma
    i_dq = evidence.visits.grid()[inside]
    if not isinstance(model, TensorSpline):
        finer = (Axis(axis.low, axis.high, max(axis.count, _FINE_COUNT)) for axis in (evidence.d, evidence.q))
        spline, coefficients = as_tensor_spline(model, gamma, *finer)
        weak = np.ones(len(coefficients), np.bool_)
        weak[spline.rows(i_dq).column] = False
        return spline, extend(spline, coefficients, weak, typical_inductances(spline, coefficients, i_dq))
    largest = np.abs(model.rows(i_dq).dot(gamma)).max()
    uncertain = np.sqrt(np.sum(spread.gamma**2, axis=0)) > _WEAK_COEFFICIENT * largest
    weak = (gamma == 0) | (uncertain if spread.known else False)
    return model, extend(model, gamma, weak, typical_inductances(model, gamma, i_dq))


def _first_map(evidence: Evidence, solution: Solution, inside: BoolArray) -> FluxMap:
    """Return the map as it was fitted, without deviations."""
    grid = evidence.visits.grid()
    psi = evidence.model.rows(grid.reshape(-1, 2)).dot(solution.gamma).reshape(grid.shape)
    unknown = np.full(inside.shape, np.nan)
    return FluxMap(evidence.visits.i_d, evidence.visits.i_q, psi[..., 0], psi[..., 1], unknown, unknown, inside)


def _flux_map(
    first: FluxMap, evidence: Evidence, spread: Jackknife, extended: tuple[TensorSpline, FloatArray]
) -> FluxMap:
    """Return the map with sane values beyond the data, and with deviations where there are data."""
    grid, inside = first.grid(), first.inside
    psi = np.stack([first.psi_d, first.psi_q], axis=-1)
    psi[~inside] = extended[0].rows(grid[~inside]).dot(extended[1])
    deviation = np.full(grid.shape, np.nan)
    deviation[inside] = _deviation(evidence.model, spread, grid[inside])
    return replace(first, psi_d=psi[..., 0], psi_q=psi[..., 1], sigma_d=deviation[..., 0], sigma_q=deviation[..., 1])


def _deviation(model: FluxModel, spread: Jackknife, i_dq: FloatArray) -> FloatArray:
    """Return the deviations of both fluxes (N, 2), Wb, at currents (N, 2), A; infinite where they are not known."""
    out = np.full(i_dq.shape, np.inf)
    if not spread.known:
        return out
    for start in range(0, len(i_dq), _AT_A_TIME):
        part = slice(start, start + _AT_A_TIME)
        out[part] = np.linalg.norm(model.rows(i_dq[part]).dense(model.parameters) @ spread.gamma.T, axis=-1)
    return out


def _mad(
    validation: Sequence[Samples], flux: tuple[TensorSpline, FloatArray], solution: Solution, current_scale: float
) -> tuple[float, float]:
    if not validation:
        return float("nan"), float("nan")
    drop = (solution.voltage_error, current_scale)
    simulated = [simulate_current(samples, *flux, solution.resistance, *drop) for samples in validation]
    measured = [frames.to_dq(samples.i_abc, samples.angle) for samples in validation]
    return mean_absolute_deviation(np.concatenate(simulated), np.concatenate(measured))
