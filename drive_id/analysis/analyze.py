"""Compute trajectories, limits, maps and controller gains from an identified drive, with standard errors."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from drive_id.analysis.bands import combined
from drive_id.analysis.field_weakening import DriveLimits, corner_speed, envelope, references, sigma_envelope, top_speed
from drive_id.analysis.folder import Analysis, Figure, SpeedRange
from drive_id.analysis.machine import MachineModel
from drive_id.analysis.maps import CurrentMaps
from drive_id.analysis.operation import Operation, OperationErrors, changes
from drive_id.analysis.settings import AnalysisSettings
from drive_id.analysis.trajectories import CurrentLocus, characteristic_current, mtpa, mtpa_angle_changes, mtpv
from drive_id.common.arguments import expect
from drive_id.common.messages import Message
from drive_id.common.temperature import REFERENCE_TEMPERATURE
from drive_id.errors import ConfigurationError, DataError
from drive_id.result.result import Result

_RPM = math.pi / 30  # rad/s
_FURTHEST = 4.0  # largest current of an analysis relative to that of the map
_LEAST_TORQUE = 1e-4  # at i_max, of the product of flux and current: less counts as none
_MOST_FALLING = 0.5  # share of the points with data at which a flux may fall with its own current
_BEYOND = 0.05  # share by which the last speed must be exceeded if it is only the end of the tables
_TURN = 1e-4  # of a current, for the voltage's slope along its circle, rad
_ROUNDS, _FINER = 4, 8
"""How often, and into how many speeds, those around the largest power are divided: at 31 speeds of the tables, it was
0.2 % short, and moved with them by up to six of its standard errors."""
_WEAKENING = 4.0  # highest speed of the tables, in corner speeds


def analyze(result: Result | str | Path, settings: AnalysisSettings | None = None) -> Analysis:
    """Compute what the control of an identified drive needs.

    Parameters
    ----------
    result : Result or path
        Of a fit, loaded, imported, or the result folder.
    settings : AnalysisSettings, optional

    Returns
    -------
    Analysis

    Raises
    ------
    ConfigurationError
        When the pole pairs are neither in the result nor in the settings, or i_max is far beyond the map. Without a
        DC-link voltage there are no figures and tables over speed.
    ResultError
        When the folder cannot be read.
    DataError
        When the map has hardly any data, or gives no torque.
    """
    found = result if isinstance(result, Result) else Result.load(result)
    chosen = AnalysisSettings() if settings is None else settings
    expect(chosen, AnalysisSettings, "settings", "give drive_id.AnalysisSettings(temperature=..., ...)")
    model = MachineModel.of(
        found,
        temperature=chosen.temperature,
        magnet_temperature=chosen.magnet_temperature,
        pole_pairs=chosen.pole_pairs,
        u_dc=chosen.u_dc[0] if chosen.u_dc else None,
    )
    model.known_pole_pairs()
    voltages = chosen.u_dc or (() if model.u_dc is None else (model.u_dc,))
    i_max = chosen.i_max or found.i_max
    if i_max > _FURTHEST * found.i_max:
        raise ConfigurationError(
            f"i_max is {i_max:.4g} A, but the map reaches {found.i_max:.4g} A: choose at most {_FURTHEST:g} times "
            "that, for beyond it nothing is known."
        )
    at_most = mtpa(model, i_max, chosen.current_points)
    _check(model, found, at_most, i_max)
    beyond = mtpv(model, i_max, chosen.current_points)
    limits = [DriveLimits(i_max, chosen.modulation * u_dc / math.sqrt(3)) for u_dc in voltages]
    ranges = tuple(_speed_range(model, chosen, u_dc, limit) for u_dc, limit in zip(voltages, limits, strict=True))
    maps = CurrentMaps.of(model, found.flux_map.i_d, found.flux_map.i_q, chosen.bandwidth)
    return Analysis(
        result=found,
        settings=chosen,
        model=model,
        figures=_figures(model, found, at_most, ranges, chosen),
        mtpa=at_most,
        mtpv=beyond,
        speed_ranges=ranges,
        maps=maps,
        compensation=found.inverter_curve,
        statements=_statements(model, found, i_max, at_most, beyond, ranges),
    )


def _check(model: MachineModel, found: Result, at_most: CurrentLocus, i_max: float) -> None:
    """Refuse maps of the wrong sign or order of axes, and machines without torque."""
    grid = found.flux_map.grid()[found.flux_map.inside]
    slopes = model.inductances(grid[:, 0], grid[:, 1])
    falling = float(np.mean((slopes[:, 0, 0] <= 0) | (slopes[:, 1, 1] <= 0)))
    if falling > _MOST_FALLING:
        raise DataError(
            f"The flux falls with its own current at {100 * falling:.0f} % of the points with data: check the signs "
            "and the order of the map's axes."
        )
    largest = 1.5 * model.known_pole_pairs() * float(np.hypot(at_most.psi_d, at_most.psi_q).max()) * i_max
    if not at_most.torque[-1] > _LEAST_TORQUE * largest:
        raise DataError(f"No current up to {i_max:.4g} A gives a torque with this map: check the map and i_max.")


def _speed_range(model: MachineModel, settings: AnalysisSettings, u_dc: float, limits: DriveLimits) -> SpeedRange:
    corner = corner_speed(model, limits)
    if settings.speed is not None:
        highest = settings.speed * _RPM
    else:
        usual = limits.u_max / max(float(np.hypot(*model.psi_dq(0.0, 0.0))) * model.known_pole_pairs(), 1e-9)
        highest = top_speed(model, limits, _WEAKENING * (corner or min(usual, 1e4)))
    speed = np.linspace(0.0, highest, settings.speed_points)
    with_corner = np.unique(np.append(speed, corner)) if 0 < corner < highest else speed
    motoring, braking = (envelope(model, limits, with_corner, sign=sign) for sign in (1.0, -1.0))
    largest = np.nanmax(np.abs([motoring.torque, braking.torque]), initial=0.0)
    requested = largest * np.arange(-settings.torque_points, settings.torque_points + 1) / settings.torque_points
    rows = np.isin(with_corner, speed)
    table = references(model, limits, requested, motoring.chosen(rows), braking.chosen(rows))
    return SpeedRange(
        u_dc=u_dc,
        limits=limits,
        corner=corner,
        motoring=motoring,
        braking=braking,
        sigma_torque=sigma_envelope(model, limits, motoring),
        requested=requested,
        references=table,
        errors=OperationErrors.of(model, table),
    )


def _figures(
    model: MachineModel,
    found: Result,
    at_most: CurrentLocus,
    ranges: tuple[SpeedRange, ...],
    settings: AnalysisSettings,
) -> dict[str, Figure]:
    zero = bool(model.inside(0.0, 0.0))
    slopes, errors = model.inductances(0.0, 0.0), model.sigma_inductances(0.0, 0.0)
    gains = model.control_inductances(0.0, 0.0)
    sigma_magnet = np.nan
    if model.errors is not None and zero:
        sigma_magnet = float(np.linalg.norm(model.errors.fluxes(np.zeros(()), np.zeros(()))[:, 0]))
    size, sigma_size, known = characteristic_current(model)
    angle, last = np.arctan2(at_most.i_q[-1], at_most.i_d[-1]), at_most.inside[-1]
    factor = model.resistance / found.resistance if found.resistance else 1.0
    rate = 2 * math.pi * settings.bandwidth
    return {
        "resistance": Figure.of(model.resistance, factor * found.sigma_resistance, "ohm", inside=True),
        "magnet_flux": Figure.of(model.psi_dq(0.0, 0.0)[0], sigma_magnet, "Wb", zero),
        "L_dd": Figure.of(slopes[0, 0], errors[0, 0], "H", zero),
        "L_qq": Figure.of(slopes[1, 1], errors[1, 1], "H", zero),
        "saliency": Figure.of(slopes[1, 1] / slopes[0, 0], _sigma_saliency(model) if zero else np.nan, "1", zero),
        "characteristic_current": Figure.of(size, sigma_size, "A", known),
        "mtpa_angle": Figure.of(angle, at_most.sigma_angle[-1], "rad", last),
        "max_torque": Figure.of(at_most.torque[-1], at_most.sigma_torque[-1], "Nm", last),
        **(_figures_over_speed(model, ranges[0]) if ranges else {}),
        "kp_d": Figure.of(rate * gains[0, 0], rate * errors[0, 0], "V/A", zero),
        "kp_q": Figure.of(rate * gains[1, 1], rate * errors[1, 1], "V/A", zero),
        "ki": Figure.of(rate * model.resistance, rate * factor * found.sigma_resistance, "V/(A s)", inside=True),
    }


def _figures_over_speed(model: MachineModel, of_speed: SpeedRange) -> dict[str, Figure]:
    """Return what the DC link limits; the largest torque is that at standstill."""
    motoring, sigma_torque = of_speed.motoring, of_speed.sigma_torque
    supported = motoring.inside(model)
    strongest = _strongest(model, of_speed)
    sigma_power = float(strongest.speed[0] * sigma_envelope(model, of_speed.limits, strongest)[0])
    efficiency = of_speed.references.efficiency
    best = np.unravel_index(np.nanargmax(efficiency) if np.isfinite(efficiency).any() else 0, efficiency.shape)
    there = model.inside(*of_speed.references.i_dq[best])
    return {
        "max_torque": Figure.of(motoring.torque[0], sigma_torque[0], "Nm", supported[0]),
        "corner_speed": _corner(model, of_speed),
        _top(model, of_speed): Figure.of(motoring.speed[-1], np.nan, "rad/s", supported[-1]),
        "max_power": Figure.of(strongest.mechanical[0], sigma_power, "W", strongest.inside(model)[0]),
        "max_efficiency": Figure.of(efficiency[best], of_speed.errors.efficiency[best], "1", there),
    }


def _strongest(model: MachineModel, of_speed: SpeedRange) -> Operation:
    """Return the point of the largest power, between the speeds of the tables as well."""
    points = of_speed.motoring
    if not np.isfinite(points.torque).any():
        return points.chosen(np.arange(len(points.speed)) == 0)
    for _ in range(_ROUNDS):
        best = int(np.nanargmax(points.mechanical))
        low, high = points.speed[max(best - 1, 0)], points.speed[min(best + 1, len(points.speed) - 1)]
        finer = np.unique(np.append(np.linspace(low, high, _FINER), points.speed[best]))
        points = envelope(model, of_speed.limits, finer)
    return points.chosen(np.arange(len(points.speed)) == int(np.nanargmax(points.mechanical)))


def _top(model: MachineModel, of_speed: SpeedRange) -> str:
    """Return what the last speed of the tables is: the highest that can be driven, or only their end."""
    last = float(of_speed.motoring.speed[-1])
    beyond = (1 + _BEYOND) * last
    return "table_end_speed" if top_speed(model, of_speed.limits, beyond) == beyond else "max_speed"


def _sigma_saliency(model: MachineModel) -> float:
    """Return the standard error of L_qq / L_dd at zero current; NaN where the errors' correlation is not known."""
    if model.errors is None:
        return np.nan
    zero, slopes = np.zeros(()), model.inductances(0.0, 0.0)
    changes = model.errors.inductances(zero, zero)
    relative = changes[:, 1, 1] / slopes[1, 1] - changes[:, 0, 0] / slopes[0, 0]
    return float(slopes[1, 1] / slopes[0, 0] * combined(relative))


