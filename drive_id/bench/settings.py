"""Settings of the simulated drive and of the bench that runs it in real time."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.bench.effect_settings import MOST_ORDERS, InverterEffects, MachineEffects, SensorEffects, ShaftEffects
from drive_id.common.quantity import counted
from drive_id.common.settings import Checked, setting
from drive_id.errors import ConfigurationError
from drive_id.types import SCALARS

INVERTERS = ("none", "tanh", "dead_time", "two_stage", "switching")


@dataclass(frozen=True)
class SimulationSettings(MachineEffects, InverterEffects, SensorEffects, ShaftEffects, Checked):
    """Settings of the simulated drive; faults act inside the control loop, zero switches them off."""

    i_max: float | None = setting(
        None, "Largest current amplitude; default: the machine's, as far as its map reaches",
        unit="A", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    sample_period: float = setting(1e-4, "Period of sampling and control", unit="s", minimum=1e-6, maximum=1e-2)
    seed: int = setting(0, "Seed of all noise", minimum=0, maximum=2**63 - 1)
    substeps: int = setting(2, "Integration steps of the machine per sample", minimum=1, maximum=1000)
    harmonics: float = setting(1.0, "Factor on the machine's rotor-position harmonics", minimum=0.0, maximum=1.0)
    sixth_harmonic: float = setting(
        0.0, "Sixth harmonic to add to the flux, as a fraction of it", minimum=0.0, maximum=0.2
    )
    speeds: tuple[float, ...] = setting(
        (500.0,), "Mechanical speeds, one after the other; negative: backwards", unit="rpm", minimum=-1e6, maximum=1e6
    )
    segment_durations: tuple[float, ...] = setting(
        (), "Duration at each speed; default: equal shares", unit="s", minimum=0.0, maximum=1e6
    )
    ramp_time: float = setting(
        0.1, "Duration of the ramp that begins each further speed", unit="s", minimum=0.0, maximum=1e6
    )
    speed_ripple: float = setting(0.0, "Amplitude of the speed ripple as a fraction of speed", minimum=0.0, maximum=0.5)
    ripple_order: int = setting(1, "Periods of the speed ripple per mechanical revolution", minimum=1, maximum=1000)
    inverter: str = setting("dead_time", "Model of the inverter's voltage error", choices=INVERTERS)
    inverter_voltage: float | None = setting(
        None, "Voltage error at large current; default: 1 % of the DC link", unit="V", minimum=0.0, maximum=1e6
    )
    inverter_current: float | None = setting(
        None, "Current scale of the voltage error; default: 1 % of i_max", unit="A", minimum=1e-9, maximum=1e6
    )
    device_voltage: float | None = setting(
        None, "Threshold of the devices in two_stage and switching; default: 0.25 % of the DC link",
        unit="V", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    device_resistance: float | None = setting(
        None, "Slope of the devices in two_stage and switching; default: 0.2 % of the DC link at i_max",
        unit="ohm", minimum=0.0, maximum=1e3,
    )  # fmt: skip
    inverter_compensation: bool = setting(False, "Compensate the voltage error in the commands")
    current_noise: float = setting(
        0.0, "Standard deviation of the current noise as a fraction of i_max", minimum=0.0, maximum=1.0
    )
    current_gain: tuple[float, float, float] = setting(
        (1.0, 1.0, 1.0), "Gain of each current sensor", minimum=-1e3, maximum=1e3
    )
    two_current_sensors: bool = setting(False, "Measure two currents only: that of phase c follows from them")
    current_offset: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), "Offset of each current sensor", unit="A", minimum=-1e6, maximum=1e6
    )
    current_quantization: float = setting(0.0, "Quantization step of the currents", unit="A", minimum=0.0, maximum=1e6)
    resolver_offset: float = setting(0.0, "Measured minus true electrical angle", unit="rad", minimum=-1e3, maximum=1e3)
    resolver_noise: float = setting(
        0.0, "Standard deviation of the electrical angle's noise", unit="rad", minimum=0.0, maximum=10.0
    )
    speed_noise: float = setting(
        0.0, "Standard deviation of the electrical speed's noise", unit="rad/s", minimum=0.0, maximum=1e6
    )
    voltage_delay: float = setting(
        0.0, "Delay of the voltages relative to the log", unit="samples", minimum=-4.0, maximum=1.99
    )
    current_bandwidth: float = setting(
        200.0, "Bandwidth of the current controller, at most 3 % of the sampling frequency",
        unit="Hz", minimum=1.0, maximum=1e5,
    )  # fmt: skip
    controller_inductance: float = setting(
        1.0, "Factor on the inductances that the current controller assumes", minimum=0.1, maximum=10.0
    )
    controller_flux: float = setting(
        1.0, "Factor on the magnet flux that the current controller assumes", minimum=0.0, maximum=10.0
    )
    log_scalars: tuple[str, ...] = setting((), "Optional signals to log", choices=SCALARS)
    scalar_rate: float = setting(
        0.0, "Rate of dc_link_voltage and shaft_torque in bags and topics; 0: every sample",
        unit="Hz", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    temperature_rate: float = setting(
        10.0, "Rate of temperatures in bags and topics; 0: every sample", unit="Hz", minimum=0.0, maximum=1e6
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.speeds:
            raise ConfigurationError("speeds is empty: give at least one speed in rpm.")
        if self.segment_durations and len(self.segment_durations) != len(self.speeds):
            raise ConfigurationError(
                f"segment_durations has {counted(len(self.segment_durations), 'entry', 'entries')} "
                f"for {counted(len(self.speeds), 'speed')}: give one "
                "for each, or none for equal shares."
            )
        if self.i_max == 0.0:
            raise ConfigurationError("i_max is 0 A: it must be positive.")
        self._check_effects()

    def _check_effects(self) -> None:
        for kind in ("electrical", "mechanical"):
            errors, phases = (len(getattr(self, f"resolver_{kind}_{what}")) for what in ("errors", "phases"))
            if phases > errors:
                raise ConfigurationError(
                    f"resolver_{kind}_phases has {counted(phases, 'entry', 'entries')} and "
                    f"resolver_{kind}_errors {errors}: give at most "
                    "one for each."
                )
        for name in ("eccentricity", "resolver_electrical_errors", "resolver_mechanical_errors"):
            if len(getattr(self, name)) > MOST_ORDERS:
                raise ConfigurationError(
                    f"{name} has {counted(len(getattr(self, name)), 'entry', 'entries')}: give at "
                    f"most {MOST_ORDERS}, for the orders 1 to "
                    f"{MOST_ORDERS}."
                )
        if sum(abs(amplitude) for amplitude in self.eccentricity) > 0.5:
            raise ConfigurationError("The amplitudes of eccentricity sum up to more than 0.5: reduce them.")
        if max(self.current_skew) >= self.sample_period:
            raise ConfigurationError(
                f"current_skew reaches {max(self.current_skew):g} s, a sample period or more: use voltage_delay for "
                "whole samples."
            )
        if self.stamp_jitter >= self.sample_period * self.log_decimation:
            raise ConfigurationError(
                f"stamp_jitter is {self.stamp_jitter:g} s, at least the period of the log: reduce it, so that the "
                "stamps increase."
            )
        if self.inverter == "switching" and self.dead_time > 0.25 * self.sample_period:
            raise ConfigurationError(
                f"dead_time is {self.dead_time:g} s, more than a quarter of the switching period of "
                f"{self.sample_period:g} s: reduce it."
            )
        if self.inverter == "switching" and self.voltage_delay % 1.0 != 0.0:
            raise ConfigurationError(
                f"voltage_delay is {self.voltage_delay:g} samples: with inverter switching it must be a whole number."
            )


@dataclass(frozen=True)
class BenchSettings(Checked):
    """Settings of the simulated bench."""

    machine: str = setting("ipm", "Shipped machine by name, or a machine file (.npz, SyR-e .mat)")
    block_size: int = setting(100, "Samples per message", minimum=1, maximum=10_000)
    time_scale: float = setting(
        1.0,
        "Simulated time per real time; other than 1, this node publishes /clock, and all others must set use_sim_time",
        minimum=0.001, maximum=100.0,
    )  # fmt: skip
    zero_slew_rate: float = setting(
        10000.0, "|di/dt| to zero current when references run out", unit="A/s", minimum=1.0, maximum=1e9
    )
    speed_limit: float = setting(
        10000.0, "Mechanical speed in both directions above which the drive switches off",
        unit="rpm", minimum=1.0, maximum=1e6,
    )  # fmt: skip
    frame_id: str = setting("drive", "Name of the drive in the message headers")
    truth_file: str = setting("", "File for the ground truth of the simulated machine (.npz); empty: none")
