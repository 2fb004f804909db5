"""Tables for the console: fits, bags, information files, plans."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:  # the command line must start without loading the numerics
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from drive_id.analysis.folder import Figure
    from drive_id.core.planning.planner import Plan
    from drive_id.core.result.identification import IdentifiedDrive, TorqueFit
    from drive_id.files.read.info import BagInfo
    from drive_id.files.results.identification import Provenance
    from drive_id.files.results.information import StoredInformation
    from drive_id.fitting.result import Identification
    from drive_id.types import GroundTruth


def fit_table(fit: Identification) -> Table:
    """Lay out a result: values, standard errors, and the ground truth where the recording carries it."""
    identification, report, truth, known = fit.drive, fit.drive.report, fit.truth, fit.provenance
    origin = identification.origin
    if not origin.fitted:
        return _imported_table(fit)
    numbers = ["Value", "Std. error", *(["Truth"] if truth else [])]
    table = _table(f"{origin.heading}, {origin.caption}", ["Quantity"], numbers)

    def row(name: str, value: str, sigma: str = "", true: str = "") -> None:
        table.add_row(name, value, sigma, *([true] if truth else []))

    row(
        "R (stator + linear inverter part)",
        _number(identification.resistance * 1e3, "mohm", 6),
        _number(identification.sigma_resistance * 1e3, "mohm"),
        _number(truth.resistance * 1e3, "mohm") if truth else "",
    )
    if origin.inverter:
        row(
            "u_e (drop, opposes the current)",
            _number(identification.voltage_error, "V"),
            _number(identification.sigma_voltage_error, "V"),
            _number(_drop_at_i_max(truth), "V") if truth else "",
        )
    for found in identification.calibrations:
        applied = "corrected" if found.applied else "not corrected"
        if math.isfinite(found.sigma):
            unit = found.unit if found.unit != "1" else ""
            row(f"{found.name} ({applied})", _number(found.value, unit), _number(found.sigma, unit))
    for cells in (*_torque_rows(identification.torque), *_by_method(identification)):
        row(*cells)
    if fit.provenance.nrmse:
        row("NRMSE of psi_d / psi_q", " / ".join(f"{100 * value:.3f} %" for value in fit.provenance.nrmse))
    if origin.diagnostics:
        row("MAD of simulated i_d / i_q", f"{_number(report.mad_d, 'A')} / {_number(report.mad_q, 'A')}")
    row("Residual voltage, rms", _number(report.residual_rms, "V"))
    row(f"Disc of {identification.i_max:.4g} A covered", f"{100 * report.coverage:.1f} %")
    if origin.live:
        unseen = f" ({report.unseen} without any data)" if report.unseen else ""
        row("Unknowns determined", f"{report.rank} of {report.parameters}{unseen}")
    row("Condition number", f"{report.condition:.3g}")
    row("Experiment", ", ".join(_experiment(known)))
    row("Samples used", f"{report.samples_used} of {report.samples_read}")
    if origin.live:
        row("Gaps", str(report.gaps))
    return table


def _torque_rows(torque: TorqueFit | None) -> list[tuple[str, ...]]:
    if torque is None:
        return []
    viscous, sigma_viscous = torque.viscous_friction, torque.sigma_viscous_friction or 0.0
    unit = "Nm s/rad"
    return [
        ("Shaft torque / torque of the map", f"{torque.gain:.5g}", f"{torque.sigma_gain:.2g}"),
        ("Friction torque", _number(torque.friction, "Nm"), _number(torque.sigma_friction, "Nm")),
        *([] if viscous is None else [("Viscous friction", _number(viscous, unit), _number(sigma_viscous, unit))]),
        *(
            (f"Cogging torque, order {found.order}", _number(found.amplitude, "Nm"), _number(found.sigma, "Nm"))
            for found in torque.cogging
        ),
        ("Torque error of the map, rms", _number(torque.rms_map, "Nm")),
    ]


def _by_method(identification: IdentifiedDrive) -> list[tuple[str, ...]]:
    """Return rows that only one method has: rotor harmonics, or magnet flux and inductances with standard errors."""
    if identification.origin.harmonics:
        orders = ", ".join(str(harmonic.order) for harmonic in identification.harmonics)
        return [("Rotor-position harmonics", orders or "none")]
    linear = identification.linear
    if linear is None:
        return []
    return [
        ("Magnet flux", _number(linear.psi_pm * 1e3, "mWb"), _number(linear.sigma_psi_pm * 1e3, "mWb")),
        ("L_d at zero current", _number(linear.l_d * 1e3, "mH"), _number(linear.sigma_l_d * 1e3, "mH")),
        ("L_q at zero current", _number(linear.l_q * 1e3, "mH"), _number(linear.sigma_l_q * 1e3, "mH")),
    ]


def _imported_table(imported: Identification) -> Table:
    """Lay out an imported map: what is known of the machine."""
    drive = imported.drive
    table = _table(drive.origin.heading, ["Quantity"], ["Value"])
    known = math.isfinite(drive.resistance)
    table.add_row("R", _number(drive.resistance * 1e3, "mohm", 6) if known else "unknown")
    table.add_row("Machine", ", ".join(_experiment(imported.provenance)))
    table.add_row(f"Disc of {drive.i_max:.4g} A covered", f"{100 * drive.report.coverage:.1f} %")
    table.add_row("Points read", str(drive.report.samples_read))
    table.add_row("Rotor-position harmonics", ", ".join(str(h.order) for h in drive.harmonics) or "none")
    return table


def _experiment(known: Provenance) -> list[str]:
    """Say what is known of the experiment besides the fit."""
    said = [known.machine, known.date, f"{known.duration:.4g} s" if known.duration else ""]
    if known.speed_range:
        low, high = (f"{speed:.4g}" for speed in known.speed_range)
        said.append(f"{low} to {high} rad/s" if low != high else f"{low} rad/s")
    said += [f"{known.pole_pairs} pole pairs" if known.pole_pairs else "", f"{known.u_dc:g} V" if known.u_dc else ""]
    return [escape(text) for text in said if text]


def info_table(info: BagInfo) -> Table:
    """List the topics of a bag."""
    compression = f", {info.compression}" if info.compression else ""
    title = f"{info.path}: {info.storage}{compression}, {info.size / 1e6:.2f} MB, {info.duration:.3f} s"
    table = _table(title, ["Topic", "Type"], ["Messages"])
    for topic in info.topics:
        table.add_row(escape(topic.name), escape(topic.type_name), "?" if topic.count is None else str(topic.count))
    return table


def plan_tables(plan: Plan) -> list[Table]:
    """Lay out a plan: the experiment, what it demands of the drive, and standard errors beside the paper's."""
    experiment, trajectory = plan.experiment, plan.experiment.trajectory
    proposal = _table("Proposed experiment", ["Quantity", "Value"])
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
    expected = _table("Expected relative standard errors", ["Quantity"], numbers)
    names = (
        "psi_d, rms over the disc",
        "psi_q, rms over the disc",
        "R",
        "Inverter curve, rms up to i_max",
        "R without assuming reciprocal maps",
    )
    for name, ours, paper in zip(names, plan.prediction.values(), plan.paper_prediction.values(), strict=True):
        expected.add_row(name, f"{100 * ours:.3f} %", f"{100 * paper:.3f} %", f"{ours / paper:.2f}")
    return [proposal, expected]


