"""The simulated drive: machine, inverter, sensors and controller, simulated in blocks or at once."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from drive_id.bench import effects, kernels, parameters
from drive_id.bench.effects import Course
from drive_id.bench.inverter import drop_curve, phase_drop_of
from drive_id.bench.machine import Machine
from drive_id.bench.profile import SpeedProfile
from drive_id.bench.real_drive import run
from drive_id.bench.scalars import SCALAR_SETTINGS, logged_scalars
from drive_id.bench.settings import SimulationSettings
from drive_id.common.quantity import counted
from drive_id.core.experiment.encoder import Encoder
from drive_id.errors import ConfigurationError, DataError
from drive_id.types import FloatArray, GroundTruth, MachineMap, Samples

SETTLING_TIME = 0.05  # for which the drive runs at its first reference before the first sample, s
_TRUTH_NODES = 81  # of the true map, along each axis
_INTERRUPTIBLE = 20_000  # samples simulated in one call
_FLUX_TOLERANCE = 3e-8
"""Largest error per integration step from the bend of the inverter curve, relative to the largest flux."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedBlock:
    """A block of a simulated experiment, or all of it."""

    samples: Samples  # as measured and logged by the drive
    i_dq_true: FloatArray  # (N, 2), true phase currents at the samples in the true rotor frame, A
    angle_true: FloatArray  # (N,), true electrical angle at the samples, not wrapped to one turn, rad
    course: Course | None = None  # (N,) of dtype effects.COURSE: inner quantities of a drive with effects


@dataclass(frozen=True, eq=False, kw_only=True)
class Simulation(SimulatedBlock):
    """A simulated experiment and its ground truth."""

    truth: GroundTruth
    machine: Machine  # whose ``mean_flux`` is the truth at any current


