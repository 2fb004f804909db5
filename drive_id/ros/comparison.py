"""A table of identified drives side by side, with the truth of a simulated one."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from drive_id_msgs.msg import FluxMap
from rich.table import Table

from drive_id.common.quantity import measured
from drive_id.core.validation.metrics import nrmse, true_flux
from drive_id.ros.bench import Identified
from drive_id.types import GroundTruth


def comparison(results: Mapping[str, Identified], truth: GroundTruth | None) -> Table:
    """Return a table with one column for each result, by its title, and one for the truth where it is known."""
    table = Table(title="The drive, identified through the services", title_justify="left")
    table.add_column("Quantity", no_wrap=True)
    for title in [*results, *(["truth"] if truth else [])]:
        table.add_column(title, justify="right", no_wrap=True)
    maps, reports = [r.flux_map for r in results.values()], [r.report for r in results.values()]
    drop = "" if truth is None else measured(float(truth.inverter_voltage[-1]), unit="V")
    size = max((abs(m.resistance) for m in maps), default=math.nan)
    resistances = [measured(m.resistance, m.sigma_resistance, "Ω", size) for m in maps]
    rows = [
        ("R", resistances, truth and measured(truth.resistance, unit="Ω", size=size)),
        ("Inverter drop", [_drop(m) for m in maps], drop),
        ("Mean error of simulated i_d / i_q", [f"{r.mad_d:.3g} / {r.mad_q:.3g} A" for r in reports], ""),
        ("Disc covered", [f"{100 * r.coverage:.1f} %" for r in reports], ""),
        ("Samples used", [f"{r.samples_used} of {r.samples_read}" for r in reports], ""),
    ]
    if truth is not None:
        errors = [flux_errors(m, truth) for m in maps]
        rows.insert(2, ("NRMSE of ψ_d / ψ_q", [f"{100 * d:.3f} / {100 * q:.3f} %" for d, q in errors], ""))
    if any(math.isfinite(report.inertia) for report in reports):
        true_inertia = math.nan if truth is None else float(truth.details.get("inertia", math.nan))
        found = [measured(r.inertia, r.sigma_inertia, unit="kg m²") for r in reports]
        rows.append(("J", found, measured(true_inertia, unit="kg m²")))
    for name, values, true in rows:
        table.add_row(name, *values, *([true or ""] if truth else []))
    return table


def _drop(flux_map: FluxMap) -> str:
    if not len(flux_map.inverter_current):
        return "not modelled"
    return measured(flux_map.voltage_error, flux_map.sigma_voltage_error, "V")


def flux_errors(flux_map: FluxMap, truth: GroundTruth) -> tuple[float, float]:
    """Return the NRMSE of psi_d and psi_q of a received map within the true disc."""
    shape = len(flux_map.i_d), len(flux_map.i_q)  # row-major
    i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
    psi = np.stack([np.reshape(flux_map.psi_d, shape), np.reshape(flux_map.psi_q, shape)], axis=-1)
    chosen = np.reshape(flux_map.inside, shape) & (np.hypot(i_d, i_q) <= truth.i_max)
    true_psi = true_flux(truth, np.stack([i_d, i_q], axis=-1)[chosen])
    known = np.isfinite(true_psi).all(axis=-1)
    return nrmse(psi[chosen][known], true_psi[known])
