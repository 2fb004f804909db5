"""Results as tables that an engineer reads."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:  # the command line must start without loading the numerics
    from drive_id.files.bag_reader import BagInfo
    from drive_id.types import GroundTruth
    from drive_id.workflows import Fit


def fit_table(fit: Fit) -> Table:
    """Lay out a fit: value, standard deviation, and the truth where the bag carries it."""
    identification, report, truth = fit.identification, fit.identification.report, fit.recording.truth
    table = Table(title=f"Identified drive, method {identification.method}", title_justify="left")
    table.add_column("Quantity")
    table.add_column("Value", justify="right")
    table.add_column("1-sigma", justify="right")
    if truth:
        table.add_column("Truth", justify="right")

    def row(name: str, value: str, sigma: str = "", true: str = "") -> None:
        table.add_row(name, value, sigma, *([true] if truth else []))

    row(
        "R (stator + linear inverter part)",
        _number(identification.resistance * 1e3, "mohm"),
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
        table.add_column(name)
    table.add_column("Messages", justify="right")
    for topic in info.topics:
        table.add_row(escape(topic.name), escape(topic.type_name), "?" if topic.count is None else str(topic.count))
    return table


def _drop_at_i_max(truth: GroundTruth) -> float:
    return float(truth.inverter_voltage[truth.inverter_current.searchsorted(truth.i_max, side="right") - 1])


def _number(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}" if math.isfinite(value) else "diverged"
