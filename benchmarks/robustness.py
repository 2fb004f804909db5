"""Errors of method ``full`` on drives with real effects, and its reports.

Usage: python benchmarks/robustness.py [--only EFFECT,...] [--machines ipm,spm,pmsyrm]
           [--output docs/engineering/robustness.md]

All effects on the ipm, at one speed and at two, some of them on the other machines. The figures are the same on any
computer.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from judging import against, normalized_curve
from population_drives import cross_talk
from reporting import printed

from drive_id.bench.drive import Simulation
from drive_id.bench.machine import default_amplitude
from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.identify import gather
from drive_id.core.validation.metrics import true_flux
from drive_id.errors import DriveIdError
from drive_id.fitting.simulated import load_machine, run_experiment
from drive_id.types import MachineMap, Samples

SECONDS = 10.0
NOISE = 1e-3
ONE, TWO = (500.0,), (500.0, -900.0)
GOOD = SimulationSettings(current_noise=NOISE)
WRONG_FLUX, WRONG_RESISTANCE, BEYOND = 3e-3, 1e-2, 3.0
"""Errors of the flux, and of R with its distance in standard errors, that need a warning."""
_SENSORS = ("resolver_offset", "current_offset")
_SHORT = 90
_SATURATED = 0.9
"""Share of samples below the inscribed circle of the hexagon."""

Changes = dict[str, Any]
Spoil = Callable[[Samples, MachineMap], Samples]


@dataclass(frozen=True)
class Effect:
    """One effect: its settings for a machine, those of a second recording, and a mistake of the log."""

    title: str
    settings: Callable[[MachineMap], Changes] = field(default=lambda _: {})
    """Returns the changed settings for a machine."""
    second: Changes | None = None  # further settings of a second recording, at the last of the speeds
    spoil: Spoil | None = None  # what a mistake makes of the samples
    short: bool = False  # also tried on the machines other than the first
    hexagon: bool = False  # the DC link is so low that commands reach its hexagon


def of(**changes: Any) -> Callable[[MachineMap], Changes]:
    """Return settings that are the same for all machines."""
    return lambda _: changes


def admittance(machine: MachineMap) -> float:
    """Return i_max / u_dc, S."""
    return default_amplitude(machine) / machine.u_dc


def heating(machine: MachineMap) -> Changes:
    """Heat the copper by 5 % of R and the magnet by 2 % of its flux within the recording, with the mean loss."""
    energy = 0.75 * machine.resistance * default_amplitude(machine) ** 2 * SECONDS
    return {"copper_heat_capacity": energy / (0.05 / 0.00393), "magnet_heat_capacity": energy / 20.0}


def as_duty_cycles(samples: Samples, machine: MachineMap) -> Samples:
    """Log duty cycles in place of volts."""
    return replace(samples, u_abc=samples.u_abc / machine.u_dc)


def sagging(samples: Samples, _: MachineMap) -> Samples:
    """Log the voltages as if the DC link did not fall by 2 % under the largest power.

    By a resistance: it falls by s in proportion to its current, which is the power over 1 - s.
    """
    power = np.sum(samples.u_abc * samples.i_abc, axis=1)
    left = 0.5 + np.sqrt(0.25 - 0.02 * power / np.abs(power).max())  # s (1 - s) is proportional to the power
    return replace(samples, u_abc=samples.u_abc / left[:, None])


def by_own_clock(samples: Samples, _: MachineMap) -> Samples:
    """Log the currents by a clock that is 20 ppm fast, right in the middle."""
    t = (samples.stamp - samples.stamp[0]) * 1e-9
    read = t - 2e-5 * (t - t.mean())
    return replace(samples, i_abc=np.stack([np.interp(read, t, phase) for phase in samples.i_abc.T], axis=1))


def turned_late(signal: str) -> Spoil:
    """Return a log of a signal in d and q that was turned to phases by an angle one sample late."""
    name = {"currents": "i_abc", "voltages": "u_abc"}[signal]

    def spoil(samples: Samples, _: MachineMap) -> Samples:
        turn = np.exp(-1j * samples.sample_period * samples.speed)
        turned: Changes = {name: frames.phases(frames.space_vector(getattr(samples, name)) * turn)}
        return replace(samples, **turned, turned=frozenset({signal}))

    return spoil


def switching(dead_time: float, capacitance: float = 0.0) -> Callable[[MachineMap], Changes]:
    """Return the settings of an inverter whose legs switch; 2 nF belong to 300 A and 400 V."""

    def settings(machine: MachineMap) -> Changes:
        scale = admittance(machine) / 0.75
        return {"inverter": "switching", "dead_time": dead_time, "output_capacitance": capacitance * scale}

    return settings


EFFECTS = {
    "none": Effect("nothing added", short=True),
    "iron": Effect("iron loss, G = 0.27 i_max/u_dc", lambda m: {"iron_conductance": 0.27 * admittance(m)}, short=True),
    "iron_small": Effect("iron loss, a quarter of it", lambda m: {"iron_conductance": 0.07 * admittance(m)}),
    "hysteresis": Effect("hysteresis, 1 % of i_max", lambda m: {"iron_hysteresis": 0.01 * default_amplitude(m)}),
    "filter": Effect("current filter 5 kHz", of(current_filter=5000.0), short=True),
    "latency": Effect("angle 30 µs late", of(resolver_latency=3e-5), short=True),
    "warm": Effect(
        "second recording warm: R +10 %, magnet −1 %",
        second={"copper_temperature": 45.4, "magnet_temperature": 30.0},
        short=True,
    ),
    "heating": Effect("R +5 %, magnet −2 % within the recording", heating),
    "eccentric": Effect(
        "resolver error 0.5° el., once per turn", of(resolver_mechanical_errors=(np.deg2rad(0.5),)), short=True
    ),
    "resolver": Effect(
        "resolver error 0.3°, electrical orders 1 and 2", of(resolver_electrical_errors=(np.deg2rad(0.3),) * 2)
    ),
    "lag": Effect("flux lag 3 %, 1 ms", of(flux_lag=0.03), short=True),
    "short_dead_time": Effect("switching, 1 µs dead time, 2 nF", switching(1e-6, 2e-9)),
    "dead_time": Effect("switching, 4 µs dead time, no capacitance", switching(4e-6), short=True),
    "two_stage": Effect("two-stage inverter curve", of(inverter="two_stage")),
    "devices": Effect("drop of phases asymmetric by 10, −10, 5 %", of(drop_asymmetry=(0.1, -0.1, 0.05))),
    "hexagon": Effect(
        "hexagon limit, log unlimited",
        lambda m: {"hexagon_limit": True, "voltage_limit": 1.15, "inverter_voltage": 0.01 * m.u_dc},
        hexagon=True,
    ),
    "ripple": Effect("u_dc ripple 2 %, 300 Hz, not logged", of(u_dc_ripple=0.02)),
    "drift": Effect("u_dc ±0.5 % at 2.3 Hz, not logged", of(u_dc_drift=0.005, u_dc_drift_frequency=2.3)),
    "sag": Effect("u_dc falls by 2 % under the largest power, not logged", spoil=sagging, short=True),
    "drift_logged": Effect(
        "u_dc ±0.5 % at 2.3 Hz, DC-link voltage logged",
        of(u_dc_drift=0.005, u_dc_drift_frequency=2.3, log_scalars=("dc_link_voltage",)),
    ),
    "phases": Effect("phase resistances +2, 0, −2 %", of(resistance_factor=(1.02, 1.0, 0.98))),
    "two_sensors": Effect(
        "two current sensors, one reads 1 % too much",
        of(two_current_sensors=True, current_gain=(1.005, 0.995, 1.0)),
        short=True,
    ),
    "cross_talk": Effect(
        "cross-talk between current sensors, 2 %", spoil=lambda samples, _: cross_talk(samples), short=True
    ),
    "rotor": Effect("flux modulated by 0.5 % once per turn", of(eccentricity=(0.005,))),
    "sensors": Effect(
        "current sensors: cubic gain 0.2 %, skew 2 µs, dead band 0.1 %",
        lambda m: {
            "current_cubic": 0.002,
            "current_skew": (0.0, 1e-6, 2e-6),
            "current_dead_band": 1e-3 * default_amplitude(m),
        },
    ),
    "log": Effect(
        "log with zero sequence, angle of 12 bits, stamps ±20 µs",
        of(log_zero_sequence=True, resolver_quantization=2 * np.pi / 4096, stamp_jitter=2e-5),
    ),
    "clock": Effect("currents logged by a clock that is 20 ppm fast", spoil=by_own_clock, short=True),
    "current_frame": Effect("currents in d and q turned by an angle one sample late", spoil=turned_late("currents")),
    "voltage_frame": Effect("voltages in d and q turned by an angle one sample late", spoil=turned_late("voltages")),
    "decimated": Effect("log decimated to 2 kHz", of(log_decimation=5)),
    "decimated_more": Effect("log decimated to 1 kHz", of(log_decimation=10)),
    "duty": Effect("duty cycles taken for volts", spoil=as_duty_cycles, short=True),
}
"""All but the last few are effects of the drive; the magnitudes are common ones."""


def simulated(effect: Effect, name: str, speeds: tuple[float, ...]) -> list[Simulation]:
    """Run the experiments of one row, 10 s in all."""
    machine = load_machine(name)
    settings = replace(GOOD, speeds=speeds, **effect.settings(machine))
    if effect.hexagon:
        machine = load_machine(name, u_dc=_scarce(machine, speeds))
    if effect.second is None:
        simulations = [run_experiment(machine, settings, seconds=SECONDS)]
    else:
        warm = replace(settings, speeds=speeds[-1:], seed=1, **effect.second)
        simulations = [
            run_experiment(machine, each, seconds=SECONDS / 2) for each in (replace(settings, speeds=speeds[:1]), warm)
        ]
    if effect.spoil is not None:
        simulations = [replace(each, samples=effect.spoil(each.samples, machine)) for each in simulations]
    return simulations


def _scarce(machine: MachineMap, speeds: tuple[float, ...]) -> float:
    """Return the DC-link voltage at which a tenth of the commands exceed the hexagon's inscribed circle, V."""
    samples = run_experiment(machine, replace(GOOD, speeds=speeds), seconds=SECONDS / 4).samples
    return float(np.sqrt(3) * np.quantile(np.abs(frames.space_vector(samples.u_abc)), _SATURATED))


