"""Random drives of the population: machine, inverter, sensors, effects and experiment, and their simulation."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from population_machines import FAMILIES, CoEnergy, Machine, Measured, Random, random_shape

from drive_id.bench.drive import build_machine
from drive_id.bench.effects import largest_torque
from drive_id.bench.inverter import drop_curve, phase_drop_of
from drive_id.bench.settings import SimulationSettings
from drive_id.bench.swing import Swing
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.planning.free_shaft import plan_free_shaft
from drive_id.core.planning.settings import PlanSettings, RoughMachine
from drive_id.errors import ConfigurationError
from drive_id.fitting.simulated import run_experiment
from drive_id.types import FloatArray, Samples

_FASTEST_FIELD = (2e-3, 5e-4)
"""Least electrical time constant L / R, of machines with iron teeth and of slotless ones, s."""

Changes = dict[str, Any]
Spoil = Callable[[Samples], Samples]

_SHARES = (0.5, 0.8, 0.93)
"""Cumulative shares of drives with no effect, one and two; the others have three."""
_MOST_SAMPLES, _SHORTEST = 200_000, 5.0
"""Samples of all recordings, and seconds of each."""
_WIDE = 0.1
"""Width of an inverter curve, in the largest current, above which docs/limits.md takes it for resistance."""
_FASTEST, _SLOWEST = 0.09, 3.0
"""Electrical frequency: at most, of the sampling rate; at least, Hz."""
_MOST_RIPPLE = 0.2
"""Most ripple of the currents by the switching, u_dc T / (8 L), in i_max: beyond it nobody would drive the machine at
this rate. Drives that were sampled with more before had up to ten times i_max."""
_SLOWEST_SWING = 100.0
"""Least planned speed of a free shaft, rpm."""
_HEADROOM = 0.85
"""Share of the DC link's circle that the largest induced voltage takes at the fastest speed of a drive."""


@dataclass(frozen=True)
class Effect:
    """What a real drive does besides."""

    cause: str  # under which a warning or a correction is right, see CAUSES in population.py
    changes: Callable[[Random, Machine, float], Changes] = field(default=lambda *_: {})  # of the simulation's settings
    expected: str = "identified"  # or "warned", or "documented": docs/limits.md says that it leaves no trace
    spoil: Spoil | None = None  # what a mistake of the log makes of the samples
    second: bool = False  # the changes hold for the second of two recordings only


def _heating(rng: Random, machine: Machine, seconds: float) -> Changes:
    """Heat the copper by 2 to 8 % of R and the magnet by 0.5 to 2 % of its flux, with the mean loss."""
    energy = 0.75 * machine.resistance * machine.i_max**2 * seconds
    return {
        "copper_heat_capacity": energy / (rng.uniform(0.02, 0.08) / 0.00393),
        "magnet_heat_capacity": energy / rng.uniform(5.0, 20.0),
    }


def _switching(rng: Random, machine: Machine, _: float) -> Changes:
    """Switch with a hard dead time of 0.5 to 3 % of the period, in half of the drives with capacitances."""
    capacitance = rng.choice([0.0, 2e-9]) * machine.i_max / machine.u_dc / 0.75
    return {"inverter": "switching", "dead_time": rng.uniform(0.5e-6, 3e-6), "output_capacitance": capacitance}


def _one_voltage_high(samples: Samples) -> Samples:
    return replace(samples, u_abc=samples.u_abc * (1.0, 1.03, 1.0))


def cross_talk(samples: Samples) -> Samples:
    """Add 2 % of the current of phase a to b, and of b to c."""
    matrix = np.array([[1.0, 0.0, 0.0], [0.02, 1.0, 0.0], [0.0, 0.02, 1.0]])
    return replace(samples, i_abc=samples.i_abc @ matrix.T)


def _late_from_the_middle(samples: Samples) -> Samples:
    half, u_abc = len(samples) // 2, samples.u_abc.copy()
    u_abc[half:] = samples.u_abc[half - 1 : -1]
    return replace(samples, u_abc=u_abc)


