"""The paper's figures: one flux by several methods, and their errors, on a simulated drive of known truth."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from drive_id.core.result.identification import FluxMap, IdentifiedDrive
from drive_id.core.validation.metrics import true_flux
from drive_id.report.panels import CURRENT, PSI, add_colour_bar, levels
from drive_id.types import FloatArray, GroundTruth


def draw_comparison(
    joint: IdentifiedDrive,
    psm: IdentifiedDrive,
    truth: GroundTruth,
    component: str,
    full: IdentifiedDrive | None = None,
) -> Figure:
    """Draw one flux as the paper's figures do: with (a) and without (b) the inverter, and below their errors.

    Parameters
    ----------
    joint, psm : IdentifiedDrive
    truth : GroundTruth
    component : str
        ``d`` or ``q``.
    full : IdentifiedDrive, optional
        By method ``full``, drawn as (c).
    """
    pairs = [("(a) joint identification", joint), ("(b) without modelling the inverter", psm)]
    if full is not None:
        pairs.append(("(c) full identification", full))
    figure = Figure(figsize=(5.5 * len(pairs), 9.0))
    sides = {"left": 0.14 / len(pairs), "right": 1 - 0.18 / len(pairs)}
    cells = figure.add_gridspec(2, len(pairs), bottom=0.06, top=0.96, wspace=0.35, hspace=0.15, **sides)
    errors = [_error(identification, truth, component) for _, identification in pairs]
    limit = float(np.nanmax(np.abs(errors))) * 1e3
    for column, ((title, identification), error) in enumerate(zip(pairs, errors, strict=True)):
        flux_map = identification.flux_map
        values = _masked(flux_map, identification.i_max, component)
        i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
        surface = figure.add_subplot(cells[0, column], projection="3d")
        surface.plot_surface(i_d, i_q, values, cmap="viridis", linewidth=0.2, edgecolor="black", rstride=2, cstride=2)
        surface.set(title=title, xlabel=f"{CURRENT['d']} / A", ylabel=f"{CURRENT['q']} / A")
        surface.set_zlabel(f"{PSI[component]} / Wb")
        flat = figure.add_subplot(cells[1, column])
        filled = flat.pcolormesh(i_d, i_q, error * 1e3, cmap="RdBu_r", vmin=-limit, vmax=limit, shading="nearest")
        flat.set(title=f"error of {PSI[component]} / mWb", xlabel=f"{CURRENT['d']} / A", ylabel=f"{CURRENT['q']} / A")
        flat.set_aspect("equal")
        add_colour_bar(flat, filled, levels(-limit, limit, 10))
    return figure


def _masked(flux_map: FluxMap, i_max: float, component: str) -> FloatArray:
    """Return one flux (D, Q), Wb, NaN where there are no data in the disc."""
    radius = np.hypot(flux_map.i_d[:, None], flux_map.i_q)
    inside = flux_map.inside & (radius <= i_max)
    values = flux_map.psi_d if component == "d" else flux_map.psi_q
    return np.where(inside, values, np.nan)


def _error(identification: IdentifiedDrive, truth: GroundTruth, component: str) -> FloatArray:
    flux_map = identification.flux_map
    grid = flux_map.grid()
    values = _masked(flux_map, identification.i_max, component)
    return np.asarray(values - true_flux(truth, grid)[..., "dq".index(component)])
