"""From the fit of operating points to an identified drive: map, curve, report and sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from drive_id.common.messages import Message
from drive_id.common.origins import STATIC
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full.effects.effect import Calibration
from drive_id.core.maps.coverage import disc_coverage
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.maps.support import Support
from drive_id.core.methods.method import CURVE_POINTS
from drive_id.core.methods.parameters import FitReport
from drive_id.core.result.identification import IdentifiedDrive, LinearMachine
from drive_id.core.steady.effects import DELAY, IRON_LOSS
from drive_id.core.steady.fit import (
    DISTINCT,
    MAP_POINTS,
    REACH,
    StaticFit,
    distinct_currents,
    distinct_speeds,
    fit_points,
    scales,
    turning,
)
from drive_id.core.steady.operating_points import OperatingPoints
from drive_id.errors import UnexplainedError
from drive_id.types import BoolArray, FloatArray

_THIN = 0.01
"""Width of the points, by their length, up to which they count as on a line."""
_NO_INFORMATION = 2.0
"""Standard error, by what voltages and currents suggest, from which a quantity counts as unknown."""
_REFUSED = 0.2
"""Share of the voltage that the model leaves, beyond which there is no map: as for method full."""
_WRONG_SIGN = 4.0  # standard errors below zero of a mean slope that no machine has
_LARGE_MISFIT = 1.5  # rms of the residuals over the noise of the points
_VAGUE_RESISTANCE = 0.1  # standard error of R, relative
_FEW_COVERED = 0.45  # share of the disc


def identify_static(points: OperatingPoints, settings: FitSettings) -> IdentifiedDrive:
    """Identify a drive from operating points.

    Raises StandstillError, CoverageError, UnexplainedError when these points cannot give a trustworthy result.
    """
    i_max = settings.i_max or points.i_max
    fit = fit_points(points, i_max, max(settings.u_dc) if settings.u_dc else None)
    _refuse(fit)
    axis = np.linspace(-REACH * i_max, REACH * i_max, settings.grid_points)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    inside = supported(fit, axis)
    psi, sigma = (values.reshape(grid.shape) for values in fit.flux(grid.reshape(-1, 2)))
    sigma = np.where(inside[..., None], sigma, np.nan)
    coverage = disc_coverage(axis, axis, inside, i_max)
    resistance, sigma_resistance = fit.coefficient(0)
    ohm, _ = scales(fit.points)
    error, sigma_error = fit.coefficient(-1)
    current = np.linspace(-i_max, i_max, CURVE_POINTS)
    drop, sigma_drop = fit.drop_curve(current)
    linear = _linear(fit)
    unknown = not sigma_resistance < _NO_INFORMATION * ohm
    report = FitReport(
        samples_read=points.samples,
        samples_used=int(fit.points.count.sum()),
        rows=2 * len(fit.points),
        parameters=len(fit.posterior.mean),
        rank=len(fit.posterior.mean),
        condition=fit.condition,
        residual_rms=float(np.sqrt(np.mean(fit.residual**2))),
        coverage=coverage,
        warnings=tuple(_warnings(fit, coverage, i_max)),
    )
    return IdentifiedDrive(
        method=STATIC.name,
        i_max=i_max,
        resistance=resistance,
        sigma_resistance=float("inf") if unknown else sigma_resistance,
        voltage_error=error,
        sigma_voltage_error=sigma_error,
        inverter_current=current,
        inverter_voltage=drop,
        flux_map=FluxMap.of(axis, axis, psi, sigma, inside),
        report=report,
        sigma_inverter_voltage=sigma_drop,
        calibrations=_calibrations(fit),
        statements=tuple(_statements(fit, linear, points)),
        linear=linear,
    )


def _calibrations(fit: StaticFit) -> tuple[Calibration, ...]:
    """Return the iron loss, if it was fitted, under its name in method full; the map is without its current."""
    if IRON_LOSS not in fit.effects:
        return ()
    value, spread = fit.coefficient(1 + fit.effects.index(IRON_LOSS))
    said = Message("iron_loss_conductance.points", value=value, sigma=spread)
    return (Calibration("iron_loss_conductance", value, spread, "S", True, said),)


def supported(fit: StaticFit, axis: FloatArray) -> BoolArray:
    """Tell (D, D) at which nodes of equal axes the points support the map: in their hull, and in no large hole.

    The points count on both sides of the d axis. To an affine machine, zero current belongs, and holes do not matter.
    Points on a line support the nodes on it.
    """
    points = fit.points.i_dq[turning(fit.points)]
    points = np.vstack([points, points * [1.0, -1.0]])
    if not fit.maps:
        points = np.vstack([points, np.zeros((1, 2))])
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] > _THIN * spread[0]:
        support = Support.of(points)
        inside = support.contains(grid) if fit.maps else support.in_hull(grid)
    else:
        steps = np.linspace(points.min(axis=0), points.max(axis=0), 4 * len(axis))
        near, _ = cKDTree(steps).query(grid)
        inside = near <= (axis[1] - axis[0]) / 2 * (1 + 1e-6)
    return np.asarray(inside.reshape(len(axis), len(axis)))


def _linear(fit: StaticFit) -> LinearMachine:
    """Return magnet flux and inductances at zero current, or of the affine machine."""
    step = 1e-3 * fit.points.i_max
    rows = fit.basis.rows(step * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]))
    wanted = np.stack([rows[0, 0], (rows[1, 0] - rows[2, 0]) / (2 * step), (rows[3, 1] - rows[4, 1]) / (2 * step)])
    value, sigma = fit.of(wanted)
    _, henry = scales(fit.points)
    known = sigma < _NO_INFORMATION * henry * np.array([fit.points.i_max, 1.0, 1.0])
    sigma = np.where(known, sigma, np.inf)
    return LinearMachine(*(float(x) for pair in zip(value, sigma, strict=True) for x in pair))


def _refuse(fit: StaticFit) -> None:
    """Refuse a fit that explains too little, or whose fluxes fall with their currents."""
    share = float(np.sqrt(np.mean(fit.residual**2) / np.mean(fit.points.u_dq**2)))
    if share > _REFUSED:
        raise UnexplainedError(Message("unexplained.static", unexplained=share))
    step = 1e-3 * fit.points.i_max
    i_dq = fit.points.i_dq[turning(fit.points)]
    for name, unit, axis in (("d", [step, 0.0], 0), ("q", [0.0, step], 1)):
        rows = (fit.basis.rows(i_dq + unit) - fit.basis.rows(i_dq - np.array(unit)))[:, axis].mean(axis=0) / (2 * step)
        slope, sigma = fit.of(rows)
        if slope < -_WRONG_SIGN * sigma:
            raise UnexplainedError(Message("falling_flux", axis=name, inductance=float(slope)))


def _warnings(fit: StaticFit, coverage: float, i_max: float) -> Iterator[Message]:
    resistance, sigma = fit.coefficient(0)
    error, sigma_error = fit.coefficient(-1)
    if fit.outlying:
        yield Message("outlying_points", points=fit.outlying)
    if resistance < -2 * sigma:
        yield Message("resistance_negative", resistance=resistance, sigma_resistance=sigma)
    if error < -2 * sigma_error:
        yield Message("drop_negative", voltage_error=error)
    if fit.misfit > _LARGE_MISFIT:
        share = np.sqrt(np.mean(fit.residual**2) / np.mean(fit.points.u_dq**2))
        yield Message("misfit.points", ratio=fit.misfit, share=share, maps=fit.maps)
    if fit.maps and coverage < _FEW_COVERED:
        yield Message("little_coverage.points", coverage=coverage, i_max=i_max)
    if DELAY in fit.effects:
        delay, spread = fit.coefficient(1 + fit.effects.index(DELAY))
        yield Message("compensated_late", delay=delay, sigma=spread)
    if fit.basis.odd:
        psi, _ = fit.flux(np.zeros((1, 2)))
        yield Message("mirror_asymmetry.points", flux=psi[0, 1], angle=np.arctan2(psi[0, 1], psi[0, 0]))


def _statements(fit: StaticFit, linear: LinearMachine, points: OperatingPoints) -> Iterator[Message]:
    used = fit.points
    averaged = {"samples": points.samples, "used": used.count.sum()} if points.covariance is not None else {}
    yield Message(
        "operating_points" if fit.maps else "operating_points.linear",
        points=len(used),
        distinct=len(distinct_currents(used.i_dq[turning(used)], DISTINCT * used.i_max)),
        needed=MAP_POINTS,
        **averaged,
    )
    sigmas = (("psi_PM", linear.sigma_psi_pm), ("L_d", linear.sigma_l_d), ("L_q", linear.sigma_l_q))
    if unknown := [name for name, sigma in sigmas if not np.isfinite(sigma)]:
        yield Message("undetermined", names=" and ".join(unknown))
    if len(distinct_speeds(used)) == 1:
        yield Message("one_speed.points")
    if fit.coefficient(-1)[1] > fit.shapes.usual / 2:
        yield Message("drop_assumed", drop=fit.shapes.usual)
    elif fit.coefficient(0)[1] > _VAGUE_RESISTANCE * abs(fit.coefficient(0)[0]):
        yield Message("resistance_inaccurate")
    yield from (entry.message for entry in _calibrations(fit))
    if used.winding_temperature is not None:
        yield Message("resistance_at_20")