def _mismatch(rng: Random, *_: object) -> Changes:
    """Let sensors differ by up to 1 % without a common error, which leaves no trace; half of the drives have two."""
    gain = rng.uniform(-0.01, 0.01, 3)
    if rng.uniform() < 0.5:
        return {"current_gain": (1 + gain[0], 1 - gain[0], 1.0), "two_current_sensors": True}
    return {"current_gain": tuple(1 + gain - gain.mean())}


EFFECTS = {
    "iron": Effect("iron", lambda r, m, _: {"iron_conductance": r.uniform(0.03, 0.25) * m.i_max / m.u_dc}),
    "hysteresis": Effect("iron", lambda r, m, _: {"iron_hysteresis": r.uniform(2e-3, 1e-2) * m.i_max}),
    "lag": Effect(
        "lag", lambda r, *_: {"flux_lag": r.uniform(0.005, 0.03), "flux_lag_time": 1e-3 * r.choice([0.5, 1.0, 2.0])}
    ),
    "heating": Effect("heat", _heating),
    "warm": Effect(
        "recordings",
        lambda r, *_: {"copper_temperature": r.uniform(30.0, 60.0), "magnet_temperature": r.uniform(22.0, 35.0)},
        second=True,
    ),
    "rotor": Effect("rotor", lambda r, *_: {"eccentricity": (r.uniform(2e-3, 8e-3),)}),
    "phases": Effect(
        "phases", lambda r, *_: {"resistance_factor": tuple(1 + np.array((1, 0, -1)) * r.uniform(0.01, 0.03))}
    ),
    "switching": Effect("inverter", _switching),
    "devices": Effect("inverter", lambda r, *_: {"drop_asymmetry": tuple(r.uniform(-0.1, 0.1, 3))}),
    "ripple": Effect("dc", lambda r, *_: {"u_dc_ripple": r.uniform(0.005, 0.02)}),
    "drift": Effect(
        "dc",
        lambda r, *_: {"u_dc_drift": r.uniform(0.003, 0.01), "u_dc_drift_frequency": r.uniform(0.5, 5.0)},
    ),
    "drift_logged": Effect(
        "dc", lambda r, *_: {"u_dc_drift": r.uniform(3e-3, 1e-2), "log_scalars": ("dc_link_voltage",)}
    ),
    "hexagon": Effect("dc", lambda *_: {"hexagon_limit": True, "voltage_limit": 1.15}, "warned"),
    "filter": Effect("timing", lambda r, *_: {"current_filter": 10 ** r.uniform(3.6, 4.4)}),
    "latency": Effect("timing", lambda r, *_: {"resolver_latency": r.uniform(1e-5, 6e-5)}),
    "delay": Effect("timing", lambda r, *_: {"voltage_delay": float(r.choice([-1.0, 0.5, 1.0]))}),
    "angle": Effect("angle", lambda r, *_: {"resolver_offset": np.deg2rad(r.uniform(-3.0, 3.0))}),
    "gains": Effect("gains", _mismatch),
    "offsets": Effect(
        "offsets", lambda r, m, _: {"current_offset": tuple(r.uniform(-5e-3, 5e-3, 3) * m.i_max)}
    ),
    "resolver": Effect("resolver", lambda r, *_: {"resolver_mechanical_errors": (np.deg2rad(r.uniform(0.1, 0.5)),)}),
    "resolver_electrical": Effect(
        "resolver", lambda r, *_: {"resolver_electrical_errors": tuple(np.deg2rad(r.uniform(0.1, 0.3, 2)))}
    ),
    "voltage_high": Effect("voltage_gains", expected="warned", spoil=_one_voltage_high),
    "cross_talk": Effect("gains", expected="warned", spoil=cross_talk),
    "late": Effect("timing", expected="warned", spoil=_late_from_the_middle),
    "decimated": Effect("decimated", lambda *_: {"log_decimation": 5}, "warned"),
    "nonlinear": Effect(
        "gains", lambda _, m, __: {"current_cubic": 2e-3, "current_dead_band": 1e-3 * m.i_max}, "documented"
    ),
}  # fmt: skip
"""The magnitudes are common ones."""


