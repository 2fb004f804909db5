"""Torque over the current plane and the lines of operation on it; torque and efficiency over speed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drive_id.analysis.bands import combined
from drive_id.analysis.field_weakening import DriveLimits, corner_speed, envelope, references, top_speed
from drive_id.analysis.machine import MachineModel
from drive_id.analysis.operation import Operation, changes
from drive_id.analysis.ripple import TorqueRipple
from drive_id.analysis.trajectories import CurrentLocus, mtpa, mtpv
from drive_id.result.result import Result
from drive_id.types import FloatArray

_WEAKENING = 3.0
"""Highest speed over the corner speed."""
_SPEEDS = 32  # of the efficiency map, evenly up to the highest
_TORQUES = 20
"""Points along the axes of the efficiency map: finer ones look the same, and take seconds."""


@dataclass(frozen=True, eq=False)
class SpeedMap:
    """Efficiency over torque and speed, at the least stator current, within the limits of current and voltage."""

    u_dc: float  # V; the voltage is limited to u_dc / sqrt(3)
    speed: FloatArray  # (S,), mechanical, rad/s
    largest: FloatArray  # (S,), torque of the envelope, Nm
    torque: FloatArray  # (N,), Nm
    efficiency: FloatArray
    """(S, N), shaft over electrical power, mechanical losses aside; NaN without data. Just beyond the envelope
    it is that of the envelope, so that a drawn field reaches it; NaN further on."""
    iron: bool  # the losses hold an identified iron loss, beside those of the winding and the inverter


@dataclass(frozen=True, eq=False)
class LossMap:
    """Losses over the current plane, on the grid of the flux map; NaN where there are no data."""

    speed: float  # to which the iron loss belongs, mechanical, rad/s; NaN where no iron loss was identified
    losses: dict[str, tuple[FloatArray, FloatArray]]
    """By name, ``copper``, ``inverter`` and ``iron``: W, and the standard error, W; without those that are zero."""

    @classmethod
    def of(cls, result: Result, model: MachineModel, corner: float) -> LossMap | None:
        """Evaluate at the corner speed, or where it is unknown at the highest recorded one; None without R."""
        if not math.isfinite(model.resistance):
            return None
        found = result.flux_map.whole
        recorded = max(map(abs, result.speed_range or (0.0,))) / model.known_pole_pairs()
        rpm = 30 / math.pi
        speed = float(f"{(corner if corner > 0 else recorded) * rpm:.2g}") / rpm
        points = Operation.at(model, found.grid(), np.asarray(speed))
        names = [name for name in ("copper", "inverter", "iron") if np.any(getattr(points, name))]
        changed = changes(model, points, names, of_stator=False) or {}
        losses = {}
        for name in names:
            sigma = combined(changed[name]) if name in changed else np.full(found.inside.shape, np.nan)
            value = getattr(points, name)
            losses[name] = (np.where(found.inside, value, np.nan), np.where(found.inside, sigma, np.nan))
        return cls(speed if "iron" in losses else math.nan, losses)


@dataclass(frozen=True, eq=False)
class TorqueMap:
    """Torque and the lines of operation of a machine whose pole pairs are known."""

    torque: FloatArray  # (D, Q), on the grid of the flux map, Nm, NaN where there are no data
    corner: float  # speed up to which the voltage allows MTPA at i_max, mechanical, rad/s; NaN where unknown
    lines: dict[str, CurrentLocus]  # MTPA in both directions of torque, and MTPV, as far as there are data
    ripple: FloatArray | None  # (D, Q), peak to peak, Nm; None without rotor-position harmonics
    losses: LossMap | None  # None when the resistance is unknown
    speeds: SpeedMap | None  # None when the DC-link voltage or the resistance is unknown


def torque_map(result: Result) -> TorqueMap | None:
    """Return torque and lines of operation; None when the pole pairs are unknown, or the rotor was locked."""
    if result.pole_pairs is None or not result.origin.turning:
        return None
    model, found = MachineModel.of(result), result.flux_map.whole
    torque = model.torque(found.i_d[:, None], found.i_q)
    trajectories = {
        "MTPA": mtpa(model, result.i_max),
        "MTPA, negative torque": mtpa(model, result.i_max, sign=-1.0),
        "MTPV": mtpv(model, result.i_max),
    }
    lines = {name: _known(trajectory) for name, trajectory in trajectories.items()}
    known = bool(result.u_dc) and math.isfinite(result.resistance)
    limits = DriveLimits(result.i_max, model.known_u_dc() / math.sqrt(3)) if known else None
    corner = corner_speed(model, limits) if limits else math.nan
    return TorqueMap(
        np.where(found.inside, torque, np.nan),
        corner,
        {name: line for name, line in lines.items() if len(line) > 1},
        _ripple(result, model) if result.harmonics else None,
        LossMap.of(result, model, corner),
        _speed_map(model, limits, corner) if limits else None,
    )


def _ripple(result: Result, model: MachineModel) -> FloatArray:
    found = result.flux_map.whole
    values = TorqueRipple.of(model).peak_to_peak(*np.meshgrid(found.i_d, found.i_q, indexing="ij"))
    return np.where(found.inside, values, np.nan)


def _speed_map(model: MachineModel, limits: DriveLimits, corner: float) -> SpeedMap | None:
    """Return the map up to three times the corner speed; None where no torque keeps the limits."""
    highest = top_speed(model, limits, _WEAKENING * corner) if corner > 0 else 0.0
    if highest <= 0:
        return None
    speed = highest * np.arange(1, _SPEEDS + 1) / _SPEEDS
    ends = [envelope(model, limits, speed, sign=sign) for sign in (1.0, -1.0)]
    torque = np.nanmax(ends[0].torque) * np.arange(1, _TORQUES + 1) / _TORQUES
    points = references(model, limits, torque, *ends)
    nearby = np.lib.stride_tricks.sliding_window_view(np.pad(ends[0].torque, 1, mode="edge"), 3).max(axis=1)
    drawn = torque - torque[0] <= nearby[:, None]
    efficiency = np.where(drawn & points.inside(model), points.efficiency, np.nan)
    return SpeedMap(model.known_u_dc(), speed, ends[0].torque, torque, efficiency, model.iron.known)


def _known(found: CurrentLocus) -> CurrentLocus:
    """Return the points that data support."""
    return CurrentLocus(*(values[found.inside] for values in vars(found).values()))
