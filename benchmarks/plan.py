"""Compare planned experiments with the paper's of equal duration, on simulated drives whose truth is known.

Usage: python benchmarks/plan.py [--machines ipm,spm,pmsyrm,FILE...] [--seeds 3] [--seconds 10] [--noise 0.001]
       [--speed-min 250] [--output FILE]

Each machine is planned for from a linear machine fitted to its map, which is all that the planner gets to know of it.
Both experiments are simulated with rotor harmonics, a dead-time inverter and current noise, and fitted by method
``full``; the root mean square over the seeds counts.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.planning.planner import Plan, PlannedExperiment, plan
from drive_id.core.planning.settings import PlanSettings
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.identify import identify, score
from drive_id.fitting.simulated import load_machine, rough_settings, run_experiment
from drive_id.types import FloatArray, GroundTruth

NAMES = ("psi_d", "psi_q", "R", "inverter")
SIXTH = 0.01
"""Sixth harmonic of machines whose map has none, as a fraction of the flux."""


@dataclass(frozen=True)
class Comparison:
    """Deviations from the truth of one machine, (4,) each as NAMES says, in percent."""

    machine: str
    plan: Plan
    planned: FloatArray
    paper: FloatArray


def errors(machine: str, experiment: PlannedExperiment, noise: float, seed: int) -> FloatArray:
    """Simulate and fit an experiment; return its errors (4,), percent."""
    machine_map = load_machine(machine)
    settings = SimulationSettings(
        current_noise=noise,
        seed=seed,
        speeds=experiment.speeds,
        sixth_harmonic=SIXTH if machine_map.theta is None else 0.0,
    )
    simulation = run_experiment(machine_map, settings, experiment.trajectory, experiment.duration)
    found, truth = identify([simulation.samples], FitSettings(method="full")), simulation.truth
    resistance = abs(found.resistance / truth.resistance - 1)
    return 100 * np.array([*score(found, truth), resistance, curve_error(found, truth)])


def curve_error(found: IdentifiedDrive, truth: GroundTruth) -> float:
    """Return the root mean square error of the inverter's curve over its height."""
    true = np.interp(found.inverter_current, truth.inverter_current, truth.inverter_voltage)
    return float(np.sqrt(np.mean((found.inverter_voltage - true) ** 2)) / np.abs(true).max())


def compare(machine: str, seeds: int, seconds: float, noise: float, slowest: float) -> Comparison:
    """Plan for a machine, and run both experiments."""
    settings = replace(rough_settings(machine), duration=seconds, current_noise=noise, speed_min=slowest)
    found = plan(settings)
    rms = [
        np.sqrt(np.mean([errors(machine, experiment, noise, seed) ** 2 for seed in range(1, seeds + 1)], axis=0))
        for experiment in (found.experiment, found.paper)
    ]
    return Comparison(machine, found, *rms)


def lines(comparison: Comparison) -> Iterator[str]:
    """Lay out a comparison as rows of a Markdown table."""
    experiment, trajectory = comparison.plan.experiment, comparison.plan.experiment.trajectory
    what = f"{trajectory.frequency_d:g} / {trajectory.frequency_q:g} Hz; "
    what += ", ".join(f"{speed:g}" for speed in experiment.speeds) + " rpm"
    name = Path(comparison.machine).stem
    predicted = 100 * comparison.plan.prediction.values()[:4]
    predicted_paper = 100 * comparison.plan.paper_prediction.values()[:4]
    rows = (
        (name, "paper's", comparison.paper),
        ("", "predicted", predicted_paper),
        ("", f"planned: {what}", comparison.planned),
        ("", "predicted", predicted),
    )
    for machine, row, values in rows:
        yield f"| {machine} | {row} | " + " | ".join(f"{value:.3f} %" for value in values) + " |"
    ratio = " | ".join(f"{value:.2f}" for value in comparison.planned / comparison.paper)
    yield f"| | **planned / paper's** | {ratio} |"


def main() -> None:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(description="Compare planned experiments with the paper's.")
    parser.add_argument("--machines", default="ipm,spm,pmsyrm", help="shipped machines and machine files, with commas")
    parser.add_argument("--seeds", type=int, default=3, help="of the noise, from 1 on")
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of each experiment")
    parser.add_argument("--noise", type=float, default=1e-3, help="of the currents, as a fraction of i_max")
    parser.add_argument("--speed-min", type=float, default=PlanSettings.speed_min, help="lowest speed allowed, rpm")
    parser.add_argument("--output", type=Path, help="file for the table (Markdown)")
    options = parser.parse_args()
    console = Console(width=150, highlight=False, markup=False)
    table = [f"| Machine | Experiment | {' | '.join(NAMES)} |", "|---|---|" + "---:|" * len(NAMES)]
    console.print(*table, sep="\n")
    for machine in options.machines.split(","):
        rows = list(lines(compare(machine, options.seeds, options.seconds, options.noise, options.speed_min)))
        console.print(*rows, sep="\n")
        table += rows
    if options.output:
        options.output.write_text("\n".join(table) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
