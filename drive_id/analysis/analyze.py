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
from drive_id.analysis.operation import Operation, OperationErrors
from drive_id.analysis.ripple import TorqueRipple
from drive_id.analysis.settings import AnalysisSettings
from drive_id.analysis.trajectories import CurrentLocus, characteristic_current, mtpa, mtpv
from drive_id.errors import ConfigurationError, DataError
from drive_id.result.result import Result
from drive_id.temperature import REFERENCE_TEMPERATURE
from drive_id.types import BoolArray

_RPM = math.pi / 30
_REACH = 1.25
_FURTHEST = 4.0
"""Largest current of an analysis relative to that of the map."""
_LEAST_TORQUE = 1e-4
"""Of the product of flux and current."""
_MOST_FALLING = 0.5
_BEYOND = 0.05
"""Share by which the last speed must be exceeded if it is only the end of the tables."""
_WEAKENING = 4.0
"""Highest speed of the tables, in corner speeds."""
_UNKNOWN_RESISTANCE = (
    "The resistance is unknown: voltages neglect it, and losses, efficiency and ki are NaN; import the map with "
    "--resistance."
)


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
    chosen = settings or AnalysisSettings()
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
    ripple = TorqueRipple.of(model, found.flux_map, found.harmonics, _REACH * max(i_max, found.i_max))
    maps = CurrentMaps.of(model, ripple, found.flux_map.i_d, found.flux_map.i_q, chosen.bandwidth)
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
        statements=_statements(model, found, chosen, at_most, beyond, ranges),
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
    saliency = slopes[1, 1] / slopes[0, 0]
    characteristic = characteristic_current(model)
    factor = model.resistance / found.resistance if found.resistance else 1.0
    rate = 2 * math.pi * settings.bandwidth
    return {
        "resistance": Figure(model.resistance, factor * found.sigma_resistance, "ohm", inside=True),
        "magnet_flux": Figure(float(model.psi_dq(0.0, 0.0)[0]), sigma_magnet, "Wb", zero),
        "L_dd": Figure(float(slopes[0, 0]), float(errors[0, 0]), "H", zero),
        "L_qq": Figure(float(slopes[1, 1]), float(errors[1, 1]), "H", zero),
        "saliency": Figure(float(saliency), _sigma_saliency(model) if zero else np.nan, "1", zero),
        "characteristic_current": Figure(characteristic[0], characteristic[1], "A", characteristic[2]),
        "mtpa_angle": Figure(
            float(np.arctan2(at_most.i_q[-1], at_most.i_d[-1])),
            float(at_most.sigma_angle[-1]),
            "rad",
            bool(at_most.inside[-1]),
        ),
        "max_torque": Figure(
            float(at_most.torque[-1]), float(at_most.sigma_torque[-1]), "Nm", bool(at_most.inside[-1])
        ),
        **(_figures_over_speed(model, ranges[0]) if ranges else {}),
        "kp_d": Figure(float(rate * gains[0, 0]), float(rate * errors[0, 0]), "V/A", zero),
        "kp_q": Figure(float(rate * gains[1, 1]), float(rate * errors[1, 1]), "V/A", zero),
        "ki": Figure(rate * model.resistance, rate * factor * found.sigma_resistance, "V/(A s)", inside=True),
    }


def _figures_over_speed(model: MachineModel, of_speed: SpeedRange) -> dict[str, Figure]:
    """Return what the DC link limits; the largest torque is that at standstill."""
    motoring, sigma_torque = of_speed.motoring, of_speed.sigma_torque
    supported = motoring.inside(model)
    possible = bool(np.isfinite(motoring.torque).any())
    power = int(np.nanargmax(motoring.mechanical)) if possible else 0
    efficiency = of_speed.references.efficiency
    best = np.unravel_index(np.nanargmax(efficiency) if np.isfinite(efficiency).any() else 0, efficiency.shape)
    at = of_speed.references.i_dq[best]
    return {
        "max_torque": Figure(float(motoring.torque[0]), float(sigma_torque[0]), "Nm", bool(supported[0])),
        "corner_speed": _corner(model, of_speed),
        _top(model, of_speed): Figure(float(motoring.speed[-1]), np.nan, "rad/s", bool(supported[-1])),
        "max_power": Figure(
            float(motoring.mechanical[power]),
            float(motoring.speed[power] * sigma_torque[power]),
            "W",
            bool(supported[power]),
        ),
        "max_efficiency": Figure(
            float(efficiency[best]), float(of_speed.errors.efficiency[best]), "1", bool(model.inside(at[0], at[1]))
        ),
    }


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
    """Return the corner speed; its standard error is that of the voltage divided by the voltage's slope over speed."""
    speed, i_dq = of_speed.corner, of_speed.motoring.i_dq[:1]
    if not speed > 0:
        return Figure(speed, np.nan, "rad/s", inside=False)
    point = Operation.at(model, i_dq, np.array([speed]))
    errors = OperationErrors.of(model, point)
    step = 1e-3 * speed + 1e-6
    ahead = Operation.at(model, point.i_dq, point.speed + step)
    slope = float((ahead.voltage - point.voltage)[0]) / step
    sigma = float(errors.voltage[0]) / slope if slope > 0 else np.nan
    return Figure(speed, sigma, "rad/s", bool(model.inside(*i_dq[0])))