class Drive:
    """A simulated drive that runs in blocks and keeps its state between them.

    Parameters
    ----------
    i_dq_start : (2,) tuple of float, optional
        Reference at which the drive settles before the first sample, A.
    duration : float, optional
        Duration of the experiment, s; needed for several speeds without segment durations.

    Raises
    ------
    ConfigurationError
        When the speeds do not fit into the duration, or the drive does not settle at its start.
    """

    def __init__(
        self,
        machine: Machine,
        settings: SimulationSettings,
        *,
        i_dq_start: tuple[float, float] = (0.0, 0.0),
        duration: float | None = None,
    ) -> None:
        self.machine = machine
        self.settings = settings
        rest = SpeedProfile(np.zeros(1), np.zeros(1))
        self.profile = rest if settings.free_shaft else SpeedProfile.from_settings(settings, duration)
        self.drop = phase_drop_of(settings, machine.u_dc, machine.i_max)
        self._plant, self._controller, self._sensors = _kernel_parameters(machine, settings, self.drop)
        self._generators = [
            np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(settings.seed).spawn(4)
        ]
        self._state = _start(self._plant, self._controller, self._speed(np.zeros(1))[0], i_dq_start, settings)
        settling = np.full((max(parameters.HISTORY, round(SETTLING_TIME / settings.sample_period)), 2), i_dq_start)
        self._acting = effects.acts_inside(settings)
        self._effects = effects.effects_of(machine, settings)
        self._more = effects.effect_state(settings, self._effects, self._plant, self._state)
        self._effects.free_shaft = False  # the shaft is held while the drive settles
        self._next = -len(settling)
        self._run(settling, np.full(len(settling) + 1, self._speed(np.zeros(1))[0]))
        self._next = 0
        self._more.temperature[:] = settings.copper_temperature, settings.magnet_temperature
        self._more.energy[:] = 0.0  # settling neither warms nor counts
        self._effects.free_shaft = settings.free_shaft

    @property
    def stator_frame(self) -> bool:
        """Whether the references are alpha and beta, which only a free shaft takes."""
        return bool(self._effects.stator_frame)

    @stator_frame.setter
    def stator_frame(self, wanted: bool) -> None:
        self._effects.stator_frame = wanted and self.settings.free_shaft

    def set_encoder(self, encoder: Encoder) -> None:
        """Take the angle of the resolver, with its faults, as raw from the next sample on."""
        raw = effects.angle_scale(self.settings)
        self._effects.angle_scale = encoder.factor * raw
        offset = encoder.factor * self.settings.resolver_offset - encoder.encoder_offset
        self._sensors = self._sensors._replace(angle_offset=offset)

    @property
    def time(self) -> float:
        """Time of the next sample, s."""
        return self._next * self.settings.sample_period

    def step_block(self, i_dq_reference: FloatArray) -> SimulatedBlock:
        """Run the drive over the samples of one block.

        Parameters
        ----------
        i_dq_reference : (N, 2) float
            References, each valid from its sample on, A; with ``log_decimation``, fewer samples than these are logged.

        Raises
        ------
        DataError
            When the references have the wrong shape or are not finite, or no sample of the block is logged.
        ConfigurationError
            When the currents run away to where the machine's map cannot be inverted.
        """
        reference = _checked(i_dq_reference)
        n = len(reference)
        period = self.settings.sample_period
        ticks = self._next + np.arange(n + 1, dtype=np.float64)
        every = self.settings.log_decimation
        logged = slice(-self._next % every, None, every)
        if logged.start >= n:
            raise DataError(
                f"None of the {counted(n, 'sample')} is logged with log_decimation {every}: give longer blocks."
            )
        out, course = self._run(reference, self._speed(ticks * period))
        self._next += n
        stamp, u_abc = ticks[:-1][logged] * (period * 1e9), out.u_abc[logged]
        if self.settings.stamp_jitter > 0:
            stamp += self._generators[3].uniform(0, self.settings.stamp_jitter * 1e9, len(stamp))
        if self.settings.log_zero_sequence:
            u_abc = u_abc - 0.5 * (u_abc.max(axis=1, keepdims=True) + u_abc.min(axis=1, keepdims=True))
        i_dq, angle = out.i_dq_true[logged], out.angle_true[logged]
        inner: Any = None if course is None else course[logged]
        scalars: dict[str, Any] = logged_scalars(self.settings, self.machine, i_dq, angle, inner)
        samples = Samples(
            stamp=np.round(stamp).astype(np.int64),
            i_abc=out.i_abc[logged],
            u_abc=u_abc,
            angle=out.angle[logged],
            speed=out.speed[logged],
            sample_period=period * every,
            i_dq_reference=reference[logged].copy(),
            **scalars,
        )
        return SimulatedBlock(samples=samples, i_dq_true=i_dq, angle_true=angle, course=inner)

    def truth(self) -> GroundTruth:
        """Return the ground truth of this drive."""
        machine = self.machine
        axis = np.linspace(-machine.i_max, machine.i_max, _TRUTH_NODES)
        psi = machine.mean_flux(axis[:, None], axis[None, :])
        current, voltage = drop_curve(self.drop, machine.i_max)
        voltage *= np.mean(self.settings.drop_factor)
        recorded = effects.recorded(self.settings)
        details = {
            field.name: value if isinstance(value, (str, int, float)) else str(value)
            for field in dataclasses.fields(self.settings)
            if (value := getattr(self.settings, field.name)) is not None
            and field.name in recorded
            and (self.settings.log_scalars or field.name not in SCALAR_SETTINGS)
        } | {"u_dc": machine.u_dc}
        if self._acting:
            details |= effects.truth_of(self.settings, machine, self._more, self.time)
        return GroundTruth(
            machine=machine.name,
            i_d=axis,
            i_q=axis.copy(),
            psi_d=psi[..., 0].copy(),
            psi_q=psi[..., 1].copy(),
            resistance=machine.resistance,
            inverter_current=current,
            inverter_voltage=voltage,
            i_max=machine.i_max,
            pole_pairs=machine.pole_pairs,
            details=details,
        )

    def _speed(self, time: FloatArray) -> FloatArray:
        return self.profile.electrical(time, self.machine.pole_pairs)

    def _run(self, reference: FloatArray, speed: FloatArray) -> tuple[parameters.Signals, Course | None]:
        n = len(reference)
        s = self.settings
        deviations = (s.current_noise * self.machine.i_max, s.resolver_noise, s.speed_noise)
        shapes: tuple[tuple[int, ...], ...] = ((n, 3), (n,), (n,))
        noise = parameters.Noise(
            *(
                deviation * generator.standard_normal(shape) if deviation > 0 else np.zeros(shape)
                for deviation, generator, shape in zip(deviations, self._generators[:3], shapes, strict=True)
            )
        )
        shapes = ((n, 3), (n, 3), (n,), (n,), (n, 2), (n,))
        out = parameters.Signals(*(np.empty(shape) for shape in shapes))
        course = np.recarray(n if self._acting else min(n, _INTERRUPTIBLE), effects.COURSE)
        for start in range(0, n, _INTERRUPTIBLE):  # between calls, Ctrl-C is heard
            stop = min(start + _INTERRUPTIBLE, n)
            part: Any = course[start:stop] if self._acting else course[: stop - start]
            failed = run(
                self._plant, self._effects, self._controller, self.drop, self._sensors, self._state, self._more,
                2 * math.pi * self.machine.pole_pairs, self._next + start, reference[start:stop],
                speed[start : stop + 1], parameters.Noise(*(signal[start:stop] for signal in noise)),
                parameters.Signals(*(signal[start:stop] for signal in out)), part,
            )  # fmt: skip
            if failed >= 0:
                raise ConfigurationError(
                    f"The simulation broke off at {self.time + (start + failed) * s.sample_period:.4f} s, where no "
                    f"current belongs to the flux on the map of machine '{self.machine.name}': check the map, or "
                    "reduce i_max or current_bandwidth."
                )
        return out, course if self._acting else None