def information_table(path: Path, stored: StoredInformation) -> Table:
    """Lay out the content of an information file."""
    found = stored.accumulated
    evidence, information, settings = found.evidence, found.evidence.information, found.evidence.settings
    duration = evidence.samples * evidence.sample_period
    seconds = sum(piece.duration for piece in found.validation)
    table = _table(f"{path}: written by drive_id {stored.software}", ["Quantity", "Value"])
    table.add_row("Samples", f"{found.samples}, {duration:.3f} s, {evidence.gaps} gaps")
    table.add_row("Disc", f"{evidence.i_max:.6g} A, {100 * evidence.coverage():.1f} % covered")
    table.add_row("Flux model", f"{settings.flux_model}, {evidence.model.parameters} unknowns")
    table.add_row("Time blocks", f"{len(information.blocks)} of {information.block_duration:.4g} s")
    table.add_row("Samples kept for the MAD", f"{seconds:.3f} s of {len(found.validation)} recordings")
    if found.truth:
        table.add_row("Ground truth of", escape(found.truth.machine))
    for file, digest in found.digests.items():
        table.add_row(escape(file), f"sha256 {digest[:16]}...")
    return table


def figures_table(name: str, figures: Mapping[str, Figure]) -> Table:
    """Lay out the single numbers of an analysis with their standard errors."""
    table = _table(f"Analysis of {name}", ["Quantity"], ["Value", "Std. error", ""])
    for quantity, figure in figures.items():
        value, sigma, unit = figure.value, figure.sigma, figure.unit
        if unit in _SHOWN:
            factor, unit = _SHOWN[unit]
            value, sigma = factor * value, factor * sigma
        shown = f"{value:.5g} {unit.removeprefix('1')}".rstrip() if math.isfinite(value) else "unknown"
        error = f"{sigma:.2g} {unit.removeprefix('1')}".rstrip() if math.isfinite(sigma) else ""
        table.add_row(quantity.replace("_", " "), shown, error, "" if figure.inside else "outside the data")
    return table


_SHOWN = {
    "ohm": (1e3, "mohm"), "Wb": (1e3, "mWb"), "H": (1e3, "mH"), "rad": (180 / math.pi, "deg"),
    "rad/s": (30 / math.pi, "rpm"),
}  # fmt: skip
"""Factor and name of the unit in which a quantity is shown."""


def _table(title: str, texts: Sequence[str], numbers: Sequence[str] = ()) -> Table:
    """Return a table without rows: columns of text, which may wrap, then columns of numbers, which do not."""
    table = Table(title=escape(title), title_justify="left")
    for name in texts:
        table.add_column(name, overflow="fold")
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True, overflow="fold")
    return table


def _drop_at_i_max(truth: GroundTruth) -> float:
    return float(truth.inverter_voltage[truth.inverter_current.searchsorted(truth.i_max, side="right") - 1])


def _number(value: float, unit: str, digits: int = 4) -> str:
    if math.isfinite(value):
        return f"{value:.{digits}g} {unit}".rstrip()
    return "unknown" if math.isinf(value) else "diverged"