@dataclass(frozen=True)
class Drive:
    """One drive of the population."""

    seed: int
    number: int
    family: str
    machine: Machine
    settings: tuple[SimulationSettings, ...]  # one for each recording
    seconds: float  # of each recording
    effects: tuple[str, ...] = ()  # keys of EFFECTS
    swing: Swing | None = None  # of a free shaft

    @property
    def i_max(self) -> float:
        """Radius of the trajectory, A."""
        return self.settings[0].i_max or self.machine.i_max

    @property
    def expected(self) -> str:
        """What a fit ought to do: ``identified``, or else see :class:`Effect`."""
        outcomes = {EFFECTS[name].expected for name in self.effects}
        if self.family == "asymmetric" and "angle" in self.effects:
            outcomes.add("documented")
        return next((name for name in ("documented", "warned") if name in outcomes), "identified")

    @property
    def causes(self) -> set[str]:
        """What a warning or a correction may name."""
        shape = self.machine.shape
        more = {"machine"} if isinstance(shape, Measured) and not shape.reciprocal else set()
        more |= {"angle"} if self.family == "asymmetric" else set()
        more |= {"inverter"} if (self.settings[0].inverter_current or 0.0) > _WIDE * self.i_max else set()
        return more | {EFFECTS[name].cause for name in self.effects}

    @property
    def well_posed(self) -> bool:
        """Whether docs/limits.md promises a good map."""
        return self.expected == "identified"

    def labels(self) -> dict[str, Any]:
        """Return what a row of the results says of the drive."""
        shape, first = self.machine.shape, self.settings[0]
        core = shape.origin if isinstance(shape, Measured) else shape
        return {
            "seed": self.seed, "number": self.number, "family": self.family, "effects": list(self.effects),
            "causes": sorted(self.causes), "expected": self.expected, "well_posed": self.well_posed,
            "i_max": self.i_max, "pole_pairs": self.machine.pole_pairs, "u_dc": self.machine.u_dc,
            "speeds": [settings.speeds[0] for settings in self.settings], "seconds": self.seconds,
            "sample_rate": 1 / first.sample_period, "noise": first.current_noise, "inverter": first.inverter,
            "inverter_width": (first.inverter_current or 0.0) / self.machine.i_max,
            "inverter_height": (first.inverter_voltage or 0.0) / self.machine.u_dc,
            "angle_noise": first.resolver_noise, "angle_step": first.resolver_quantization,
            "speed_ripple": first.speed_ripple, "compensated": first.inverter_compensation,
            "excitation": self.i_max / self.machine.i_max, "sharpness": core.sharpness,
            "bridge": list(core.bridge) if core.bridge[0] else None,
            "reciprocal": not isinstance(shape, Measured) or shape.reciprocal,
            "nodes": shape.nodes if isinstance(shape, Measured) else None,
            "orders": [h.order for h in core.harmonics] if isinstance(shape, CoEnergy) else [6],
        }  # fmt: skip

    def resistance(self) -> float:
        """Return the true R at the start plus the slope to which the inverter's curve tends, ohm."""
        settings, machine = self.settings[0], self.machine
        if settings.inverter_compensation:
            return machine.resistance
        drop = phase_drop_of(settings, machine.u_dc, self.i_max)
        i, voltage = drop_curve(drop, self.i_max)
        large = i >= 0.5 * self.i_max  # there a drop is a + r i + c / i
        columns = np.stack([i[large], np.ones(large.sum()), 1 / i[large]], axis=1)
        return machine.resistance + float(np.linalg.lstsq(columns, voltage[large], rcond=None)[0][0])