def _checked(i_dq_reference: FloatArray) -> FloatArray:
    reference = np.ascontiguousarray(i_dq_reference, dtype=np.float64)
    if reference.ndim != 2 or reference.shape[1] != 2 or not len(reference) or not np.isfinite(reference).all():
        raise DataError(f"The references have shape {reference.shape}: give finite (N, 2) amperes with N >= 1.")
    return reference


def _kernel_parameters(
    machine: Machine, settings: SimulationSettings, drop: parameters.PhaseDrop
) -> tuple[parameters.Plant, parameters.Controller, parameters.Sensors]:
    plant = parameters.Plant(
        table=machine.table,
        resistance=machine.resistance,
        drop=drop._replace(dead_time_voltage=0.0) if settings.inverter == "switching" else drop,
        ripple=settings.speed_ripple,
        ripple_order=settings.ripple_order / machine.pole_pairs,
        period=settings.sample_period,
        current_tolerance=1e-6 * machine.i_max,
        flux_tolerance=_FLUX_TOLERANCE * float(np.abs(machine.mean_flux(machine.i_max, machine.i_max)).max()),
    )
    bandwidth = min(2 * math.pi * settings.current_bandwidth, 0.2 / settings.sample_period)
    controller = parameters.Controller(
        table=_assumed(machine, settings),
        resistance=machine.resistance,
        bandwidth=bandwidth,
        integral_rate=0.2 * bandwidth,
        u_max=settings.voltage_limit * machine.u_dc / math.sqrt(3),
        compensate=settings.inverter_compensation,
    )
    lead = math.floor(settings.voltage_delay)
    sensors = parameters.Sensors(
        current_gain=np.array(settings.current_gain),
        current_offset=np.array(settings.current_offset),
        current_quantum=settings.current_quantization,
        two=settings.two_current_sensors,
        angle_offset=settings.resolver_offset,
        log_lead=lead,
        held_fraction=settings.voltage_delay - lead,
    )
    return plant, controller, sensors


def _assumed(machine: Machine, settings: SimulationSettings) -> parameters.SplineTable:
    """Return the rough map with the errors of what the controller assumes: k_psi psi(0) + k_L (psi(i) - psi(0))."""
    factor, magnet = settings.controller_inductance, settings.controller_flux
    if factor == magnet == 1.0:
        return machine.rough
    at_zero = machine.mean_flux(0.0, 0.0)[None, None, :, None]
    return machine.rough._replace(coefficients=factor * machine.rough.coefficients + (magnet - factor) * at_zero)


def _start(
    plant: parameters.Plant,
    controller: parameters.Controller,
    speed: float,
    i_dq: tuple[float, float],
    settings: SimulationSettings,
) -> parameters.DriveState:
    """Return the state at the start angle with the current on its reference and the voltage that about keeps it."""
    angle = settings.start_angle
    psi = kernels.evaluate(plant.table, *i_dq, angle)[:2]
    resistance = controller.resistance
    u = complex(resistance * i_dq[0] - speed * psi[1], resistance * i_dq[1] + speed * psi[0])
    u *= min(1.0, controller.u_max / max(abs(u), 1e-9))
    turned = u * np.exp(1j * (angle + 0.5 * speed * plant.period - 2 * np.pi / 3 * np.arange(3)))
    flux = complex(*psi) * np.exp(1j * angle)
    return parameters.DriveState(
        flux=np.array((flux.real, flux.imag)),
        current=np.array(i_dq, np.float64),
        mean_angle=np.full(1, angle),
        integral=np.zeros(2),
        flux_reference=np.tile(np.array(psi), (3, 1)),
        commands=np.tile(turned.real, (parameters.HISTORY, 1)),
        compensations=np.zeros((parameters.HISTORY, 3)),
    )


def simulate(machine_map: MachineMap, settings: SimulationSettings, i_dq_reference: FloatArray) -> Simulation:
    """Run an experiment on a simulated drive.

    Parameters
    ----------
    machine_map : MachineMap
        A shipped machine (:func:`drive_id.bench.machines.machine_map`) or one from a file.
    i_dq_reference : (N, 2) float
        References, one for each sample, A.

    Raises
    ------
    ConfigurationError
        When machine and settings do not make an experiment.
    DataError
        When the references have the wrong shape or are not finite.
    """
    machine = build_machine(machine_map, settings)
    reference = _checked(i_dq_reference)
    start = (float(reference[0, 0]), float(reference[0, 1]))
    drive = Drive(machine, settings, i_dq_start=start, duration=len(reference) * settings.sample_period)
    return Simulation(**vars(drive.step_block(reference)), truth=drive.truth(), machine=machine)


def build_machine(machine_map: MachineMap, settings: SimulationSettings) -> Machine:
    """Build the machine that the settings ask for, see :meth:`drive_id.bench.machine.Machine.from_map`."""
    return Machine.from_map(
        machine_map, harmonics=settings.harmonics, sixth_harmonic=settings.sixth_harmonic, i_max=settings.i_max
    )
