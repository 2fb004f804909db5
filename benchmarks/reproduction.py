"""The paper's tables and claims, on simulated drives of known truth.

Usage: python benchmarks/reproduction.py [--output FOLDER]

The folder receives the tables as text and as JSON.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from drive_id.bench.drive import Simulation
from drive_id.bench.machine import default_amplitude
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.identify import identify, score
from drive_id.fitting.simulated import run_experiment

MACHINES = ("ipm", "spm", "pmsyrm")
METHODS = {"psm": "PSM identification", "joint": "Joint identification", "full": "Full identification"}
SECONDS = 10.0

SIMULATION = SimulationSettings(inverter="dead_time", current_noise=1e-3)
"""The paper's experiment: 10 s at 10 kHz and 500 rpm, rotor harmonics and an uncompensated inverter."""
IDEAL = SimulationSettings(inverter="none", harmonics=0.0)
"""Nothing but the machine."""
COMPENSATED = replace(IDEAL, inverter="dead_time", inverter_compensation=True)
"""An inverter whose known voltage error the drive adds to its commands."""
_BENCH_SENSORS = {"current_noise": 2e-3, "current_gain": (1.002, 0.998, 1.0), "resolver_noise": 5e-4}
_BENCH_OFFSET = 1e-3


@dataclass(frozen=True)
class Row:
    """Figures of one identification."""

    experiment: str
    machine: str
    method: str
    nrmse_d: float
    nrmse_q: float
    mad_d: float  # A; NaN when the simulation diverged
    mad_q: float
    resistance: float  # ohm
    true_resistance: float
    voltage_error: float  # u_e, or the height of the curve at i_max for ``full``, V


@dataclass(frozen=True, eq=False)
class Reproduction:
    """All that was computed."""

    rows: tuple[Row, ...]
    agreement: Mapping[str, float]
    """Experiment to the largest difference between the maps of psm and joint, as a share of the largest flux."""

    def select(self, experiment: str) -> list[Row]:
        """Return the rows of one experiment."""
        return [row for row in self.rows if row.experiment == experiment]

    def tables(self) -> list[Table]:
        """Lay out the paper's three tables, with the method ``full`` as a third row."""
        return [
            _table("NRMSE of flux maps in simulation", self.select("simulation"), "psi", "NRMSE", _nrmse),
            _table("Mean error of simulated currents (MAD), simulation", self.select("simulation"), "i", "error", _mad),
            _table("Mean error of simulated currents (MAD), emulated bench", self.select("bench"), "i", "error", _mad),
        ]

    def claims(self) -> list[str]:
        """Say what came of the two further claims of the paper's Results."""
        sentences = []
        for experiment, name in (("ideal", "Without an inverter"), ("compensated", "With a compensated inverter")):
            rows = self.select(experiment)
            _, joint, full = rows
            nrmse = ", ".join(f"{row.method} {' / '.join(_nrmse(row))}" for row in rows)
            resistances = ", ".join(f"{row.method} {row.resistance * 1e3:.4f}" for row in rows)
            sentences.append(
                f"{name} (machine {joint.machine}, no harmonics): u_e = {joint.voltage_error:+.4f} V by joint, "
                f"{full.voltage_error:+.4f} V by full; the maps of psm and joint differ by at most "
                f"{100 * self.agreement[experiment]:.4f} % of the largest flux; NRMSE {nrmse}; R {resistances}, true "
                f"{joint.true_resistance * 1e3:.4f} mΩ."
            )
        return sentences

    def tree(self) -> dict[str, Any]:
        """Return everything as plain values; what diverged is null."""
        rows = [asdict(row) for row in self.rows]
        for row in rows:
            row |= {name: None for name in ("mad_d", "mad_q") if not np.isfinite(row[name])}
        return {"rows": rows, "agreement": dict(self.agreement), "claims": self.claims()}