def cells(effect: Effect, name: str, speeds: tuple[float, ...]) -> list[str]:
    """Simulate and fit; return the cells of a row."""
    simulations = simulated(effect, name, speeds)
    recordings = [simulation.samples for simulation in simulations]
    try:
        settings = FitSettings(pole_pairs=simulations[0].truth.pole_pairs)
        found = conclude(gather(recordings, settings), recordings)
    except DriveIdError as error:
        return ["–", "–", "–", f"refused: {_shortened(str(error))}"]
    truth = simulations[0].truth
    start = float(truth.details.get("resistance_start", truth.resistance))
    resistance = start + normalized_curve(truth, found.inverter_current)[0]
    errors = against(found, partial(true_flux, truth), truth.i_max, resistance)
    flux = errors.psi_d, errors.psi_q
    told = ", ".join(_found(found)) or "–"
    warnings = [_shortened(warning) for warning in found.report.warnings]
    if warnings:
        more = f" (+{len(warnings) - 1})" if len(warnings) > 1 else ""
        told = f"{told}; warns: {warnings[0]}{more}"
    wrong = max(flux) > WRONG_FLUX
    wrong |= abs(errors.resistance) > WRONG_RESISTANCE and abs(errors.resistance_z) > BEYOND
    if wrong and not warnings:
        told = f"{told}; **no warning**"
    return [
        " / ".join(f"{100 * value:.3f}" if value < 0.1 else f"{100 * value:.0f}" for value in flux),
        f"{100 * errors.resistance:+.1f} ({errors.resistance_z:+.1f})".replace("-", "−"),
        f"{100 * errors.band:.0f} %",
        told,
    ]


