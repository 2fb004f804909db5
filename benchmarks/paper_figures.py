"""The paper's figures, and the picture of the README: a simulated drive of known truth, by all methods.

Usage: python benchmarks/paper_figures.py FOLDER
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from reproduction import MACHINES, METHODS, SECONDS, SIMULATION

from drive_id.bench.machines import machine_map
from drive_id.core.fit_settings import FitSettings
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.identify import identify
from drive_id.core.validation.metrics import true_flux
from drive_id.fitting.simulated import run_experiment
from drive_id.result.pictures.diagnostics import draw_inverter
from drive_id.result.pictures.panels import CURRENT, PSI, Disc, add_colour_bar, add_key, draw_flux, levels, place
from drive_id.result.pictures.picture import rendered
from drive_id.result.pictures.plots import trajectory
from drive_id.types import FloatArray, GroundTruth, Samples

DPI = 140
"""Makes the picture of the README 1456 pixels wide and less than 400 kB."""


def draw_result(
    identification: IdentifiedDrive, samples: Sequence[Samples], truth: GroundTruth | None = None
) -> Figure:
    """Draw both fluxes, the trajectory and the inverter's curve, beside the true one of a simulation, in one figure."""
    figure = Figure(figsize=(10.4, 3.55))
    disc, i_dq = Disc(identification.flux_map, identification.i_max), trajectory(samples)
    for left, component in zip((0.65, 4.22), "dq", strict=True):
        draw_flux(place(figure, left, 0.65, 2.5, 2.6), disc, component, i_dq)
    draw_inverter(place(figure, 7.8, 0.7, 2.45, 2.5), identification, truth)
    add_key(figure, disc, i_dq, height=0.2)
    return figure


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


def figures() -> dict[str, bytes]:
    """Return PNG files by name."""
    simulation = run_experiment(machine_map(MACHINES[0]), SIMULATION, seconds=SECONDS)
    fits = {method: identify([simulation.samples], FitSettings(method=method)) for method in METHODS}
    found = {
        f"flux_comparison_{component}.png": rendered(
            draw_comparison(fits["joint"], fits["psm"], simulation.truth, component, fits["full"]), dpi=120
        )
        for component in "qd"
    }
    found["result.png"] = rendered(draw_result(fits["full"], [simulation.samples], simulation.truth), dpi=DPI)
    return found


def main() -> None:
    """Draw and write."""
    parser = argparse.ArgumentParser(description="Draw the paper's figures.")
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, png in figures().items():
        (folder / name).write_bytes(png)


if __name__ == "__main__":
    main()
