"""Fit a population of random drives by several methods, and say which results are wrong, silent or blamed on others.

Usage: python benchmarks/population.py [--count 300] [--seed 1] [--only NUMBER ...] [--methods full,joint] [--jobs 1]
           [--samples-cache FOLDER] [--output out/population.json]
           [--page docs/engineering/population.md] [--fresh OTHER.json] [--against OLD.json]

A drive depends on its seed and number alone. The output holds one line per drive and is continued when it exists.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from multiprocessing import connection
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as drive-id sets it: before numpy is loaded

import numpy as np
import population_report
from judging import BAND, against
from population_drives import Drive, drive, on_free_shaft, recordings, true_flux

import drive_id
from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.result.identification import Mechanics
from drive_id.errors import DriveIdError
from drive_id.types import Samples

Row = dict[str, Any]

TIMEOUT = 300.0
"""Seconds that the simulation and all fits of one drive may take."""
MOST_REACH, _USUAL = 1.2, 0.999
"""Largest usual current, in i_max, beyond which the controller has lost the trajectory, so that the drive is not well
posed, and the quantile that stands for it."""
CAUSES = {
    "iron": ("iron_loss*", "coercivity", "hysteresis"),
    "lag": ("flux_lag*",),
    "heat": (
        "copper_heating", "magnet_heating", "late_magnet_heating", "resistance_rise", "magnet_flux_change",
        "magnet_flux_change_late",
    ),
    "recordings": (
        "copper_recordings", "magnet_recordings", "resistance_change*", "magnet_flux_change_[2-8]", "*_of_parts",
        "unlike_parts", "many_parts", "angle_offset_change*", "inverter_drop_change*",
    ),
    "skin": ("skin_effect", "resistance_by_speed"),
    "rotor": ("eccentric_rotor", "rotor_ecc*"),
    "phases": (
        "phase_resistance", "resistance_[abc]", "resistance_of_phase", "phase_inductance", "inductance_[abc]",
        "inductance_of_phase", "phase_drop", "inverter_drop_[abc]", "drop_of_phase",
    ),
    "inverter": (
        "devices", "drop_asymmetry*", "wide_curve", "drop_negative", "voltage_error_negative", "misfit.small_currents",
        "late_compensation", "late_shape", "reference_compensation", "phase_drop", "inverter_drop_[abc]",
        "drop_of_phase",
    ),
    "dc": (
        "dc_link*", "link_*", "device_sag", "drop_by_link", "drop_by_sag", "inverter_drop_by_link", "inverter_drop_sag",
        "voltage_clipped", "misfit", "misfit.small_currents",
    ),
    "timing": (
        "angle_latency", "angle_tracking", "current_latency", "sampling_instant", "voltage_delay*", "time_shift",
        "voltage_frame", "current_frame", "log_frame", "fast_clock*", "*_clock",
        "decimated", "outlier", "single_sample", "no_checksums", "misfit.time",
    ),
    "angle": ("angle_offset", "resolver_offset", "mirror_asymmetry", "magnet_negative"),
    "gains": (
        "current_gain*", "current_rotation", "current_offset", "zero_sequence", "voltage_offset",
    ),
    "filters": ("current_filters", "current_filter_[abc]"),
    "offsets": ("current_offset*", "voltage_offset*"),
    "resolver": ("eccentricity", "second_mechanical", "resolver_[efs]*"),
    "voltage_gains": ("voltage_gain*",),
    "decimated": ("decimated",),
    "machine": ("not_reciprocal",),
    "harmonics": ("harmonic",),
}  # fmt: skip
"""By cause: codes of warnings, effects that they name, and names of corrections."""
MECHANICS = {"J": "inertia", "B": "viscous_friction", "T_c": "friction"}
"""Mechanics of a free shaft: their symbols and names."""
_WEAK = {"resistance_vague", "sigma_large", "too_short", "wide_curve", "little_coverage", "fast_rotation"}
"""Warnings that say what the data leave open, true of any drive."""


def named(*names: str) -> set[str]:
    """Return the causes of warnings, effects or corrections of these names."""
    return {cause for cause, own in CAUSES.items() if any(fnmatchcase(name, one) for name in names for one in own)}


def blamed(warning: Row) -> set[str]:
    """Return the causes that a warning, as :meth:`drive_id.common.messages.Message.tree` has it, names."""
    code, values = warning["code"], warning["values"]
    if values.get("causes"):
        return named(*(effect.partition(" ")[0] for effect in values["causes"].split(",")))
    if values.get("rivals"):  # which of them it is is open
        return named(code, *values["rivals"].split(","))
    if "every" in values or code == "decimated":  # a delay, told as that of a decimated log or of late currents
        return named("decimated", "current_latency")
    if code == "misfit":
        code += ".time" if "time" in values else ".small_currents" if "low" in values else ""
    return named(code)


def fitted(one: Drive, samples: Sequence[Samples], method: str) -> Row:
    """Fit by one method and compare with the truth."""
    start, cpu = time.monotonic(), time.process_time()
    try:
        settings = drive_id.FitSettings(method=method, pole_pairs=one.machine.pole_pairs)
        found = drive_id.fit(list(samples), settings=settings)
    except DriveIdError as refusal:
        return {"refused": str(refusal), "seconds": time.monotonic() - start, "cpu": time.process_time() - cpu}
    row: Row = {"seconds": time.monotonic() - start, "cpu": time.process_time() - cpu}
    row["warnings"] = [warning.tree() for warning in found.warnings]
    errors = against(found, partial(true_flux, one), one.i_max, one.resistance())
    row |= {"psi_d": 100 * errors.psi_d, "psi_q": 100 * errors.psi_q, "points": len(errors.z)}
    row["flux_z"] = float(np.sqrt(np.mean(errors.z**2, axis=0)).max())
    row |= {"band": errors.band, "R": 100 * errors.resistance, "R_z": errors.resistance_z}
    if one.swing is not None and found.mechanics is not None:
        row |= _mechanics(one.settings[0], found.mechanics)
    row["corrected"] = {
        entry.name: [entry.value, entry.sigma]
        for entry in found.calibrations
        if entry.applied and abs(entry.value) > 3 * entry.sigma
    }
    row["not_reciprocal"] = any(warning.code == "not_reciprocal" for warning in found.warnings)
    return row


def _mechanics(true: SimulationSettings, found: Mechanics) -> Row:
    """Compare inertia and frictions with the truth: percent, and standard errors."""
    out: Row = {}
    for name, own in MECHANICS.items():
        value, sigma = getattr(found, own), getattr(found, f"sigma_{own}")
        exact = getattr(true, "coulomb_friction" if own == "friction" else own)
        if value is not None and exact:
            out |= {name: 100 * (value / exact - 1), f"{name}_z": (value - exact) / sigma}
    return out


def mechanics_lines(rows: Sequence[Row], method: str) -> list[str]:
    """Return rows of a table: how often the standard errors of the mechanics hold, over drives that obey the model."""
    out = ["| of free shafts that obey the model | median error | rms of z | within 1.96 |", "|---|---|---|---|"]
    for name in MECHANICS:
        fits = [row["fits"][method] for row in rows if row["well_posed"] and name in row["fits"].get(method, {})]
        z = np.abs([fit[f"{name}_z"] for fit in fits])
        if len(z):
            size = float(np.median(np.abs([fit[name] for fit in fits])))
            rms, share = float(np.sqrt(np.mean(z**2))), 100 * float(np.mean(z < BAND))
            out.append(f"| {name} | {size:.2g} % | {rms:.2f} | {share:.0f} % of {len(z)} |")
    return out


def measured(seed: int, number: int, methods: Sequence[str], cache: Path | None, free_shaft: bool = False) -> Row:
    """Simulate one drive and fit it by all methods."""
    one = drive(seed, number)
    one = on_free_shaft(one) if free_shaft else one
    row: Row = {**one.labels(), "fits": {}}
    start = time.monotonic()
    try:
        samples = recordings(one, cache)
    except DriveIdError as error:
        return {**row, "not_simulated": str(error)}
    row["simulation"] = time.monotonic() - start
    amplitudes = [np.abs(frames.space_vector(part.i_abc)) for part in samples]
    row["reach"] = max(float(np.quantile(each, _USUAL)) for each in amplitudes) / one.i_max
    row["well_posed"] &= row["reach"] < MOST_REACH
    row["fits"] = {method: fitted(one, samples, method) for method in methods}
    return row


def _serve(pipe: connection.Connection) -> None:
    """Measure what is asked for, in a process of its own, which a crash ends: that is a finding."""
    while (task := pipe.recv()) is not None:
        pipe.send(measured(*task))


@dataclass
class Worker:
    """A process that measures one drive after another."""

    pipe: connection.Connection
    process: Any
    number: int = -1
    deadline: float = 0.0

    @classmethod
    def started(cls) -> Worker:
        """Start a process."""
        context = multiprocessing.get_context("spawn")
        ours, its = context.Pipe()
        process = context.Process(target=_serve, args=(its,), daemon=True)
        process.start()
        its.close()
        return cls(ours, process)

    def ask(
        self, seed: int, number: int, methods: Sequence[str], cache: Path | None, timeout: float, free_shaft: bool
    ) -> None:
        """Begin one drive."""
        self.number, self.deadline = number, time.monotonic() + timeout
        self.pipe.send((seed, number, methods, cache, free_shaft))

    def answer(self, seed: int) -> Row | None:
        """Return the row of the drive; None while it is measured. The process is dead after a crash or timeout."""
        if self.pipe.poll():
            try:
                row: Row = self.pipe.recv()
            except (EOFError, OSError):
                self.process.join()
                return self._lost(seed, f"the process ended with code {self.process.exitcode}")
            return row
        if time.monotonic() > self.deadline:
            self.process.kill()
            return self._lost(seed, "it took too long")
        return None

    def _lost(self, seed: int, why: str) -> Row:
        self.process.join()
        return {**drive(seed, self.number).labels(), "fits": {}, "lost": why}


def rows(
    seed: int,
    numbers: Sequence[int],
    methods: Sequence[str],
    cache: Path | None,
    jobs: int,
    timeout: float = TIMEOUT,
    *,
    free_shaft: bool = False,
) -> Iterator[Row]:
    """Measure drives in processes of their own, and yield the rows in the order in which they are ready."""
    waiting, idle, busy = list(numbers), list[Worker](), list[Worker]()
    while waiting or busy:
        while waiting and len(busy) < jobs:
            worker = idle.pop() if idle else Worker.started()
            worker.ask(seed, waiting.pop(0), methods, cache, timeout, free_shaft)
            busy.append(worker)
        connection.wait([worker.pipe for worker in busy], timeout=1.0)
        for worker in [*busy]:
            if (row := worker.answer(seed)) is not None:
                busy.remove(worker)
                if worker.process.is_alive():
                    idle.append(worker)
                yield row
    for worker in idle:
        worker.pipe.send(None)
        worker.process.join()


def judged(row: Row, method: str) -> set[str]:
    """Return the verdicts on a fit.

    ``silent``: flux error above 0.3 % and three standard errors and no warning; ``silent R``: R beyond three standard
    errors and 1 %, and no warning; ``false warning``: an ordinary drive with an error below 0.2 % was warned of;
    ``wrong cause``: the warnings name causes and none of them is the drive's; ``false effect``: something was
    corrected that the drive has not; ``refused`` and ``crashed``.
    """
    fit = row["fits"].get(method)
    if fit is None or "refused" in fit:
        return {"refused" if fit else "crashed"}
    causes, warned, out = {*row["causes"]}, bool(fit["warnings"]), set()
    flux = max(fit["psi_d"], fit["psi_q"])
    if row["expected"] != "documented" and not warned:
        out |= {"silent"} if flux > 0.3 and fit["flux_z"] > 3 else set()
        out |= {"silent R"} if abs(fit["R_z"]) > 3 and abs(fit["R"]) > 1 else set()
    if not row["effects"] and flux < 0.2 and any(not _true(warning, causes) for warning in fit["warnings"]):
        out.add("false warning")
    told = set[str]().union(*(blamed(warning) for warning in fit["warnings"] if warning["code"] not in _WEAK))
    if told and not told & causes:
        out.add("wrong cause")
    if named(*fit["corrected"]) - causes - {"gains", "offsets", "angle", "timing"}:
        out.add("false effect")
    return out


def _true(warning: Row, causes: set[str]) -> bool:
    """Return whether a warning names a cause that the drive has, or says what the data leave open."""
    return bool(blamed(warning) & causes) or warning["code"] in _WEAK


def read(path: Path) -> dict[int, Row]:
    """Return the rows of an output by number, the last of each.

    An unfinished line at the end is left out; so are rows of earlier versions, whose warnings have no codes.
    """
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        if not any(isinstance(said, str) for fit in row["fits"].values() for said in fit.get("warnings", ())):
            found[row["number"]] = row
    return found


def line_of(row: Row) -> str:
    """Return what is printed for a drive."""
    cells = []
    for method, fit in row["fits"].items():
        verdicts = ", ".join(sorted(judged(row, method)))
        if "psi_d" in fit:
            cells.append(
                f"{method} {fit['psi_d']:.3f}/{fit['psi_q']:.3f} % R {fit['R']:+.1f} % ({fit['R_z']:+.1f}) "
                + "".join(f"{name} {fit[name]:+.2f} % ({fit[f'{name}_z']:+.1f}) " for name in MECHANICS if name in fit)
                + f"band {fit['band']:.2f} {len(fit['warnings'])}w {fit['seconds']:.1f}s {verdicts}"
            )
        else:
            cells.append(f"{method} {verdicts}: {fit['refused']}")
    what = row.get("not_simulated") or row.get("lost") or "; ".join(cells)
    return f"{row['number']:4d} {row['family']:10s} {','.join(row['effects']) or '-':30s} {what}"


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description="Fit a population of random drives and compare with the truth.")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of drives, fitted again")
    parser.add_argument(
        "--free-shaft", action="store_true", help="the same drives without load machine; give another --output"
    )
    parser.add_argument("--methods", default="full,joint")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--samples-cache", type=Path, help="keep the simulated samples in this folder (4 MB a drive)")
    parser.add_argument("--output", type=Path, default=Path("out/population.json"), help="one line of JSON per drive")
    parser.add_argument("--page", type=Path, help="page to write (Markdown)")
    parser.add_argument("--fresh", type=Path, help="output of another seed, for a section of the page")
    parser.add_argument("--against", type=Path, help="earlier output: list the drives that got worse")
    parser.add_argument("--timeout", type=float, default=TIMEOUT, help="of one drive, s")
    options = parser.parse_args()
    for folder in (options.output.parent, *([options.samples_cache] if options.samples_cache else [])):
        folder.mkdir(parents=True, exist_ok=True)
    known, methods = read(options.output), options.methods.split(",")
    wanted = range(options.count) if options.only is None else options.only
    missing = [
        number
        for number in wanted
        if options.only is not None or number not in known or known[number]["seed"] != options.seed
    ]
    with options.output.open("a", encoding="utf-8") as output:
        measuring = (options.seed, missing, methods, options.samples_cache, options.jobs, options.timeout)
        for row in rows(*measuring, free_shaft=options.free_shaft):
            known[row["number"]] = row
            output.write(json.dumps(row) + "\n")
            output.flush()
            print(line_of(row), flush=True)
    chosen = [known[number] for number in wanted if number in known]
    verdicts = {(row["number"], method): judged(row, method) for row in chosen for method in methods}
    command = f'make population ARGS="--count {options.count} --seed {options.seed}"'
    lines = [*population_report.page(chosen, methods, verdicts, command)]
    if options.fresh:
        others = [*read(options.fresh).values()]
        judgements = {(row["number"], method): judged(row, method) for row in others for method in methods}
        lines += population_report.fresh(others, methods, judgements)
    if options.free_shaft:
        lines += ["", *mechanics_lines(chosen, methods[0])]
    if options.page:
        options.page.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print("\n".join(lines))
    if options.against:
        print("\n".join(population_report.worse(chosen, read(options.against), methods)))


if __name__ == "__main__":
    main()