def _corner(model: MachineModel, of_speed: SpeedRange) -> Figure:
    """Return the corner speed; its changes are those of the voltage divided by the voltage's slope over speed.

    The voltage changes at a given current, and because the current of the largest torque turns on its circle.
    """
    speed, i_dq = of_speed.corner, of_speed.motoring.i_dq[:1]
    if not speed > 0:
        return Figure(speed, np.nan, "rad/s", inside=False)
    point, step = Operation.at(model, i_dq, np.array([speed])), 1e-3 * speed + 1e-6
    slope = float((Operation.at(model, i_dq, point.speed + step).voltage - point.voltage)[0]) / step
    changed, inside = changes(model, point, ("voltage",), of_stator=False), bool(model.inside(*i_dq[0]))
    if changed is None or not inside or slope <= 0:
        return Figure(speed, np.nan, "rad/s", inside)
    turned = _TURN * np.array([[-i_dq[0, 1], i_dq[0, 0]]])
    by_angle = (Operation.at(model, i_dq + turned, point.speed).voltage - point.voltage) / _TURN
    angle = np.arctan2(i_dq[:, 1], i_dq[:, 0])
    moved = np.nan_to_num(mtpa_angle_changes(model, np.hypot(*i_dq.T), angle)) * by_angle
    return Figure(speed, float(combined(changed["voltage"] + moved)[0]) / slope, "rad/s", inside)


