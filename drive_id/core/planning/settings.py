"""Inputs of the planner: rough data of the drive, limits of the bench, wanted accuracy."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drive_id.common.settings import Checked, setting
from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray, MachineMap

_RIM_NODES = 720  # angles at which the voltage on the rim of the disc is sought


@dataclass(frozen=True)
class PlanSettings(Checked):
    """Rough data of the drive, limits of the bench, and the wanted accuracy."""

    i_max: float | None = setting(None, "Radius of the current disc to map", unit="A", minimum=1e-3)
    pole_pairs: int | None = setting(None, "Pole pairs", minimum=1, maximum=1000)
    resistance: float | None = setting(None, "Rough stator resistance", unit="ohm", minimum=1e-9)
    inductance_d: float | None = setting(None, "Rough d inductance over the disc", unit="H", minimum=1e-9)
    inductance_q: float | None = setting(None, "Rough q inductance over the disc", unit="H", minimum=1e-9)
    magnet_flux: float | None = setting(None, "Rough flux linkage of the magnets", unit="Wb")
    u_dc: float | None = setting(None, "DC-link voltage", unit="V", minimum=1e-3)
    sample_period: float = setting(1e-4, "Period of sampling and control", unit="s", minimum=1e-6, maximum=1e-2)
    current_noise: float = setting(
        1e-3, "Standard deviation of the current noise as a fraction of i_max", minimum=1e-7, maximum=0.1
    )
    current_bandwidth: float = setting(200.0, "Bandwidth of the current controller", unit="Hz", minimum=1.0)
    frequency_max: float = setting(
        12.0,
        "Highest frequency of the references, at which the torque does not yet disturb the speed of the load machine",
        unit="Hz", minimum=0.1, maximum=1e3,
    )  # fmt: skip
    speed_min: float = setting(
        250.0, "Lowest mechanical speed allowed; voltage errors weigh most there", unit="rpm", minimum=1.0
    )
    speed_max: float = setting(1500.0, "Highest mechanical speed allowed", unit="rpm", minimum=1.0, maximum=1e6)
    reverse: bool = setting(True, "Whether the shaft may turn in both directions")
    accuracy: float = setting(
        0.05, "Target standard error of the flux, in percent of its largest value", minimum=1e-4, maximum=10.0
    )
    duration: float | None = setting(
        None,
        "Duration of the experiment, all speeds together; default: as the accuracy requires",
        unit="s",
        minimum=2.0,
    )
    duration_max: float = setting(60.0, "Longest duration of the experiment", unit="s", minimum=2.0, maximum=1e5)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.speed_min > self.speed_max:
            raise ConfigurationError(
                f"speed_min is {self.speed_min:g} rpm and speed_max {self.speed_max:g} rpm: give a range that is not "
                "empty."
            )
        if self.duration is not None and self.duration > self.duration_max:
            raise ConfigurationError(
                f"duration is {self.duration:g} s and duration_max {self.duration_max:g} s: shorten the one or raise "
                "the other."
            )


@dataclass(frozen=True)
class RoughMachine:
    """Linear model of the machine, as known before the experiment."""

    i_max: float  # radius of the current disc, A
    pole_pairs: int
    resistance: float  # ohm
    inductance_d: float  # H
    inductance_q: float  # H
    magnet_flux: float  # Wb
    u_dc: float  # V

    @classmethod
    def from_settings(cls, settings: PlanSettings) -> RoughMachine:
        """Take the machine from complete settings; raises ConfigurationError that names what is missing."""
        names = tuple(cls.__dataclass_fields__)
        missing = [name for name in names if getattr(settings, name) is None]
        if missing:
            raise ConfigurationError(
                f"The plan needs {', '.join(missing)}: give {'it' if len(missing) == 1 else 'them'}, or a machine to "
                "take everything from."
            )
        return cls(**{name: getattr(settings, name) for name in names})

    @classmethod
    def from_map(cls, machine_map: MachineMap, i_max: float) -> RoughMachine:
        """Fit a linear machine to a map over the disc of ``i_max``, A, by least squares."""
        d, q = np.meshgrid(machine_map.i_d, machine_map.i_q, indexing="ij")
        inside = np.hypot(d, q) <= i_max
        columns = np.stack([np.ones(int(inside.sum())), d[inside]], axis=1)
        magnet, inductance_d = np.linalg.lstsq(columns, machine_map.psi_d[inside], rcond=None)[0]
        inductance_q = float(q[inside] @ machine_map.psi_q[inside] / (q[inside] @ q[inside]))
        return cls(
            i_max, machine_map.pole_pairs, machine_map.resistance, float(inductance_d), inductance_q, float(magnet),
            machine_map.u_dc,
        )  # fmt: skip

    @property
    def inductance(self) -> FloatArray:
        """Of d and q, (2,), H."""
        return np.array([self.inductance_d, self.inductance_q])

    @property
    def largest_flux(self) -> FloatArray:
        """Largest absolute flux linkage of d and q on the disc, (2,), Wb."""
        return np.asarray(self.inductance * self.i_max + np.array([abs(self.magnet_flux), 0.0]))

    @property
    def largest_voltage(self) -> float:
        """Largest amplitude that the DC link allows, ``u_dc / sqrt(3)``, V."""
        return self.u_dc / math.sqrt(3)

    def electrical(self, speed: float) -> float:
        """Return the electrical speed, rad/s, at a mechanical one, rpm."""
        return speed * (2 * math.pi / 60) * self.pole_pairs

    def flux(self, i_dq: FloatArray) -> FloatArray:
        """Return the flux linkages (..., 2), Wb, at currents (..., 2), A."""
        return np.asarray(self.inductance * i_dq + np.array([self.magnet_flux, 0.0]))

    def steady_voltage(self, speed: float) -> float:
        """Return the largest amplitude ``|R i + omega J psi|`` over the disc, V, at a mechanical speed, rpm."""
        angle = np.linspace(0.0, 2 * np.pi, _RIM_NODES, endpoint=False)
        i_dq = self.i_max * np.stack([np.cos(angle), np.sin(angle)], axis=-1)  # convex in i, so largest on the rim
        psi, omega = self.flux(i_dq), self.electrical(speed)
        u_d = self.resistance * i_dq[:, 0] - omega * psi[:, 1]
        u_q = self.resistance * i_dq[:, 1] + omega * psi[:, 0]
        return float(np.hypot(u_d, u_q).max())
