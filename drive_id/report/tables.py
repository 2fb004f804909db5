"""Results as tables that an engineer reads."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:  # the command line must start without loading the numerics
    from pathlib import Path

    from drive_id.core.planning.planner import Plan
    from drive_id.files.read.info import BagInfo
    from drive_id.files.results.information import StoredInformation
    from drive_id.fitting.workflows import Fit
    from drive_id.types import GroundTruth


def fit_table(fit: Fit) -> Table:
    """Lay out a fit: value, standard deviation, and the truth where the bag carries it."""
    identification, report, truth = fit.identification, fit.identification.report, fit.recording.truth
    table = Table(title=f"Identified drive, method {identification.method}", title_justify="left")
    table.add_column("Quantity", overflow="fold")
    table.add_column("Value", justify="right", no_wrap=True, overflow="fold")
    table.add_column("1-sigma", justify="right", no_wrap=True, overflow="fold")
    if truth:
        table.add_column("Truth", justify="right", no_wrap=True, overflow="fold")

    def row(name: str, value: str, sigma: str = "", true: str = "") -> None:
        table.add_row(name, value, sigma, *([true] if truth else []))

    row(
        "R (stator + linear inverter part)",
        _number(identification.resistance * 1e3, "mohm", 6),
        _number(identification.sigma_resistance * 1e3, "mohm"),
        _number(truth.resistance * 1e3, "mohm") if truth else "",
    )
    if identification.method != "psm":
        row(
            "u_e (drop, opposes the current)",
            _number(identification.voltage_error, "V"),
            _number(identification.sigma_voltage_error, "V"),
            _number(_drop_at_i_max(truth), "V") if truth else "",
        )
    for found in identification.calibrations:
        applied = "taken out" if found.applied else "not taken out"
        if math.isfinite(found.sigma):
            unit = found.unit if found.unit != "1" else ""
            row(f"{found.name} ({applied})", _number(found.value, unit), _number(found.sigma, unit))
    if identification.method == "full":
        row("Rotor-position harmonics", ", ".join(str(h.order) for h in identification.harmonics) or "none")
    if fit.provenance.nrmse:
        row("NRMSE of psi_d / psi_q", " / ".join(f"{100 * value:.3f} %" for value in fit.provenance.nrmse))
    row("MAD of simulated i_d / i_q", f"{_number(report.mad_d, 'A')} / {_number(report.mad_q, 'A')}")
    row("Residual voltage, rms", _number(report.residual_rms, "V"))
    row(f"Disc of {identification.i_max:.4g} A covered", f"{100 * report.coverage:.1f} %")
    unseen = f" ({report.unseen} without any data)" if report.unseen else ""
    row("Unknowns determined", f"{report.rank} of {report.parameters}{unseen}")
    row("Condition number", f"{report.condition:.3g}")
    row("Samples used", f"{report.samples_used} of {report.samples_read}")
    row("Gaps", str(report.gaps))
    return table


def info_table(info: BagInfo) -> Table:
    """Lay out what a bag holds."""
    compression = f", {info.compression}" if info.compression else ""
    title = f"{info.path}: {info.storage}{compression}, {info.size / 1e6:.2f} MB, {info.duration:.3f} s"
    table = Table(title=escape(title), title_justify="left")
    for name in ("Topic", "Type"):
        table.add_column(name, overflow="fold")
    table.add_column("Messages", justify="right", no_wrap=True, overflow="fold")
    for topic in info.topics:
        table.add_row(escape(topic.name), escape(topic.type_name), "?" if topic.count is None else str(topic.count))
    return table


def plan_tables(plan: Plan) -> list[Table]:
    """Lay out a plan: what to do, what the drive needs for it, and what to expect beside the paper's experiment."""
    experiment, trajectory = plan.experiment, plan.experiment.trajectory
    proposal = Table(title="Proposed experiment", title_justify="left")
    proposal.add_column("Quantity", overflow="fold")
    proposal.add_column("Value", overflow="fold")
    frequencies = f"{trajectory.frequency_d:g} Hz on d, {trajectory.frequency_q:g} Hz on q, {trajectory.form}"
    proposal.add_row("Lissajous figure", f"{trajectory.i_max:g} A; {frequencies}")
    proposal.add_row("Mechanical speeds, in turn", ", ".join(f"{speed:g}" for speed in experiment.speeds) + " rpm")
    proposal.add_row("Duration", f"{experiment.duration:g} s, {experiment.share:g} s at each speed")
    voltages = ", ".join(f"{voltage:.3g}" for voltage in plan.voltages)
    proposal.add_row(
        "Voltage, largest, at each", f"{voltages} V of u_dc / sqrt(3) = {plan.machine.largest_voltage:.4g} V"
    )
    proposal.add_row("|di/dt|, largest", f"{trajectory.slope / 1e3:.3g} A/ms")
    expected = Table(title="Deviations to be expected", title_justify="left")
    expected.add_column("Quantity", overflow="fold")
    for name in ("Proposed", f"Paper's, {plan.paper.duration:g} s", "Ratio"):
        expected.add_column(name, justify="right", no_wrap=True, overflow="fold")
    names = (
        "psi_d over the disc, of the largest",
        "psi_q over the disc, of the largest",
        "R",
        "Inverter's curve, of its height",
        "R, were the maps not reciprocal",
    )
    for name, ours, paper in zip(names, plan.prediction.values(), plan.paper_prediction.values(), strict=True):
        expected.add_row(name, f"{100 * ours:.3f} %", f"{100 * paper:.3f} %", f"{ours / paper:.2f}")
    return [proposal, expected]


def information_table(path: Path, stored: StoredInformation) -> Table:
    """Lay out what an information file holds."""
    found = stored.accumulated
    evidence, information, settings = found.evidence, found.evidence.information, found.evidence.settings
    duration = evidence.samples * evidence.sample_period
    seconds = sum(piece.duration for piece in found.validation)
    table = Table(title=escape(f"{path}: written by drive_id {stored.software}"), title_justify="left")
    table.add_column("Quantity", overflow="fold")
    table.add_column("Value", overflow="fold")
    table.add_row("Samples", f"{found.samples}, {duration:.3f} s, {evidence.gaps} gaps")
    table.add_row("Disc", f"{evidence.i_max:.6g} A, {100 * evidence.coverage():.1f} % covered")
    table.add_row("Flux model", f"{settings.flux_model}, {evidence.model.parameters} unknowns")
    table.add_row("Blocks of time", f"{len(information.blocks)} of {information.block_duration:.4g} s")
    table.add_row("Kept for the MAD", f"{seconds:.3f} s of {len(found.validation)} recordings")
    if found.truth:
        table.add_row("Truth of", escape(found.truth.machine))
    for file, digest in found.digests.items():
        table.add_row(escape(file), f"sha256 {digest[:16]}...")
    return table


def _drop_at_i_max(truth: GroundTruth) -> float:
    return float(truth.inverter_voltage[truth.inverter_current.searchsorted(truth.i_max, side="right") - 1])


def _number(value: float, unit: str, digits: int = 4) -> str:
    if math.isfinite(value):
        return f"{value:.{digits}g} {unit}".rstrip()
    return "unknown" if math.isinf(value) else "diverged"