def _statements(
    model: MachineModel,
    found: Result,
    settings: AnalysisSettings,
    at_most: CurrentLocus,
    beyond: CurrentLocus,
    ranges: tuple[SpeedRange, ...],
) -> tuple[str, ...]:
    out = [_on_errors(model), _on_iron(model), _on_inverter(found), *_on_temperature(model, found)]
    if not math.isfinite(model.resistance):
        out.append(_UNKNOWN_RESISTANCE)
    if not ranges:
        out.append(
            "The DC-link voltage is unknown, so there are no figures and tables over speed: give --u-dc (u_dc), V."
        )
    if not model.monotone:
        out.append(_on_inverse(model))
    if not model.monotone_inside:
        out.append(
            "The incremental inductances of the map are not positive definite everywhere within the data: the gains "
            "rest on those of the nearest monotone map."
        )
    if not found.harmonics:
        out.append("The result has no rotor-position harmonics, so the torque ripple is 0.")
    else:
        out.append("The torque ripple follows from the flux harmonics; cogging at zero current is not included.")
    if not len(beyond):
        i_max = settings.i_max or found.i_max
        out.append(f"There is no MTPV point up to {i_max:.4g} A: the characteristic current exceeds it.")
    out += [
        sentence
        for name, inside in (
            ("MTPA", at_most.inside),
            ("MTPV", beyond.inside),
            *((f"field weakening at {entry.u_dc:.4g} V", _inside(model, entry.references)) for entry in ranges),
        )
        if (sentence := _on_support(name, inside))
    ]
    return tuple(out)


def _inside(model: MachineModel, points: Operation) -> BoolArray:
    return (points.inside(model) | ~np.isfinite(points.i_dq[..., 0])).ravel()


def _on_support(name: str, inside: BoolArray) -> str:
    missing = int((~inside).sum())
    if not missing:
        return ""
    return (
        f"{missing} of {inside.size} points of {name} lie outside the data: they rest on a smooth continuation of the "
        "map, are marked (inside is 0) and have no standard error."
    )


def _on_inverse(model: MachineModel) -> str:
    grid = model.flux_map.grid()[model.flux_map.inside]
    own = np.stack(model.psi_dq(grid[:, 0], grid[:, 1]), axis=-1)
    moved = np.abs(model.inverted.values(grid[:, 0], grid[:, 1]) - own).max()
    return (
        "The map is not monotone, so a flux may belong to several currents: the inverse map and the characteristic "
        f"current are those of the nearest monotone map, which differs by at most {moved:.3g} Wb within the data."
    )


def _on_errors(model: MachineModel) -> str:
    if model.errors is None:
        return "The result has no standard errors of its map, so all bands are NaN."
    if not model.errors.joint:
        return (
            "The result does not tell how the errors of its map are correlated: each flux is taken to err as a whole, "
            "which gives wide bands of torque, and none of inductances and angles."
        )
    return (
        "Standard errors follow from the joint errors of fluxes, resistance and inverter curve that the fit found, to "
        "first order; a common gain error of currents or voltages is not included."
    )


def _on_iron(model: MachineModel) -> str:
    if model.iron.known:
        return (
            "Iron loss is included as identified: i_d and i_q of the tables over speed are stator currents, and the "
            "torque follows from those minus the current of the iron loss."
        )
    return "No iron loss was identified, so none is included; losses lack it and those of friction."


def _on_inverter(found: Result) -> str:
    if found.origin.inverter and np.any(found.inverter_curve.voltage):
        return (
            "The inverter's drop is included in voltages and losses, with its linear part in the resistance; its "
            "switching losses are not."
        )
    return "No drop of the inverter is known, so none is included beyond what the resistance contains."


def _on_temperature(model: MachineModel, found: Result) -> list[str]:
    out = []
    if model.temperature is not None:
        known = bool(found.provenance.settings.temperatures)
        since = "" if known else ", which is assumed, as no temperatures are known"
        out.append(
            f"The resistance holds at {model.temperature:g} degC, by copper's coefficient from its value at "
            f"{REFERENCE_TEMPERATURE:g} degC{since}."
        )
    if model.magnet_temperature is not None:
        out.append(
            f"The magnet's flux holds at {model.magnet_temperature:g} degC by the identified coefficient."
            if found.drive.magnet_coefficient is not None
            else "The coefficient of the magnet was not identified: its flux is that of the map."
        )
    return out
