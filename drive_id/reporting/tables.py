"""Tables for the console: fits, bags, information files, plans."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from drive_id.common.quantity import counted, measured

if TYPE_CHECKING:  # the command line must start without loading the numerics
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from drive_id.analysis.folder import Analysis
    from drive_id.core.planning.planner import Plan
    from drive_id.core.result.identification import Mechanics, TorqueFit
    from drive_id.files.read.info import BagInfo
    from drive_id.files.results.information import StoredInformation
    from drive_id.result.result import Result
    from drive_id.types import GroundTruth

_NAME = 12
"""Least width of the column of names, characters."""


def fit_table(fit: Result, *, verbose: bool = False) -> Table:
    """Lay out a result: what is asked for first, then how good it is, and the ground truth where it is known.

    ``verbose`` adds the faults that were not found, and the figures of the regression.
    """
    drive, report, truth, known, origin = fit.drive, fit.drive.report, fit.truth, fit.provenance, fit.origin
    method = f", {origin.caption}" if origin.fitted else ""
    name = f": {fit.name}" if fit.name else ""
    title = "\n".join(filter(None, (f"{origin.heading}{name}{method}", ", ".join(_experiment(fit)))))
    table = plain_table(title, ["Quantity"], ["Value", *(["Truth"] if truth else [])])

    def row(name: str, value: str, true: str = "") -> None:
        table.add_row(name, value, *([true] if truth else []))

    for quantity in fit.headline:
        row(quantity.name, str(quantity), _true(quantity.name, truth) if truth else "")
    if not math.isfinite(drive.resistance):
        row("R", "unknown")
    for found in drive.calibrations:
        if math.isfinite(found.sigma) and (found.applied or verbose):
            state = "" if found.applied else " (not corrected)"
            row(f"{found.name.replace('_', ' ')}{state}", fit.told(found.value, found.sigma, found.unit))
    if origin.harmonics:
        row("Rotor-position harmonics", ", ".join(str(h.order) for h in drive.flux_map.harmonics) or "none")
    table.add_section()
    of_shaft = _torque_rows(drive.torque) if drive.torque else []
    for cells in (*of_shaft, *(shaft_rows(drive.mechanics) if drive.mechanics else ())):
        row(*cells)
    if known.nrmse:
        row("NRMSE of ψ_d / ψ_q", " / ".join(f"{100 * value:.3f} %" for value in known.nrmse))
    if origin.diagnostics:
        row(
            "Mean error of simulated i_d / i_q",
            " / ".join(_deviation(fit, value) for value in (report.mad_d, report.mad_q)),
        )
    if origin.fitted:
        row("Residual, rms over a sample", measured(report.residual_rms, unit="V"))
    row("Disc covered", f"{100 * report.coverage:.1f} %")
    for cells in _regression_rows(fit) if verbose and origin.fitted else ():
        row(*cells)
    used = f"{report.samples_used} of " if origin.fitted else ""
    row("Samples used" if origin.fitted else "Points read", f"{used}{report.samples_read}")
    return table


def _regression_rows(fit: Result) -> list[tuple[str, str]]:
    report = fit.drive.report
    unseen = f" ({report.unseen} without any data)" if report.unseen else ""
    sums = [("Unknowns determined", f"{report.rank} of {report.parameters}{unseen}"), ("Gaps", str(report.gaps))]
    return [*(sums if fit.origin.live else []), ("Condition number", f"{report.condition:.3g}")]


def _true(name: str, truth: GroundTruth) -> str:
    """Return the true value of a quantity of the headline, where the truth of a simulation has it as a number."""
    if name == "R":
        return measured(truth.resistance, unit="Ω", size=truth.resistance)
    if name != "Inverter drop":
        return ""
    at = truth.inverter_current.searchsorted(truth.i_max, side="right") - 1
    return measured(float(truth.inverter_voltage[at]), unit="V")


def _torque_rows(torque: TorqueFit) -> list[tuple[str, str]]:
    rows = [
        ("Shaft torque / torque of the map", measured(torque.gain, torque.sigma_gain)),
        ("Friction torque", measured(torque.friction, torque.sigma_friction, "Nm")),
    ]
    if torque.viscous_friction is not None:
        viscous = measured(torque.viscous_friction, torque.sigma_viscous_friction or 0.0, "Nm s/rad")
        rows.append(("Viscous friction", viscous))
    rows += [(f"Cogging torque, order {c.order}", measured(c.amplitude, c.sigma, "Nm")) for c in torque.cogging]
    return [*rows, ("Torque error of the map, rms", measured(torque.rms_map, unit="Nm"))]


def shaft_rows(mechanics: Mechanics) -> list[tuple[str, str]]:
    """Return name and value of all that the motion of a free shaft tells, the inertia aside: the headline holds it."""
    terms = (
        ("True torque / torque of the map", mechanics.gain, mechanics.sigma_gain, ""),
        ("Coulomb friction", mechanics.friction, mechanics.sigma_friction, "Nm"),
        ("Viscous friction", mechanics.viscous_friction, mechanics.sigma_viscous_friction, "Nm s/rad"),
        ("Load torque", mechanics.load, mechanics.sigma_load, "Nm"),
        *((f"Cogging and mean ripple, order {c.order}", c.amplitude, c.sigma, "Nm") for c in mechanics.cogging),
    )
    return [(name, measured(x, sigma, unit)) for name, x, sigma, unit in terms if x is not None and sigma is not None]


def _deviation(fit: Result, value: float) -> str:
    """Return a mean deviation of the simulated current, A; NaN tells that the simulation diverged."""
    return "diverged" if math.isnan(value) else fit.told(value, math.nan, "A")


def _experiment(fit: Result) -> list[str]:
    """Say what is known of the experiment besides the fit."""
    known, caption = fit.provenance, fit.caption()
    link = f"{known.u_dc:g} V" if known.u_dc else ""
    pairs = counted(known.pole_pairs, "pole pair") if known.pole_pairs else ""
    duration = f"{known.duration:.4g} s" if known.duration else ""
    names = (known.settings.bench, known.settings.operator, known.settings.notes)
    said = (caption.date, duration, caption.speed(), pairs, link, *names)
    return [text for text in said if text]


def info_table(info: BagInfo) -> Table:
    """List the topics of a bag, or the columns of a file."""
    compression = f", {info.compression}" if info.compression else ""
    duration = f", {info.duration:.3f} s" if info.duration else ""
    of_columns = not any(topic.encoding for topic in info.topics)
    if of_columns and info.duration and info.messages > 1:
        duration = (
            f", {counted(info.messages, 'row')} in {info.duration:.6g} s: {(info.messages - 1) / info.duration:.6g} Hz"
        )
    title = f"{info.path}: {info.storage}{compression}, {info.size / 1e6:.2f} MB{duration}"
    names = ("Column", "Rows") if of_columns else ("Topic", "Messages")
    table = plain_table(title, [names[0], "Type"], [names[1]])
    for topic in info.topics:
        table.add_row(escape(topic.name), escape(topic.type_name), "?" if topic.count is None else str(topic.count))
    return table


def plan_tables(plan: Plan) -> list[Table]:
    """Lay out a plan: the experiment, what it demands of the drive, and standard errors beside the paper's."""
    experiment, trajectory = plan.experiment, plan.experiment.trajectory
    proposal = plain_table("Proposed experiment", ["Quantity", "Value"])
    frequencies = f"{trajectory.frequency_d:g} Hz on d, {trajectory.frequency_q:g} Hz on q, {trajectory.form}"
    proposal.add_row("Lissajous figure", f"{trajectory.i_max:g} A; {frequencies}")
    proposal.add_row(
        "Mechanical speeds, one after the other", ", ".join(f"{speed:g}" for speed in experiment.speeds) + " rpm"
    )
    proposal.add_row("Duration", f"{experiment.duration:g} s, of which {experiment.share:g} s at each speed")
    voltages = ", ".join(f"{voltage:.3g}" for voltage in plan.voltages)
    available = f"{plan.machine.largest_voltage:.4g} V"
    proposal.add_row("Peak voltage at each speed", f"{voltages} V; available: u_dc / sqrt(3) = {available}")
    proposal.add_row("Peak |di/dt|", f"{trajectory.slope / 1e3:.3g} A/ms")
    numbers = ["Proposed", f"Paper's, {plan.paper.duration:g} s", "Ratio"]
    expected = plain_table("Expected relative standard errors", ["Quantity"], numbers)
    names = ("ψ_d, rms over the disc", "ψ_q, rms over the disc", "R", "Inverter curve, rms", "R, maps not reciprocal")
    for name, ours, paper in zip(names, plan.prediction.values(), plan.paper_prediction.values(), strict=True):
        expected.add_row(name, f"{100 * ours:.3f} %", f"{100 * paper:.3f} %", f"{ours / paper:.2f}")
    return [proposal, expected]