def drive(seed: int, number: int) -> Drive:
    """Return one random drive, which depends on seed and number alone."""
    rng = np.random.default_rng([seed, number])
    family = FAMILIES[number % len(FAMILIES)]
    shape = random_shape(rng, family)
    i_max = float(np.exp(rng.uniform(np.log(4.0), np.log(1000.0))))
    u_dc = float(rng.choice([24.0, 48.0, 96.0, 325.0] if i_max < 40 else [48.0, 96.0, 400.0, 560.0, 800.0]))
    pole_pairs = int(rng.integers(1, 21)) if rng.random() < 0.3 else int(rng.integers(2, 7))
    period = 1 / float(rng.choice([5e3, 1e4, 2e4], p=(0.15, 0.65, 0.2)))
    top = min(_FASTEST / period * 60 / pole_pairs, 3500.0)
    low = max(_SLOWEST * 60 / pole_pairs, 100.0)
    speed = float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(min(low, 0.9 * top)), np.log(top))))
    speeds = (speed,) if rng.random() < 0.7 else (speed, -speed * rng.uniform(0.4, 1.0))
    seconds = min(float(rng.choice([5.0, 10.0, 20.0], p=(0.25, 0.6, 0.15))), _MOST_SAMPLES * period)
    seconds = max(seconds / len(speeds), _SHORTEST)
    chosen = _effects(rng, len(speeds))
    part = rng.uniform(0.15, 0.8) if "hexagon" not in chosen else 1.25
    least, turn = _least_inductance(shape), 2 * np.pi / 60 * pole_pairs
    slip = 2 * np.pi * 4.0
    most = 8 * _MOST_RIPPLE * least * part * _HEADROOM / np.sqrt(3) / period
    slower = min(1.0, max(most - slip, slip) / (abs(speed) * turn))
    speeds = tuple(slower * each for each in speeds)
    swing = slower * abs(speed) * turn + slip
    flux_unit = part * _HEADROOM * u_dc / np.sqrt(3) / swing
    power = 1.5 * i_max * u_dc / np.sqrt(3)
    drop = min(0.12 * (power / 100.0) ** -0.3 * rng.uniform(0.5, 2.0), 0.15)
    slowest = least * flux_unit / i_max / _FASTEST_FIELD[family == "slotless"]
    resistance = min(drop * u_dc / np.sqrt(3) / i_max, slowest)
    machine = Machine(shape, i_max, flux_unit, resistance, pole_pairs, u_dc)
    common = _ordinary(rng, machine, period)
    settings = [replace(common, speeds=(each,), seed=2 * number + k) for k, each in enumerate(speeds)]
    for name in chosen:
        changes = EFFECTS[name].changes(rng, machine, seconds)
        affected = settings[1:] if EFFECTS[name].second else settings
        settings[-len(affected) :] = [replace(each, **changes) for each in affected]
    return Drive(seed, number, family, machine, tuple(settings), seconds, chosen)


def on_free_shaft(one: Drive) -> Drive:
    """Return the drive without load machine, its swing as planned from rough data; of two recordings, the first.

    A drive for which no swing can be planned is returned with its load machine.
    """
    rng = np.random.default_rng([one.seed, one.number, 1])
    first, machine_map = one.settings[0], one.machine.to_map("")
    bandwidth = float(rng.uniform(100.0, 150.0))
    rough = asdict(RoughMachine.from_map(machine_map, one.i_max)) | {"current_bandwidth": bandwidth}
    fastest = max(abs(first.speeds[0]), _SLOWEST_SWING)
    settings = PlanSettings(**rough, speed_min=1.0, speed_max=fastest, duration=one.seconds)
    torque = largest_torque(build_machine(machine_map, replace(first, i_max=one.i_max)))
    try:
        plan = plan_free_shaft(settings, torque / float(np.exp(rng.uniform(np.log(300.0), np.log(12_000.0)))))
    except ConfigurationError:
        return one
    changes: Changes = {
        "free_shaft": True,
        "inertia": plan.inertia,
        "coulomb_friction": torque * float(rng.uniform(2e-3, 0.03)),
        "viscous_friction": torque * float(rng.uniform(2e-3, 0.03)) / plan.speed_max,
        "cogging_torque": torque * float(rng.choice([0.0, rng.uniform(2e-3, 0.01)])),
        "speed_observer": float(rng.choice([0.0, 60.0, 100.0, 200.0])),
        "speed_ripple": 0.0,
        "current_bandwidth": plan.bandwidth,
        "controller_inductance": float(rng.uniform(0.7, 1.2)),
        "controller_flux": float(rng.uniform(0.85, 1.1)),
    }
    to_rpm = 30 / np.pi
    swing = Swing(plan.speed_max * to_rpm, plan.mean_speed * to_rpm, plan.frequency)
    kept = tuple(name for name in one.effects if not EFFECTS[name].second)
    return replace(one, settings=(replace(first, **changes),), effects=kept, swing=swing)


