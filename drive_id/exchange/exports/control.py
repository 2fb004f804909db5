"""Tables of current references over torque and speed for controllers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drive_id.analysis.field_weakening import DriveLimits, corner_speed, envelope, references, top_speed
from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.axes import clean
from drive_id.exchange.exports.table import MapTable
from drive_id.types import FloatArray

_SPEEDS = 25  # of the table
_TORQUES = 10  # of the table, on each side of zero
_WEAKENING = 4.0  # highest speed, in corner speeds


@dataclass(frozen=True, eq=False)
class ControlTable:
    """References of minimum current within the limits; for a torque that cannot be reached, those of the nearest."""

    speed: FloatArray  # (S,), mechanical, rad/s, from 0
    torque: FloatArray  # (T,), Nm, from the most negative to the largest
    i_d: FloatArray  # (S, T), A
    i_q: FloatArray


def control_table(table: MapTable) -> ControlTable:
    """Compute the references of a drive for its DC-link voltage and i_max.

    Raises ConfigurationError when pole pairs, resistance or DC-link voltage are unknown, or no speed can be driven.
    """
    machine = table.machine
    machine.known_pole_pairs()
    table.known_resistance()
    limits = DriveLimits(machine.i_max, machine.known_u_dc() / math.sqrt(3))
    corner = corner_speed(machine, limits)
    if corner <= 0:
        raise ConfigurationError(
            f"{machine.known_u_dc():g} V do not suffice for the largest torque at standstill: give a larger --u-dc."
        )
    speed = clean(np.linspace(0.0, top_speed(machine, limits, _WEAKENING * corner), _SPEEDS))
    motoring, braking = (envelope(machine, limits, speed, sign=sign) for sign in (1.0, -1.0))
    largest = float(np.nanmax(np.abs([motoring.torque, braking.torque])))
    torque = clean(largest * np.arange(-_TORQUES, _TORQUES + 1) / _TORQUES)
    found = references(machine, limits, torque, motoring, braking)
    possible = np.isfinite(found.stator).all(axis=(1, 2))  # the highest speed may just fail
    return ControlTable(speed[possible], torque, found.stator[possible, :, 0], found.stator[possible, :, 1])