def information_table(path: Path, stored: StoredInformation) -> Table:
    """Lay out the content of an information file."""
    found = stored.accumulated
    evidence, information, settings = found.evidence, found.evidence.information, found.evidence.settings
    assert information is not None
    duration = evidence.samples * evidence.sample_period
    seconds = sum(piece.duration for piece in found.validation)
    table = plain_table(f"{path}: written by drive_id {stored.software}", ["Quantity", "Value"])
    table.add_row("Samples", f"{found.samples}, {duration:.3f} s, {counted(evidence.gaps, 'gap')}")
    table.add_row("Disc", f"{evidence.i_max:.6g} A, {100 * evidence.coverage():.1f} % covered")
    table.add_row("Flux model", f"{settings.flux_model}, {counted(information.model.parameters, 'unknown')}")
    table.add_row("Time blocks", f"{len(information.blocks)} of {information.block_duration:.4g} s")
    table.add_row(
        "Samples kept for simulated currents", f"{seconds:.3f} s of {counted(len(found.validation), 'recording')}"
    )
    if found.truth:
        table.add_row("Ground truth of", escape(found.truth.machine))
    for file, digest in found.digests.items():
        table.add_row(escape(file), f"sha256 {digest[:16]}...")
    return table


def figures_table(name: str, analysis: Analysis) -> Table:
    """Lay out the single numbers of an analysis with their standard errors."""
    table = plain_table(f"Analysis of {name}", ["Quantity"], ["Value"])
    table.columns[1].no_wrap = True
    for row in analysis.rows():
        table.add_row(*row)
    return table


def verification_table(rows: Iterable[Sequence[str]]) -> Table:
    """Lay out figures of a verification: name, value, limit and verdict."""
    table = plain_table("Recording against map", ("Figure", "Value", "Limit", "Verdict"))
    for row in rows:
        table.add_row(*row)
    return table


def plain_table(title: str, texts: Sequence[str], numbers: Sequence[str] = ()) -> Table:
    """Return a table without rows: names and cells, which wrap at words where the terminal is narrow."""
    table = Table(title=escape(title), title_justify="left")
    for place, name in enumerate((*texts, *numbers)):
        named = not place
        table.add_column(
            name, justify="right" if place >= len(texts) else "left", min_width=_NAME if named else None,
            overflow="fold",
        )  # fmt: skip
    return table