def _least_inductance(shape: CoEnergy | Measured) -> float:
    """Return the smaller incremental inductance at zero current, per unit."""
    step = np.array([[-0.05, 0.05, 0.0, 0.0], [0.0, 0.0, -0.05, 0.05]])
    psi_d, psi_q = shape.flux(*step)
    return float(min(psi_d[1] - psi_d[0], psi_q[3] - psi_q[2]) / 0.1)


def _effects(rng: Random, recordings: int) -> tuple[str, ...]:
    count = int(np.searchsorted(_SHARES, rng.random(), side="right"))
    names = [name for name in EFFECTS if recordings > 1 or not EFFECTS[name].second]
    chosen = tuple(str(name) for name in rng.choice(names, count, replace=False))
    return tuple(name for name in chosen if name != "delay") if "switching" in chosen else chosen


def _ordinary(rng: Random, machine: Machine, period: float) -> SimulationSettings:
    """Return settings without effects: inverter, noise, ripple of the speed."""
    height = machine.u_dc * float(np.exp(rng.uniform(np.log(3e-3), np.log(2e-2))))
    return SimulationSettings(
        i_max=machine.i_max * (1.0 if rng.random() < 0.9 else float(rng.uniform(0.3, 0.7))),
        sample_period=period,
        inverter=str(rng.choice(["none", "tanh", "dead_time", "two_stage"], p=(0.1, 0.25, 0.35, 0.3))),
        inverter_voltage=height,
        inverter_current=machine.i_max * float(np.exp(rng.uniform(np.log(3e-3), np.log(0.08)))),
        inverter_compensation=bool(rng.random() < 0.1),
        current_noise=float(np.exp(rng.uniform(np.log(2e-4), np.log(3e-3)))),
        resolver_noise=float(rng.choice([0.0, 3e-4], p=(0.7, 0.3))),
        speed_ripple=float(rng.choice([0.0, 0.02], p=(0.7, 0.3))),
        resolver_quantization=float(rng.choice([0.0, 2 * np.pi / 2**14], p=(0.7, 0.3))),
    )


_ARRAYS = ("i_abc", "u_abc", "angle", "speed", "i_dq_reference", "dc_link_voltage")


def recordings(drive: Drive, cache: Path | None = None) -> list[Samples]:
    """Simulate all recordings of a drive, or read them from the cache; single precision either way."""
    return [_recording(drive, k, cache) for k in range(len(drive.settings))]


def _recording(drive: Drive, k: int, cache: Path | None) -> Samples:
    digest = hashlib.sha256(repr(drive).encode()).hexdigest()[:12]  # another generator, another drive
    path = None if cache is None else cache / f"{drive.seed}_{drive.number}_{digest}_{k}.npz"
    if path is None or not path.exists():
        samples = _simulated(drive, k)
        arrays = {name: getattr(samples, name) for name in _ARRAYS if getattr(samples, name) is not None}
        stored = {name: values.astype(np.float32) for name, values in arrays.items()}
        stored |= {"stamp": samples.stamp, "sample_period": np.array(samples.sample_period)}
        if path is not None:
            unfinished = path.with_suffix(f".{os.getpid()}.npz")
            np.savez(unfinished, **stored)
            unfinished.replace(path)
    else:
        try:
            with path.open("rb") as file, np.load(file) as archive:
                stored = dict(archive)
        except (ValueError, zipfile.BadZipFile):
            path.unlink()
            return _recording(drive, k, cache)
    arrays = {name: stored[name].astype(np.float64) for name in _ARRAYS if name in stored}
    return Samples(stamp=stored["stamp"], sample_period=float(stored["sample_period"]), **arrays)


def _simulated(drive: Drive, k: int) -> Samples:
    machine = drive.machine.to_map(f"{drive.family} {drive.number}")
    samples = run_experiment(machine, drive.settings[k], drive.swing or Lissajous(), drive.seconds).samples
    for name in drive.effects:
        spoil = EFFECTS[name].spoil
        samples = spoil(samples) if spoil else samples
    return samples


def true_flux(drive: Drive, i_dq: FloatArray) -> FloatArray:
    """Return the true mean flux linkages (N, 2), Wb, at the machine's currents (N, 2), A."""
    return drive.machine.flux(i_dq)