def _statements(
    model: MachineModel,
    found: Result,
    i_max: float,
    at_most: CurrentLocus,
    beyond: CurrentLocus,
    ranges: tuple[SpeedRange, ...],
) -> tuple[Message, ...]:
    """Say what the figures include, and where they rest on no data."""
    known_drop = found.origin.inverter and np.any(found.inverter_curve.voltage)
    out = [
        _on_errors(model),
        Message("analysis_iron_loss" if model.iron.known else "analysis_iron_loss.unknown"),
        Message("analysis_drop" if known_drop else "analysis_drop.unknown"),
    ]
    if model.temperature is not None:
        assumed = not found.provenance.settings.temperatures
        at = {"temperature": model.temperature, "reference": REFERENCE_TEMPERATURE}
        out.append(Message("analysis_resistance", assumed=assumed, **at))
    if model.magnet_temperature is not None:
        known = found.drive.magnet_coefficient is not None
        key = "analysis_magnet" if known else "analysis_magnet.unknown"
        out.append(Message(key, temperature=model.magnet_temperature))
    if not math.isfinite(model.resistance):
        out.append(Message("analysis_resistance.unknown"))
    if not ranges:
        out.append(Message("analysis_speed.unknown"))
    if not model.monotone:
        grid = model.flux_map.grid()[model.flux_map.inside]
        own = np.stack(model.psi_dq(grid[:, 0], grid[:, 1]), axis=-1)
        moved = float(np.abs(model.inverted.values(grid[:, 0], grid[:, 1]) - own).max())
        out.append(Message("analysis_monotone.nearest", moved=moved))
    if not model.monotone_inside:
        out.append(Message("analysis_monotone.gains"))
    out.append(Message("analysis_ripple" if found.harmonics else "analysis_ripple.unknown"))
    if not len(beyond):
        out.append(Message("analysis_mtpv.none", i_max=i_max))
    supported = {"MTPA": at_most.inside, "MTPV": beyond.inside}
    for entry in ranges:
        points = entry.references
        supported[f"field weakening at {entry.u_dc:.4g} V"] = points.inside(model) | ~np.isfinite(points.i_dq[..., 0])
    for line, inside in supported.items():
        if not inside.all():
            out.append(Message("analysis_support", missing=int((~inside).sum()), points=inside.size, line=line))
    return tuple(out)


def _on_errors(model: MachineModel) -> Message:
    if model.errors is None:
        return Message("analysis_bands.unknown")
    return Message("analysis_bands" if model.errors.joint else "analysis_bands.wide")
