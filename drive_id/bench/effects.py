"""Conversion of the settings of effects to constants and initial state of :mod:`drive_id.bench.real_drive`.

Both are numpy records, not named tuples: numba passes a record as one pointer, but the members of a tuple one by one,
which doubles the compile time.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from drive_id.bench import kernels
from drive_id.bench.effect_settings import EFFECT_NAMES, LOG_ONLY, MOST_ORDERS
from drive_id.bench.machine import Machine
from drive_id.bench.parameters import DriveState, Plant
from drive_id.bench.settings import SimulationSettings
from drive_id.common.temperature import REFERENCE_TEMPERATURE

DEFAULT_ACCELERATION = 4000.0
"""Of the free shaft by the largest torque, mechanical, rad/s^2: that of a servo drive with a coupling."""
_DEFAULT_FRICTION = 0.01
"""Coulomb friction, and viscous friction at :data:`_FRICTION_SPEED`, as a fraction of the largest torque."""
_FRICTION_SPEED = 100.0  # mechanical, rad/s
_RIM_NODES = 721  # angles at which the torque on the rim of the disc is sought

EFFECTS = np.dtype(
    [
        ("iron_conductance", float),  # S
        ("iron_hysteresis", float),  # A
        ("iron_hysteresis_voltage", float),  # V
        ("iron_rate", float),  # 1/s, 0 without iron loss
        ("flux_lag", float),
        ("lag_rate", float),  # 1/s
        ("eccentricity", float, (MOST_ORDERS,)),  # at the mechanical orders 1, 2, ...
        ("orders", int, (3,)),  # used, of eccentricity, electrical and mechanical resolver errors
        ("pole_pairs", float),
        ("resistance_factor", float, (3,)),
        ("magnet_flux", float),  # psi_d at zero current and 20 degrees, Wb
        ("thermal_coefficient", float, (2,)),  # of copper and magnet, 1/K
        ("heat_rate", float, (2,)),  # 1 / heat capacity, 0 for constant temperature, K/J
        ("cooling_rate", float, (2,)),  # 1/s
        ("ambient_temperature", float),  # degC
        ("drop_factor", float, (3,)),
        ("drop_asymmetry", float, (3,)),
        ("hexagon_limit", bool),  # limit the average voltages of the legs to the DC link
        ("switching", bool),
        ("dead_time", float),  # s
        ("output_capacitance", float),  # F
        ("current_clamping", bool),  # a current that reaches zero in the dead time stays zero
        ("u_dc", float),  # DC-link voltage assumed by the commands, V
        ("u_dc_waves", float, (2, 2)),  # amplitude as a fraction and frequency, Hz, of ripple and drift
        ("filter_pole", complex),  # of the current filter, 1/s; 0 without
        ("filter_gain", complex),  # the output is Re(gain z) with dz/dt = pole z + i
        ("current_skew", float, (3,)),  # s
        ("current_dead_band", float),  # A
        ("cubic", float),  # 1/A^2
        ("resolver_latency", float),  # of the angle, s
        ("resolver_quantization", float),  # rad, 0 for none
        ("resolver_electrical", float, (MOST_ORDERS, 2)),  # amplitude and phase of the orders 1, 2, ..., rad
        ("resolver_mechanical", float, (MOST_ORDERS, 2)),
        ("largest_step", float),  # of the integration, s
        ("free_shaft", bool),
        ("stator_frame", bool),  # the references are alpha and beta
        ("angle_scale", float),  # of the measured angle
        ("torque_factor", float),  # 1.5 pole pairs
        ("rotor_rate", float),  # pole pairs / inertia, 1/(kg m^2)
        ("friction", float, (2,)),  # per electrical speed, N m s, and Coulomb, N m
        ("cogging", float, (2,)),  # amplitude, N m, and electrical order
        ("load_torque", float),  # N m
        ("observer_rate", float),  # natural frequency of the observer of the speed, 1/s; 0 without
    ],
    align=True,
)
"""Constants of all effects inside the loop."""

EFFECT_STATE = np.dtype(
    [
        ("iron_voltage", float, (2,)),  # lagged induced voltage that drives the iron current, stator frame, V
        ("lagged", float, (2,)),  # flux linkage of the lagging share, rotor frame, Wb
        ("temperature", float, (2,)),  # of copper and magnet, degC
        ("filter", complex, (2,)),  # in the stator frame
        ("sampled", float, (3,)),  # phase currents at the sensors at the next sample, A
        ("motion", float, (4,)),  # time since the sample, s; angle, speed and acceleration then, without ripple, rad
        ("observer", float, (2,)),  # predicted angle, rad, and speed, rad/s
        ("energy", float, (5,)),  # into the terminals, and lost in copper, inverter, iron, magnets, J
    ],
    align=True,
)
"""State of the effects, in addition to :class:`~drive_id.bench.parameters.DriveState`."""

COURSE = np.dtype(
    [
        ("i_dq_machine", float, (2,)),  # true rotor frame, without the iron current, A
        ("psi_dq", float, (2,)),  # true rotor frame, Wb
        ("lagged", float, (2,)),  # flux linkage of the lagging share, Wb
        ("temperature", float, (2,)),  # of copper and magnet, degC
        ("u_dc", float),  # of the period that begins, V
        ("energy", float, (5,)),  # so far: into the terminals, and lost in copper, inverter, iron, magnets, J
    ],
    align=True,
)
"""True quantities at each sample of a simulation with effects, which no sensor measures."""
Course = np.recarray[Any, np.dtype[np.record]]


def _record(kind: np.dtype[np.void], **values: object) -> np.record:
    """Return a record with all fields of ``kind``."""
    if values.keys() != set(kind.names or ()):
        raise TypeError(f"the fields are {kind.names}")
    rows = np.zeros(1, kind).view(np.recarray)
    for name, value in values.items():
        rows[name][0] = value
    record: np.record = rows[0]
    return record


def active(settings: SimulationSettings) -> set[str]:
    """Return the names of the effects whose settings differ from their defaults."""
    fields = SimulationSettings.__dataclass_fields__
    return {name for name in EFFECT_NAMES if getattr(settings, name) != fields[name].default}


def acts_inside(settings: SimulationSettings) -> bool:
    """Return whether an effect acts inside the control loop: then the course of the inner quantities is kept."""
    return bool(active(settings) - LOG_ONLY) or settings.inverter == "switching"


def effects_of(machine: Machine, s: SimulationSettings) -> np.record:
    """Return the constants for settings ``s``; those that are named as a setting are its value."""
    iron = s.iron_conductance > 0 or s.iron_hysteresis > 0
    steps = [s.sample_period / s.substeps]
    steps += [0.5 * s.iron_time_constant] if iron else []
    steps += [0.5 * s.flux_lag_time] if s.flux_lag > 0 else []
    pole, gain = _filter(s.current_filter, s.current_filter_order)
    shaft = shaft_of(machine, s)
    capacities = (s.copper_heat_capacity, s.magnet_heat_capacity)
    given = {name: getattr(s, name) for name in EFFECTS.names or () if hasattr(s, name)}
    own = {
        "iron_hysteresis_voltage": s.iron_hysteresis_voltage or 0.005 * machine.u_dc,
        "iron_rate": 1 / s.iron_time_constant if iron else 0.0,
        "lag_rate": 1 / s.flux_lag_time if s.flux_lag > 0 else 0.0,
        "eccentricity": _padded(s.eccentricity),
        "orders": [len(x) for x in (s.eccentricity, s.resolver_electrical_errors, s.resolver_mechanical_errors)],
        "pole_pairs": machine.pole_pairs,
        "magnet_flux": float(machine.mean_flux(0.0, 0.0)[0]),
        "thermal_coefficient": (s.copper_coefficient, -s.magnet_coefficient),
        "heat_rate": [1 / capacity if capacity > 0 else 0.0 for capacity in capacities],
        "cooling_rate": (1 / s.copper_time_constant, 1 / s.magnet_time_constant),
        "switching": s.inverter == "switching",
        "u_dc": machine.u_dc,
        "u_dc_waves": ((s.u_dc_ripple, s.u_dc_ripple_frequency), (s.u_dc_drift, s.u_dc_drift_frequency)),
        "filter_pole": pole,
        "filter_gain": gain,
        "cubic": s.current_cubic / machine.i_max**2,
        "resolver_electrical": _waves(s.resolver_electrical_errors, s.resolver_electrical_phases),
        "resolver_mechanical": _waves(s.resolver_mechanical_errors, s.resolver_mechanical_phases),
        "largest_step": min(steps),
        "stator_frame": False,
        "angle_scale": angle_scale(s),
        "torque_factor": 1.5 * machine.pole_pairs,
        "rotor_rate": machine.pole_pairs / shaft.inertia,
        "friction": (shaft.viscous_friction / machine.pole_pairs, shaft.coulomb_friction),
        "cogging": (s.cogging_torque, (s.cogging_order or 6 * machine.pole_pairs) / machine.pole_pairs),
        "observer_rate": 2 * math.pi * s.speed_observer,
    }
    return _record(EFFECTS, **given | own)


def angle_scale(settings: SimulationSettings) -> float:
    """Return the measured electrical angle per true one."""
    return -settings.angle_factor if settings.angle_reversed else settings.angle_factor


class Shaft(NamedTuple):
    """Mechanical constants of the free shaft."""

    inertia: float  # kg m^2
    viscous_friction: float  # N m s
    coulomb_friction: float  # N m


def largest_torque(machine: Machine) -> float:
    """Return the largest torque on the rim of the current disc, N m."""
    angle = np.linspace(0, 2 * np.pi, _RIM_NODES)
    i_d, i_q = machine.i_max * np.cos(angle), machine.i_max * np.sin(angle)
    psi = machine.mean_flux(i_d, i_q)
    return float(1.5 * machine.pole_pairs * np.max(psi[:, 0] * i_q - psi[:, 1] * i_d))


def shaft_of(machine: Machine, s: SimulationSettings) -> Shaft:
    """Return the shaft that the settings ask for, its defaults scaled by the machine's largest torque."""
    torque = largest_torque(machine)
    return Shaft(
        s.inertia or torque / DEFAULT_ACCELERATION,
        _DEFAULT_FRICTION * torque / _FRICTION_SPEED if s.viscous_friction is None else s.viscous_friction,
        _DEFAULT_FRICTION * torque if s.coulomb_friction is None else s.coulomb_friction,
    )