def _found(found: IdentifiedDrive) -> Iterator[str]:
    """Yield the effects that were corrected, with their values."""
    for entry in found.calibrations:
        if entry.applied and not entry.name.startswith(_SENSORS):
            unit = "" if entry.unit == "1" else f" {entry.unit}"
            doubt = " (open)" if entry.doubtful else ""
            yield f"{entry.name} {entry.value:.3g}{unit}{doubt}".replace("-", "−")


def _shortened(sentence: str) -> str:
    """Return the beginning of a sentence, up to a whole word."""
    text = re.sub(r"\s+", " ", sentence.replace("|", "/")).strip()
    return text if len(text) <= _SHORT else f"{text[:_SHORT].rsplit(' ', 1)[0]} …"


LEGEND = """\
## Columns and conditions

Written by `python benchmarks/robustness.py --output docs/engineering/robustness.md`: 10 s at 10 kHz, 0.1 %
current noise, an inverter with dead time, the default trajectory and the default settings.

| column | meaning |
|---|---|
| ψ_d / ψ_q | NRMSE over the map points with data within the disc, against the map at the start of the first \
recording and, with iron loss, over the machine's current (without the iron's) |
| R | error and, in brackets, in stated standard errors |
| band | share of map points whose nominal 95 % interval contains the truth |
| report | effects identified and corrected, with values, (open) if another would explain nearly as much; then the \
first warning, shortened (+ further ones) |
| **No warning** | a result without a warning whose error exceeds 0.3 % of the flux, or 1 % of R and 3 σ |
"""


def page(names: list[str], machines: list[str]) -> Iterator[str]:
    """Yield the lines of the page."""
    yield from (
        "# Robustness",
        "",
        "Method `full` on simulated drives with one effect of real drives each; the columns are explained",
        "[below the tables](#columns-and-conditions).",
        "",
    )
    for number, name in enumerate(machines):
        for speeds in (ONE, TWO):
            at = " and ".join(f"{speed:+g}" for speed in speeds).replace("-", "−")
            yield from (f"## {name}, {at} rpm", "", "| effect | ψ_d / ψ_q, % | R, % (z) | band | report |")
            yield "|---|---:|---:|---:|---|"
            for effect in names:
                if number == 0 or EFFECTS[effect].short:
                    yield f"| {EFFECTS[effect].title} | {' | '.join(cells(EFFECTS[effect], name, speeds))} |"
            yield ""
    yield from LEGEND.splitlines()


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description="Fit drives with the effects of real ones and compare with the truth.")
    parser.add_argument("--only", default="", help="names of effects, with commas")
    parser.add_argument(
        "--machines", default="ipm,spm,pmsyrm", help="names, with commas; the first one gets all effects"
    )
    parser.add_argument("--output", type=Path, help="page to write (Markdown)")
    options = parser.parse_args()
    start, names = time.monotonic(), options.only.split(",") if options.only else list(EFFECTS)
    text = printed(page(names, options.machines.split(",")))
    print(f"Total: {time.monotonic() - start:.0f} s")
    if options.output:
        options.output.write_text(text.rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