def reproduce(machines: Sequence[str] = MACHINES, seconds: float = SECONDS) -> Reproduction:
    """Run the paper's experiments.

    Parameters
    ----------
    machines : sequence of str
        Shipped machines; the first one also serves the claims.
    seconds : float
        Duration of each experiment, s; the paper's is 10 s.
    """
    first = machines[0]
    experiments = [
        *(("simulation", name, SIMULATION) for name in machines),
        *(("bench", name, _bench(name)) for name in machines),
        ("ideal", first, IDEAL),
        ("compensated", first, COMPENSATED),
    ]
    rows: list[Row] = []
    agreement: dict[str, float] = {}
    for experiment, name, settings in experiments:
        simulation = run_experiment(machine_map(name), settings, seconds=seconds)
        fits = {method: identify([simulation.samples], FitSettings(method=method)) for method in METHODS}
        rows += [_row(experiment, name, identification, simulation) for identification in fits.values()]
        agreement.setdefault(experiment, _difference(fits["psm"], fits["joint"]))
    return Reproduction(tuple(rows), agreement)


def write_reproduction(output: Path, results: Reproduction) -> None:
    """Write the tables to a folder, as text and JSON."""
    output.mkdir(parents=True, exist_ok=True)
    with (output / "tables.txt").open("w", encoding="utf-8") as text:
        show(results, Console(file=text, width=100))
    tree = json.dumps(results.tree(), indent=1, allow_nan=False) + "\n"
    (output / "reproduction.json").write_text(tree, encoding="utf-8")


def show(results: Reproduction, console: Console) -> None:
    """Print tables and claims."""
    for table in results.tables():
        console.print(table)
    for sentence in results.claims():
        console.print(sentence, highlight=False)


def _bench(name: str) -> SimulationSettings:
    """Stand in for the paper's test bench: device drops, sensor faults, converter steps, another seed."""
    i_max = default_amplitude(machine_map(name))
    return SimulationSettings(
        inverter="two_stage",
        seed=1,
        current_quantization=2 * i_max / 4096,
        current_offset=(_BENCH_OFFSET * i_max, -_BENCH_OFFSET * i_max, 0.0),
        speed_ripple=1e-3,
        **_BENCH_SENSORS,  # type: ignore[arg-type]  # floats and a tuple by name
    )


def _row(experiment: str, machine: str, identification: IdentifiedDrive, simulation: Simulation) -> Row:
    report = identification.report
    nrmse_d, nrmse_q = score(identification, simulation.truth)
    return Row(
        experiment, machine, identification.method, nrmse_d, nrmse_q, report.mad_d, report.mad_q,
        identification.resistance, simulation.truth.resistance, identification.voltage_error,
    )  # fmt: skip


def _difference(first: IdentifiedDrive, second: IdentifiedDrive) -> float:
    inside = first.flux_map.inside
    one = np.stack([first.flux_map.psi_d[inside], first.flux_map.psi_q[inside]])
    other = np.stack([second.flux_map.psi_d[inside], second.flux_map.psi_q[inside]])
    return float(np.abs(one - other).max() / np.abs(other).max())


def _nrmse(row: Row) -> tuple[str, str]:
    return f"{100 * row.nrmse_d:.3f} %", f"{100 * row.nrmse_q:.3f} %"


def _mad(row: Row) -> tuple[str, str]:
    mad_d, mad_q = (f"{value:.3g} A" if np.isfinite(value) else "diverged" for value in (row.mad_d, row.mad_q))
    return mad_d, mad_q


def _table(title: str, rows: Sequence[Row], symbol: str, measure: str, show: Callable[[Row], tuple[str, str]]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("Machine")
    table.add_column("Approach")
    for component in "dq":
        table.add_column(f"{symbol}_{component} {measure}", justify="right")
    for row in rows:
        table.add_row(row.machine, METHODS[row.method], *show(row), end_section=row.method == "full")
    return table


def main() -> None:
    """Run the experiments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, help="folder for the tables, as text and as JSON")
    output = parser.parse_args().output
    results = reproduce()
    show(results, Console())
    if output is not None:
        write_reproduction(output, results)


if __name__ == "__main__":
    main()