def _filter(cut_off: float, order: int) -> tuple[complex, complex]:
    """Return pole and gain of a low-pass: w/(s + w), or w^2/(s^2 + sqrt(2) w s + w^2) in partial fractions."""
    w = 2 * math.pi * cut_off
    if order == 1 or cut_off == 0.0:
        return complex(-w), complex(w)
    return w * complex(-1, 1) / math.sqrt(2), complex(0, -math.sqrt(2) * w)


def _padded(values: tuple[float, ...]) -> tuple[float, ...]:
    return (*values, *(0.0,) * (MOST_ORDERS - len(values)))


def _waves(amplitudes: tuple[float, ...], phases: tuple[float, ...]) -> list[tuple[float, float]]:
    return list(zip(_padded(amplitudes), _padded(phases), strict=True))


def effect_state(settings: SimulationSettings, effects: np.record, plant: Plant, start: DriveState) -> np.record:
    """Return the state at rest on the currents and at the angle of ``start``, at the temperatures of the settings."""
    i_d, i_q = start.current
    angle = start.mean_angle[0]
    flux = kernels.evaluate(plant.table, i_d, i_q, angle)[:2]
    phases = 2 * np.pi / 3 * np.arange(3) - angle
    turned = complex(i_d, i_q) * np.exp(1j * angle)
    no_filter = effects.filter_pole == 0
    return _record(
        EFFECT_STATE,
        iron_voltage=np.zeros(2),
        lagged=np.array(flux),
        temperature=np.array((settings.copper_temperature, settings.magnet_temperature)),
        filter=np.zeros(2, np.complex128) if no_filter else -np.array((turned.real, turned.imag)) / effects.filter_pole,
        sampled=np.cos(phases) * i_d + np.sin(phases) * i_q,
        motion=np.zeros(4),
        observer=np.array((start.mean_angle[0], 0.0)),
        energy=np.zeros(5),
    )


def truth_of(settings: SimulationSettings, machine: Machine, state: np.record, duration: float) -> dict[str, float]:
    """Return the details of the truth for scoring a fit of the ``duration``, s, simulated so far."""
    copper, magnet = state.temperature.tolist()
    start, end = (
        machine.resistance * (1 + settings.copper_coefficient * (temperature - REFERENCE_TEMPERATURE))
        for temperature in (settings.copper_temperature, copper)
    )
    powers = zip(("input", "copper", "inverter", "iron", "magnet"), state.energy.tolist(), strict=True)
    return {
        "resistance_start": start,
        "resistance_end": end,
        "copper_temperature_end": copper,
        "magnet_temperature_end": magnet,
        "magnet_flux": float(machine.mean_flux(0.0, 0.0)[0]),
        **({f"{name}_power_mean": value / duration for name, value in powers} if duration else {}),
        **(shaft_of(machine, settings)._asdict() if settings.free_shaft else {}),
    }


def recorded(settings: SimulationSettings) -> set[str]:
    """Return the names of the settings stored in the truth; those of effects only if an effect is active."""
    names = {field.name for field in dataclasses.fields(settings)}
    return names if active(settings) or acts_inside(settings) else names - set(EFFECT_NAMES)
