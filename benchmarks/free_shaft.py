"""Accuracy of maps and mechanics from simulated free shafts, without a load machine; the truth is known.

The drive is rougher than that of the other pages: 1 % Coulomb and 1 % viscous friction, a current controller that
assumes 0.7 times the inductances and 0.9 times the magnet flux, a speed from a tracking observer of 100 Hz, a feedback
of the mean speed that acts each 10 ms, 20 ms late, 0.1 % of noise, and a drop of 2 % of the DC link.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as drive-id sets it: before numpy is loaded

import numpy as np
from judging import BAND, against
from reporting import write_between

import drive_id
from drive_id.bench.drive import Simulation, build_machine
from drive_id.bench.effects import DEFAULT_ACCELERATION, largest_torque
from drive_id.bench.settings import SimulationSettings
from drive_id.bench.swing import Swing, simulate_swing
from drive_id.errors import DriveIdError
from drive_id.fitting.simulated import load_machine
from drive_id.types import FloatArray

FAULTS = {
    "resolver_offset": math.radians(1.0),
    "voltage_delay": 1.0,
    "current_gain": (1.01, 0.99, 1.0),
    "current_offset": (1.0, -0.5, -0.5),
}


@dataclass(frozen=True)
class Case:
    """One free shaft."""

    name: str
    machine: str
    heavier: float = 1.0  # inertia relative to that which the largest torque accelerates by 4000 rad/s^2
    swing: Mapping[str, float] = field(default_factory=dict)  # settings of :class:`~drive_id.bench.swing.Swing`
    drive: Mapping[str, Any] = field(default_factory=dict)  # settings of the drive
    seconds: float = 20.0


LOCKED = {"ipm": 0.3, "spm": 1.1, "pmsyrm": 2.0}  # rad, electrical
FLYWHEEL = {"speed_max": 600.0, "mean_speed": 300.0}
CREEPING = {"frequency": 60.0, "mean_speed": 60.0}
CASES = (
    *(
        Case(f"{machine}, {heavier:g} times the inertia", machine, heavier, FLYWHEEL if heavier == 10 else {})
        for machine in ("ipm", "spm", "pmsyrm")
        for heavier in (0.3, 1.0, 10.0)
    ),
    Case("ipm at 20 Hz", "ipm", swing={"frequency": 20.0}),
    Case("pmsyrm at 20 Hz, creeping at 60 rpm", "pmsyrm", swing={"frequency": 20.0, "mean_speed": 60.0}),
    *(Case(f"{name} at 60 Hz, creeping at 60 rpm", name, swing=CREEPING) for name in ("ipm", "spm", "pmsyrm")),
    Case("ipm with iron loss, 20 Hz", "ipm", swing={"frequency": 20.0}, drive={"iron_conductance": 0.02}),
    Case("ipm with faulty sensors", "ipm", drive=FAULTS),
    Case("ipm with 5 % friction and cogging", "ipm", drive={"coulomb_friction": 6.4, "cogging_torque": 2.0}),
    Case("ipm at 60 Hz, not creeping", "ipm", swing={"frequency": 60.0}),
)


def recorded(case: Case, seed: int) -> Simulation:
    """Simulate a case."""
    machine = load_machine(case.machine)
    settings: dict[str, Any] = {
        "free_shaft": True, "inverter": "tanh", "inverter_voltage": 0.02 * machine.u_dc, "current_noise": 1e-3,
        "current_bandwidth": 120.0, "controller_inductance": 0.7, "controller_flux": 0.9, "speed_observer": 100.0,
        "seed": seed,
    }  # fmt: skip
    settings |= case.drive
    plain = SimulationSettings(**settings)
    inertia = case.heavier * largest_torque(build_machine(machine, plain)) / DEFAULT_ACCELERATION
    drive = replace(plain, inertia=inertia)
    return simulate_swing(machine, drive, Swing(**case.swing), case.seconds)


def measured(case: Case, seed: int) -> dict[str, Any]:
    """Simulate and fit a case, and compare it with the truth."""
    simulation = recorded(case, seed)
    angle, period = np.unwrap(simulation.angle_true), simulation.samples.sample_period
    pole_pairs = simulation.machine.pole_pairs
    step = max(1, round(1e-3 / period))
    speed = (angle[step:] - angle[:-step]) / (step * period) / pole_pairs * 30 / np.pi
    row: dict[str, Any] = {"name": case.name, "slowest": speed.min(), "fastest": speed.max()}
    start = time.monotonic()
    try:
        found = drive_id.fit(simulation.samples, settings=drive_id.FitSettings(pole_pairs=pole_pairs))
    except DriveIdError as refusal:
        return {**row, "refused": str(refusal)}
    machine = simulation.machine
    errors = against(found, lambda i_dq: machine.mean_flux(*i_dq.T), machine.i_max, machine.resistance)
    row |= {
        "psi_d": 100 * errors.psi_d, "psi_q": 100 * errors.psi_q, "R": 100 * errors.resistance,
        "R_z": errors.resistance_z, "band": 100 * errors.band, "warnings": found.warnings,
        "seconds": time.monotonic() - start,
    }  # fmt: skip
    mechanics, inertia = found.mechanics, float(simulation.truth.details["inertia"])
    if mechanics is not None:
        wrong = mechanics.inertia - inertia
        row |= {"J": 100 * wrong / inertia, "J_z": wrong / mechanics.sigma_inertia}
        for name in ("viscous_friction", "coulomb_friction"):
            own, true_value = name.replace("coulomb_", ""), float(simulation.truth.details[name])
            value, sigma = getattr(mechanics, own), getattr(mechanics, f"sigma_{own}")
            if value is not None:
                row |= {name: 100 * (value / true_value - 1), f"{name}_z": (value - true_value) / sigma}
        cogging = float(simulation.truth.details.get("cogging_torque", 0.0))
        for found_one in mechanics.cogging:
            row |= {"cogging": found_one.amplitude, "cogging_z": (found_one.amplitude - cogging) / found_one.sigma}
    return row


def locked(name: str, position: float, seed: int) -> str:
    """Return a row of the table of locked rotors: errors of the flux minus that at zero current, there and mean."""
    machine = load_machine(name)
    settings = SimulationSettings(
        inverter="tanh", inverter_voltage=0.02 * machine.u_dc, current_noise=1e-3, seed=seed, speeds=(0.0,),
        start_angle=position,
    )  # fmt: skip
    samples = drive_id.simulate(machine, 20.0, settings=settings)
    found = drive_id.fit(samples, settings=drive_id.FitSettings(method="locked"))
    true = build_machine(machine, settings)
    exact, mean = (
        against(found, partial(_above, flux), machine.i_max, machine.resistance)
        for flux in (partial(true.flux, theta=position), true.mean_flux)
    )
    return (
        f"| {name} at {math.degrees(position):.0f}° | {100 * exact.psi_d:.3f} / {100 * exact.psi_q:.3f} % | "
        f"{100 * exact.resistance:+.2f} % ({exact.resistance_z:+.1f}) | {100 * exact.band:.0f} % | "
        f"{100 * mean.psi_d:.2f} / {100 * mean.psi_q:.2f} % |"
    )


def _above(flux: Callable[..., FloatArray], i_dq: FloatArray) -> FloatArray:
    """Return the flux (N, 2), Wb, above that at zero current, which nothing tells at standstill."""
    return np.asarray(flux(*i_dq.T) - flux(0.0, 0.0))


def coverage(case: Case, seeds: int) -> list[str]:
    """Return rows of a table over seeds: rms error, rms of the error in standard errors, and share within 1.96."""
    rows = [measured(case, seed) for seed in range(1, seeds + 1)]
    out = []
    for name, unit in (("R", "%"), ("J", "%"), ("viscous_friction", "%"), ("coulomb_friction", "%"), ("cogging", "Nm")):
        told = [row for row in rows if row.get(name) is not None]
        z = np.array([row[f"{name}_z"] for row in told])
        if len(z):
            rms = math.sqrt(np.mean(z**2))
            size = f"{np.mean([row[name] for row in told]):+.3g} ± {np.std([row[name] for row in told]):.2g} {unit}"
            share = f"{100 * np.mean(np.abs(z) < BAND):.0f} % of {len(z)}"
            out.append(f"| {case.name} | {name.replace('_', ' ')} | {size} | {rms:.2f} | {share} |")
    bands = [row["band"] for row in rows if "band" in row]
    out.append(f"| {case.name} | flux, all points | | | {np.mean(bands):.0f} % |")
    return out


def line(row: Mapping[str, Any]) -> str:
    """Return a row of the table."""
    speeds = f"{row['slowest']:.0f} to {row['fastest']:.0f}".replace("-", "\N{MINUS SIGN}")
    if "refused" in row:
        return f"| {row['name']} | {speeds} | refused | | | | | |"
    shaft = "not told" if "J" not in row else f"{row['J']:+.3f} % ({row['J_z']:+.1f})"
    frictions = (row.get(name) for name in ("viscous_friction", "coulomb_friction"))
    friction = " / ".join("–" if value is None else f"{value:+.1f} %" for value in frictions)
    return (
        f"| {row['name']} | {speeds} | {row['psi_d']:.3f} / {row['psi_q']:.3f} % | {row['R']:+.2f} % "
        f"({row['R_z']:+.1f}) | {row['band']:.0f} % | {shaft} | {friction} | {len(row['warnings'])} |"
    )


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--only", nargs="*", default=[], help="parts of the names of cases")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--seeds", type=int, default=0, help="instead, how often standard errors of that many seeds hold"
    )
    parser.add_argument("--machine", action="append", default=[], help="further machine file, at 5, 20 and 60 Hz")
    parser.add_argument("--page", type=Path, help="page whose figures to replace (Markdown)")
    options = parser.parse_args()
    further = [
        Case(f"{Path(file).stem} at {swing['frequency']:g} Hz", file, swing=swing)
        for file in options.machine
        for swing in ({"frequency": 5.0}, {"frequency": 20.0}, CREEPING)
    ]
    lines = [
        "| free shaft | speed, rpm | error of ψ_d / ψ_q | R (z) | bands | J (z) | B / T_c | warnings |",
        "|---|---|---|---|---|---|---|---|",
    ]
    said = []
    for case in (*CASES, *further):
        if options.only and not any(part in case.name for part in options.only):
            continue
        if options.seeds:
            print(*coverage(case, options.seeds), sep="\n", flush=True)
            continue
        row = measured(case, options.seed)
        lines.append(line(row))
        print(lines[-1], flush=True)
        sentences = [row["refused"]] if "refused" in row else row["warnings"]
        said += [f"- {case.name}: {sentence}" for sentence in sentences]
        for sentence in sentences:
            print(f"    {sentence}", flush=True)
    held = ["| locked rotor | error of ψ_d / ψ_q | R (z) | bands | from the mean map |", "|---|---|---|---|---|"]
    for name, position in LOCKED.items():
        if not options.seeds and (not options.only or any(part in f"locked {name}" for part in options.only)):
            held.append(locked(name, position, options.seed))
            print(held[-1], flush=True)
    if options.page:
        write_between(options.page, "benchmarks/free_shaft.py, locked", "\n".join(held))
        text = "\n".join([*lines, "", "What was said:", "", *said])
        write_between(options.page, "benchmarks/free_shaft.py", text)


if __name__ == "__main__":
    main()
