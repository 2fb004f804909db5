"""Plan an experiment without load machine: current, frequency and mean speed of the swing, inertia to add."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drive_id.core.experiment.free_shaft import FASTEST_SWING, LARGEST_BIAS, SLOWEST_SWING, FreeShaft, swing_frequency
from drive_id.core.numerics.bisection import largest_possible
from drive_id.core.planning.settings import PlanSettings, RoughMachine
from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray

AMPLITUDE = 0.95  # of the current, relative to i_max
_BANDWIDTH_SHARE = 0.25  # highest frequency of the swing relative to the bandwidth of the current controller
_VOLTAGE_SHARE = 0.9  # of the largest voltage that a swing may take: the rest is for what the rough machine leaves out
_HEAVY = 0.25  # swing relative to the highest speed below which the shaft is let run at half of that speed
_FEWEST_TURNS = 10.0  # electrical revolutions in an experiment, at least; below, the shaft creeps
_DURATION = 20.0  # s
_RIM_NODES = 721  # angles at which the torque on the rim of the disc is sought
_FREQUENCIES = 12  # highest frequencies of the swing that are tried
_PARTS = 25  # parts of the highest speed that are tried
_MAGNETS = 0.2  # mean torque by the bias, relative to the largest, below which reluctance torque prevails
_LEAST_HELD = 0.03  # the same, below which friction exceeds it, so that no mean speed can be held
_SALIENT_SHARE = 0.08
"""Highest frequency of the swing by the bandwidth where reluctance torque prevails: where i_d and i_q lag differently,
it has a mean, alternating with i_d."""
_LEAST_PART = 0.2  # smallest part of the highest speed that is left for the sake of the voltage and of the currents
_STEPS = 100  # instants in a period of the swing
_PERIODS = 13  # periods of the swing, in which i_d sweeps five times
_SETTLED = 2 * _STEPS  # instants at each end that are not judged: there the figure does not quite close
_ASSUMED = tuple(product((0.7, 1.2), (0.85, 1.1)))
"""What a current controller may assume, relative to the inductances and to the magnet flux."""
_OBSERVER = 60.0  # bandwidth of the slowest observer of the speed by which a current controller decouples, Hz
_INTEGRAL_SHARE = 0.2  # corner of the integrator of a current controller relative to its bandwidth
_DROP = 0.01  # drop of the inverter that a current controller does not know, relative to the DC link
_SATURATED = 2.0
"""Mean inductance over the incremental one at i_max, by which currents stray further than those of a linear machine."""
_HIGHEST_PEAK = 1.08  # current by i_max that a plan may expect; the publisher trips at 1.2, see _LARGEST_DISTANCE
_LARGEST_DISTANCE = 0.25
"""Mean distance of the current from its reference, by i_max, that a plan may expect; the publisher trips at 0.35. The
rest is for noise, and for what the first order leaves."""
_HIGHEST_RATE = 0.2  # bandwidth of a current controller times the sample period, at most: it acts 1.5 periods late
_RAISED = 1.25  # factor by which the bandwidth is raised until the current follows
_RPM = 30 / math.pi  # of 1 rad/s
_CREEP = 60.0 / _RPM  # usual speed of creeping, mechanical, rad/s
_EXPECTED = ((10.0, 0.05, 0.1), (30.0, 0.06, 0.2), (math.inf, 0.1, 0.5))
"""Up to a frequency of the swing, Hz: error of the flux and of the inertia, percent, that no simulated drive of
docs/engineering/free_shaft_measured.md exceeded."""


@dataclass(frozen=True)
class FreeShaftPlan:
    """The proposed experiment."""

    settings: PlanSettings
    machine: RoughMachine
    inertia: float  # of the shaft as planned, with what is added, kg m^2
    added_inertia: float  # kg m^2
    share: float  # part of the wanted amplitude of the current that the shaft allows without added inertia, 0 to 1
    acceleration: float  # by the amplitude, with added inertia, mechanical, rad/s^2
    speed_max: float  # mechanical, rad/s
    mean_speed: float  # mechanical, rad/s
    frequency: float  # Hz
    duration: float  # s
    bandwidth: float  # of the current controller that the current follows with, Hz: of the settings, or a higher one
    unheld: bool = False  # the shaft should have a mean speed, but the torque of the machine cannot hold it

    @property
    def figure(self) -> FreeShaft:
        """The trajectory."""
        return FreeShaft(AMPLITUDE * self.machine.i_max, self.frequency, self.duration)

    @property
    def swing(self) -> float:
        """Amplitude of the speed, mechanical, rad/s."""
        return self.acceleration / (2 * math.pi * self.frequency)

    @cached_property
    def course(self) -> _Course:
        """Currents, fluxes and speed over some periods of the swing, by the rough machine."""
        figure, step = self.figure, 1 / (_STEPS * self.frequency)
        i_dq = figure(figure.ramp_time + step * np.arange(_PERIODS * _STEPS, dtype=np.float64))
        psi = self.machine.flux(i_dq)
        swing = np.cumsum(psi[:, 0] * i_dq[:, 1] - psi[:, 1] * i_dq[:, 0])
        swing -= swing.mean()
        speed = self.machine.pole_pairs * (abs(self.mean_speed) + self.swing * swing / np.abs(swing).max())
        return _Course(step, i_dq, psi, speed)

    @property
    def expected(self) -> tuple[float, float]:
        """Error of the flux and of the inertia to expect, percent."""
        return next((flux, inertia) for most, flux, inertia in _EXPECTED if self.frequency <= most)

    def statements(self) -> list[str]:
        """Say why, and what accuracy to expect."""
        flux, inertia = self.expected
        low, high = (_RPM * (self.mean_speed + sign * self.swing) for sign in (-1, 1))
        said = [
            (
                f"i_q swings at {self.frequency:.3g} Hz with {AMPLITUDE * self.machine.i_max:.4g} A, by which the "
                f"shaft turns between {low:.0f} and {high:.0f} rpm for {self.duration:g} s."
            ),
            f"Simulated drives reach {flux:g} % of the largest flux and {inertia:g} % of J at such a frequency.",
        ]
        if self.mean_speed and self.swing < _HEAVY * self.speed_max:
            said.append("The rotor is heavy: it runs as a flywheel about half of the highest speed.")
        elif self.mean_speed:
            said.append(
                f"The swing alone is too small a part of a turn: the shaft creeps at {_RPM * self.mean_speed:.0f} rpm, "
                f"so that at least {_FEWEST_TURNS:.0f} electrical revolutions pass."
            )
        elif self.swing > 0.5 * self.speed_max:
            said.append("The swing through zero also tells Coulomb and viscous friction.")
        return said

    def warnings(self) -> list[str]:
        """Say what has to be changed before."""
        said = []
        if self.unheld:
            said.append(
                "The swing is small, and the torque, nearly all from reluctance, cannot hold a mean speed: reduce the "
                "inertia, or drive the shaft with a load machine."
            )
        if self.bandwidth > self.settings.current_bandwidth:
            said.append(
                "Currents would not follow the swing, for the speed and the drop of the inverter disturb a slow "
                f"current controller: raise its bandwidth from {self.settings.current_bandwidth:.3g} to "
                f"{self.bandwidth:.3g} Hz."
            )
        if self.added_inertia:
            said.append(
                f"The rotor is too light for its torque: add {self.added_inertia:.3g} kg m^2 (a disc or a coupled "
                f"rotor), or only {100 * self.share:.0f} % of i_max can be mapped at {self.frequency:.3g} Hz."
            )
        return said


def plan_free_shaft(settings: PlanSettings, inertia: float | None) -> FreeShaftPlan:
    """Plan from rough data.

    Parameters
    ----------
    settings : PlanSettings
        Machine, ``speed_max``, ``current_bandwidth``, ``duration``.
    inertia : float
        Rough inertia of the shaft, kg m^2.

    Raises
    ------
    ConfigurationError
        When machine data are missing, the machine has no torque, the DC link leaves no speed, or no current controller
        that acts each ``sample_period`` holds the currents near their references.
    """
    machine = RoughMachine.from_settings(settings)
    if inertia is None:
        raise ConfigurationError("The plan needs inertia, at least roughly: give it in kg m^2.")
    if not (math.isfinite(inertia) and inertia > 0):
        raise ConfigurationError(f"inertia is {inertia:g} kg m^2: it must be positive.")
    torque = AMPLITUDE * _largest_torque(machine)
    if not torque > 1e-9 * machine.i_max:
        raise ConfigurationError("The machine has no torque: check magnet_flux and the inductances.")
    if _BANDWIDTH_SHARE * settings.current_bandwidth < SLOWEST_SWING:
        raise ConfigurationError(
            f"current_bandwidth is {settings.current_bandwidth:g} Hz: a swing needs at least "
            f"{SLOWEST_SWING / _BANDWIDTH_SHARE:g} Hz."
        )
    bandwidth, highest = settings.current_bandwidth, _HIGHEST_RATE / (2 * math.pi * settings.sample_period)
    while True:
        for plan in _plans(settings, machine, torque, inertia, bandwidth):
            if _follows(plan):
                return plan
        if bandwidth >= highest:
            break
        bandwidth = min(_RAISED * bandwidth, highest)
    raise ConfigurationError(
        f"Currents would not follow a swing, even with a current controller of {bandwidth:.3g} Hz, for the inductances "
        "are small against the drop of an inverter: drive the shaft with a load machine, or shorten sample_period."
    )


def _plans(
    settings: PlanSettings, machine: RoughMachine, torque: float, inertia: float, bandwidth: float
) -> Iterator[FreeShaftPlan]:
    """Yield plans that the DC link allows with a current controller of this bandwidth, Hz.

    The first ones add the least inertia, and of these, the first ones swing fastest.

    Raises ConfigurationError where there is none.
    """
    followed = 60 * bandwidth / machine.pole_pairs  # one electrical turn per time of the controller
    speed_max = _fastest(machine, min(settings.speed_max, followed)) / _RPM
    held = _held_torque(machine)
    share = _BANDWIDTH_SHARE if held > _MAGNETS else _SALIENT_SHARE
    fastest = min(FASTEST_SWING, max(share * bandwidth, SLOWEST_SWING))
    plans = [
        _planned(settings, machine, torque, inertia, float(part) * speed_max, float(highest), bandwidth)
        for highest in np.geomspace(fastest, SLOWEST_SWING, _FREQUENCIES)
        for part in np.linspace(1.0, _LEAST_PART, _PARTS)
    ]
    if held < _LEAST_HELD:
        plans = [replace(plan, mean_speed=0.0, unheld=plan.mean_speed != 0.0) for plan in plans]
    most, found = _VOLTAGE_SHARE * machine.largest_voltage, False
    for plan in sorted(plans, key=lambda plan: (plan.inertia, -plan.speed_max)):
        if _swing_voltage(plan) <= most:
            found = True
            yield plan
    if not found:
        raise ConfigurationError(
            f"The DC link of {machine.u_dc:g} V does not suffice for a swing at {SLOWEST_SWING:g} Hz with i_max: "
            "reduce i_max."
        )


def _held_torque(machine: RoughMachine) -> float:
    """Return the mean torque that the bias of i_q can hold, relative to the largest: reluctance torque has none."""
    figure = FreeShaft(AMPLITUDE * machine.i_max, 1.0, 1e3)
    i_dq = figure(figure.ramp_time + np.arange(_PERIODS * _STEPS, dtype=np.float64) / _STEPS, LARGEST_BIAS)
    psi = machine.flux(i_dq)
    torque = psi[:, 0] * i_dq[:, 1] - psi[:, 1] * i_dq[:, 0]
    return float(abs(torque.mean()) / np.abs(torque).max())


def _planned(
    settings: PlanSettings,
    machine: RoughMachine,
    torque: float,
    inertia: float,
    speed_max: float,
    fastest: float,
    bandwidth: float,
) -> FreeShaftPlan:
    """Plan for a highest mechanical speed, rad/s, a highest frequency of the swing, and a bandwidth, both Hz."""
    wanted = swing_frequency(torque / inertia, speed_max)
    duration = settings.duration or min(_DURATION, settings.duration_max)
    frequency = min(wanted, fastest)
    total = inertia * wanted / frequency
    swing = torque / total / (2 * math.pi * frequency)
    mean_speed = 0.0
    if swing < _HEAVY * speed_max and wanted == SLOWEST_SWING:
        mean_speed = 0.5 * speed_max
    elif 2 * swing * machine.pole_pairs / (2 * math.pi * frequency) < 2 * math.pi:  # from one reversal to the next
        mean_speed = min(2 * math.pi * _FEWEST_TURNS / machine.pole_pairs / duration, 0.5 * speed_max)
        mean_speed = max(mean_speed, min(_CREEP, 0.25 * speed_max))
        wanted = swing_frequency(torque / inertia, speed_max, mean_speed)
        frequency = min(wanted, fastest)
        total = inertia * wanted / frequency
    share = inertia / total
    return FreeShaftPlan(
        settings, machine, total, total - inertia, share, torque / total, speed_max, mean_speed, frequency, duration,
        bandwidth,
    )  # fmt: skip


class _Course(NamedTuple):
    """Currents (N, 2), A, fluxes (N, 2), Wb, and speed (N,), electrical rad/s, over periods of a swing."""

    step: float  # s
    i_dq: FloatArray
    psi: FloatArray
    speed: FloatArray


def _swing_voltage(plan: FreeShaftPlan) -> float:
    """Return the largest amplitude ``|R i + omega J psi + dpsi/dt|`` of a swing, V: the currents change as it turns."""
    step, i_dq, psi, speed = plan.course
    u_d, u_q = (plan.machine.resistance * i_dq + np.gradient(psi, step, axis=0)).T
    return float(np.hypot(u_d - speed * psi[:, 1], u_q + speed * psi[:, 0]).max())


def _follows(plan: FreeShaftPlan) -> bool:
    """Whether currents stay near their references with whatever a current controller may assume."""
    return all(
        peak <= _HIGHEST_PEAK and distance <= _LARGEST_DISTANCE
        for peak, distance in (_strayed(plan, *assumed) for assumed in _ASSUMED)
    )


def _strayed(plan: FreeShaftPlan, inductance: float, magnet: float) -> tuple[float, float]:
    """Return the peak of the current, and its mean distance from the reference, relative to i_max, to first order.

    A controller with proportional gain ``a k L`` and integrator, which feeds forward ``d/dt psi' + omega' J psi'`` by
    an assumed flux psi' and an observed speed omega', leaves a voltage v, and by it a current v H(s) / L with
    ``H = s / (s^2 + a k s + a_i a k)``.
    """
    machine, (step, i_dq, psi, speed) = plan.machine, plan.course
    s = 2j * np.pi * np.fft.rfftfreq(len(speed), step)

    def filtered(signal: FloatArray, response: NDArray[np.complexfloating]) -> FloatArray:
        return np.fft.irfft(np.fft.rfft(signal) * response, len(signal))

    rate, a = 2 * np.pi * _OBSERVER, 2 * np.pi * plan.bandwidth
    observed = filtered(speed, (rate / (s + rate)) ** 2)
    linear = machine.inductance * i_dq
    assumed = inductance * linear + np.array([magnet * machine.magnet_flux, 0.0])
    left = (inductance - 1) * np.gradient(linear, step, axis=0)
    left[:, 0] -= observed * assumed[:, 1] - speed * psi[:, 1]
    left[:, 1] += observed * assumed[:, 0] - speed * psi[:, 0]
    left -= _DROP * machine.u_dc * i_dq / np.hypot(*i_dq.T)[:, None]
    gain = a * inductance
    response = s / (s**2 + gain * s + _INTEGRAL_SHARE * a * gain)
    off = np.stack([filtered(left[:, k], response) for k in range(2)], axis=-1) * _SATURATED / machine.inductance
    off, i_dq = off[_SETTLED:-_SETTLED], i_dq[_SETTLED:-_SETTLED]
    return float(np.hypot(*(i_dq + off).T).max()) / machine.i_max, float(np.hypot(*off.T).mean()) / machine.i_max


def _largest_torque(machine: RoughMachine) -> float:
    """Return the largest torque on the rim of the disc, Nm."""
    angle = np.linspace(0.0, 2 * np.pi, _RIM_NODES)
    i_d, i_q = machine.i_max * np.cos(angle), machine.i_max * np.sin(angle)
    psi = machine.flux(np.stack([i_d, i_q], axis=-1))
    return float(1.5 * machine.pole_pairs * np.max(psi[:, 0] * i_q - psi[:, 1] * i_d))


def _fastest(machine: RoughMachine, limit: float) -> float:
    """Return the highest speed that the DC link allows on the whole disc, up to a limit, rpm."""
    most = _VOLTAGE_SHARE * machine.largest_voltage
    if machine.steady_voltage(limit) <= most:
        return limit
    if machine.steady_voltage(0.0) >= most:
        raise ConfigurationError(
            f"The DC link of {machine.u_dc:g} V does not suffice for i_max at standstill: reduce i_max."
        )
    return largest_possible(lambda speed: machine.steady_voltage(speed) <= most, limit)
