"""Settings of the effects of real drives in the simulation, by location; all are off by default.

:class:`~drive_id.bench.settings.SimulationSettings` inherits the groups, so every effect is set by its plain name.
Temperatures are in degrees Celsius; resistance and magnet flux of the machine are given at 20 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from drive_id.common.settings import setting
from drive_id.common.temperature import COPPER, REFERENCE_TEMPERATURE

MOST_ORDERS = 8  # of the eccentricity and of each kind of resolver error


@dataclass(frozen=True)
class MachineEffects:
    """Iron loss, magnet eddy currents, heating, eccentricity and unequal phases of the machine."""

    iron_conductance: float = setting(
        0.0, "Eddy-current conductance across the voltage induced in the stator, one phase",
        unit="S", minimum=0.0, maximum=1e3,
    )  # fmt: skip
    iron_hysteresis: float = setting(
        0.0, "Amplitude of a hysteresis-like iron current along the induced voltage", unit="A", minimum=0.0, maximum=1e6
    )
    iron_hysteresis_voltage: float | None = setting(
        None, "Induced voltage below which iron_hysteresis fades; default: 0.5 % of the DC link",
        unit="V", minimum=1e-9, maximum=1e6,
    )  # fmt: skip
    iron_time_constant: float = setting(
        5e-5, "Lag of the iron current behind the induced voltage", unit="s", minimum=5e-6, maximum=1e-2
    )
    flux_lag: float = setting(
        0.0, "Share of the flux that lags the current, by eddy currents in the magnets", minimum=0.0, maximum=0.5
    )
    flux_lag_time: float = setting(1e-3, "Time constant of flux_lag", unit="s", minimum=1e-5, maximum=10.0)
    eccentricity: tuple[float, ...] = setting(
        (), "Modulation of the flux at the mechanical orders 1, 2, ..., as a fraction of it", minimum=-0.2, maximum=0.2
    )
    resistance_factor: tuple[float, float, float] = setting(
        (1.0, 1.0, 1.0), "Factor on the resistance of each phase", minimum=0.0, maximum=10.0
    )
    copper_temperature: float = setting(
        REFERENCE_TEMPERATURE, "Winding temperature at the start", unit="degC", minimum=-60.0, maximum=300.0
    )
    copper_heat_capacity: float = setting(
        0.0, "Copper loss per rate of winding temperature; 0: constant temperature",
        unit="J/K", minimum=0.0, maximum=1e9,
    )  # fmt: skip
    copper_time_constant: float = setting(
        60.0, "Cooling of the winding to ambient_temperature", unit="s", minimum=1e-3, maximum=1e9
    )
    copper_coefficient: float = setting(
        COPPER, "Change of resistance with winding temperature", unit="1/K", minimum=0.0, maximum=0.1
    )
    magnet_temperature: float = setting(
        REFERENCE_TEMPERATURE, "Magnet temperature at the start", unit="degC", minimum=-60.0, maximum=300.0
    )
    magnet_heat_capacity: float = setting(
        0.0, "Copper, iron and eddy-current loss per rate of magnet temperature; 0: constant temperature",
        unit="J/K", minimum=0.0, maximum=1e9,
    )  # fmt: skip
    magnet_time_constant: float = setting(
        600.0, "Cooling of the magnets to ambient_temperature", unit="s", minimum=1e-3, maximum=1e9
    )
    magnet_coefficient: float = setting(
        1e-3, "Loss of magnet flux with magnet temperature", unit="1/K", minimum=0.0, maximum=0.02
    )
    ambient_temperature: float = setting(
        REFERENCE_TEMPERATURE, "Temperature that winding and magnets cool to", unit="degC", minimum=-60.0, maximum=300.0
    )


@dataclass(frozen=True)
class InverterEffects:
    """Inverter effects that the log does not show, in addition to the laws of ``inverter``.

    ``inverter: switching`` switches the legs at edges from a symmetric carrier of one sample period and min-max
    injection, with ``dead_time``, ``output_capacitance``, ``device_voltage`` and ``device_resistance``.
    """

    dead_time: float = setting(
        1e-6, "Dead time of the legs of a switching inverter", unit="s", minimum=0.0, maximum=1e-3
    )
    output_capacitance: float = setting(
        0.0, "Capacitance of each leg's output that the current charges within the dead time",
        unit="F", minimum=0.0, maximum=1e-3,
    )  # fmt: skip
    current_clamping: bool = setting(
        True, "Let a phase current that reaches zero within the dead time stay zero until its end"
    )
    drop_factor: tuple[float, float, float] = setting(
        (1.0, 1.0, 1.0), "Factor on the voltage drop of each phase", minimum=0.0, maximum=10.0
    )
    drop_asymmetry: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), "Relative increase of each phase's drop at positive current, decrease at negative current",
        minimum=-1.0, maximum=1.0,
    )  # fmt: skip
    hexagon_limit: bool = setting(
        False, "Limit the applied voltages to the hexagon of the DC link; the log stays unlimited"
    )
    voltage_limit: float = setting(
        1.0, "Largest voltage that the controller commands, of u_dc / sqrt(3)", minimum=0.1, maximum=3.0
    )

    u_dc_ripple: float = setting(
        0.0, "Amplitude of a DC-link ripple unknown to the log, fraction of u_dc", minimum=0.0, maximum=0.5
    )
    u_dc_ripple_frequency: float = setting(300.0, "Frequency of u_dc_ripple", unit="Hz", minimum=0.0, maximum=1e6)
    u_dc_drift: float = setting(
        0.0, "Amplitude of a slow DC-link drift unknown to the log, fraction of u_dc", minimum=0.0, maximum=0.5
    )
    u_dc_drift_frequency: float = setting(1.0, "Frequency of u_dc_drift", unit="Hz", minimum=0.0, maximum=1e6)


@dataclass(frozen=True)
class SensorEffects:
    """Errors of current sensors, of the resolver, and of the log."""

    current_filter: float = setting(
        0.0, "Cut-off frequency of a low-pass in the measured currents; 0: none", unit="Hz", minimum=0.0, maximum=1e6
    )
    current_filter_order: int = setting(
        1, "Order of current_filter: 1, or 2 for a Butterworth filter", minimum=1, maximum=2
    )
    current_skew: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), "Delay of each phase current's sample, less than one period",
        unit="s", minimum=0.0, maximum=1e-2,
    )  # fmt: skip
    current_dead_band: float = setting(
        0.0, "Current below which the sensors read zero; above, they read too little by it",
        unit="A", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    current_cubic: float = setting(
        0.0, "Gain error of the current sensors at i_max, proportional to the square of the current",
        minimum=-0.3, maximum=0.3,
    )  # fmt: skip
    resolver_latency: float = setting(0.0, "Delay of the measured angle", unit="s", minimum=0.0, maximum=1e-2)
    resolver_electrical_errors: tuple[float, ...] = setting(
        (), "Amplitudes of the angle error at the electrical orders 1, 2, ...", unit="rad", minimum=-0.5, maximum=0.5
    )
    resolver_electrical_phases: tuple[float, ...] = setting(
        (), "Phases of resolver_electrical_errors, a cos(n theta - phase); missing ones are 0",
        unit="rad", minimum=-1e3, maximum=1e3,
    )  # fmt: skip
    resolver_mechanical_errors: tuple[float, ...] = setting(
        (), "Amplitudes of the error of the electrical angle at the mechanical orders 1, 2, ...",
        unit="rad", minimum=-0.5, maximum=0.5,
    )  # fmt: skip
    resolver_mechanical_phases: tuple[float, ...] = setting(
        (), "Phases of resolver_mechanical_errors, a cos(n theta / p - phase); missing ones are 0",
        unit="rad", minimum=-1e3, maximum=1e3,
    )  # fmt: skip
    resolver_quantization: float = setting(
        0.0, "Quantization step of the electrical angle", unit="rad", minimum=0.0, maximum=1.0
    )
    log_zero_sequence: bool = setting(False, "Log the voltages with their min-max zero sequence")
    stamp_jitter: float = setting(
        0.0, "Random delay of the stamps, uniform up to this", unit="s", minimum=0.0, maximum=10.0
    )
    log_decimation: int = setting(1, "Log only every n-th sample; the control runs on", minimum=1, maximum=1000)


@dataclass(frozen=True)
class ShaftEffects:
    """A shaft without load machine, which the machine's own torque turns, and its friction."""

    free_shaft: bool = setting(
        False, "Let the machine's own torque turn the shaft from standstill; false: a load machine holds the speeds"
    )
    inertia: float | None = setting(
        None, "Of the free shaft; default: the largest torque accelerates it by 4000 rad/s^2",
        unit="kg m^2", minimum=1e-9, maximum=1e6,
    )  # fmt: skip
    viscous_friction: float | None = setting(
        None, "Friction torque per mechanical speed; default: 1 % of the largest torque at 100 rad/s",
        unit="N m s", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    coulomb_friction: float | None = setting(
        None, "Friction torque against any motion; default: 1 % of the largest torque",
        unit="N m", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    cogging_torque: float = setting(0.0, "Amplitude of the cogging torque", unit="N m", minimum=0.0, maximum=1e6)
    cogging_order: int = setting(
        0, "Periods of the cogging torque per revolution; 0: six per pole pair", minimum=0, maximum=10_000
    )
    load_torque: float = setting(
        0.0, "Constant torque that pulls the free shaft backwards", unit="N m", minimum=-1e6, maximum=1e6
    )
    start_angle: float = setting(0.0, "True electrical angle at the start", unit="rad", minimum=-1e3, maximum=1e3)
    angle_reversed: bool = setting(False, "The angle falls where the phases say that it rises: two are exchanged")
    angle_factor: float = setting(
        1.0, "Measured electrical angle per true one, where the drive assumes other pole pairs",
        minimum=0.01, maximum=100.0,
    )  # fmt: skip
    speed_observer: float = setting(
        0.0, "Bandwidth of a tracking observer that the speed comes from; 0: exact speed",
        unit="Hz", minimum=0.0, maximum=1e6,
    )  # fmt: skip


_GROUPS = (MachineEffects, InverterEffects, SensorEffects, ShaftEffects)
EFFECT_NAMES = tuple(field.name for group in _GROUPS for field in fields(group))
"""Names of all effects, in the order of the groups."""
LOG_ONLY = frozenset({"log_decimation", "log_zero_sequence", "stamp_jitter"})
"""Effects on the log alone, which leave the simulated drive as it is."""
