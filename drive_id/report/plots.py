"""Pictures of identified maps, as PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drive_id.core import frames
from drive_id.core.result.identification import FluxMap, Identification
from drive_id.core.validation.metrics import true_flux
from drive_id.types import BoolArray, FloatArray, GroundTruth, Samples

_NAMES = {"d": r"$\psi_\mathrm{d}$", "q": r"$\psi_\mathrm{q}$"}


def to_png(figure: Figure) -> bytes:
    """Render a figure."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    with np.errstate(over="ignore", invalid="ignore"):  # matplotlib projects uninitialized corners of surfaces, too
        figure.savefig(buffer, format="png", dpi=120)
    return buffer.getvalue()


def result_pictures(identification: Identification, samples: Sequence[Samples], title: str) -> dict[str, bytes]:
    """Draw what stands beside a result's files.

    Parameters
    ----------
    identification : Identification
    samples : sequence of Samples
        Whose trajectory is drawn over the maps; a part of the recording.
    title : str

    Returns
    -------
    dict of str to bytes
        File names and PNG.
    """
    i_dq = np.concatenate([frames.to_dq(part.i_abc, part.angle) for part in samples]) if samples else None
    figure = draw_flux_maps(identification.flux_map, identification.i_max, i_dq, title)
    return {"flux_map.png": to_png(figure)}


def draw_flux_maps(flux_map: FluxMap, i_max: float, i_dq: FloatArray | None = None, title: str = "") -> Figure:
    """Draw psi_d and psi_q as level lines where there are data in the disc.

    Parameters
    ----------
    flux_map : FluxMap
    i_max : float
        Radius of the disc, A.
    i_dq : (N, 2) float, optional
        Trajectory to draw over them, A.
    title : str
    """
    figure = Figure(figsize=(11.0, 5.0))
    figure.suptitle(title)
    cells = {"left": 0.07, "right": 0.92, "bottom": 0.1, "top": 0.9, "wspace": 0.42}
    for axes, component in zip(figure.subplots(1, 2, gridspec_kw=cells), "dq", strict=True):
        values, inside = _masked(flux_map, i_max, component)
        low, high = float(values[inside].min()), float(values[inside].max())
        levels, lines = _levels(low, high, 20), _levels(low, high, 10)
        filled = axes.contourf(flux_map.i_d, flux_map.i_q, values.T, levels=levels, cmap="viridis")
        if np.any((lines > low) & (lines < high)):  # without any, matplotlib before 3.11 warns
            axes.contour(flux_map.i_d, flux_map.i_q, values.T, levels=lines, colors="black", linewidths=0.5)
        if i_dq is not None:
            axes.plot(i_dq[:, 0], i_dq[:, 1], color="white", linewidth=0.25, alpha=0.5)
        _label(axes, f"{_NAMES[component]} / Wb")
        _add_colour_bar(axes, filled, lines)
    return figure


def draw_comparison(
    joint: Identification,
    psm: Identification,
    truth: GroundTruth,
    component: str,
    full: Identification | None = None,
) -> Figure:
    """Draw one flux as the paper's figures do: with (a) and without (b) the inverter, and below their errors.

    Parameters
    ----------
    joint, psm : Identification
    truth : GroundTruth
    component : str
        ``d`` or ``q``.
    full : Identification, optional
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
        values, _ = _masked(flux_map, identification.i_max, component)
        i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
        surface = figure.add_subplot(cells[0, column], projection="3d")
        surface.plot_surface(i_d, i_q, values, cmap="viridis", linewidth=0.2, edgecolor="black", rstride=2, cstride=2)
        surface.set(title=title, xlabel=r"$i_\mathrm{d}$ / A", ylabel=r"$i_\mathrm{q}$ / A")
        surface.set_zlabel(f"{_NAMES[component]} / Wb")
        flat = figure.add_subplot(cells[1, column])
        filled = flat.pcolormesh(i_d, i_q, error * 1e3, cmap="RdBu_r", vmin=-limit, vmax=limit, shading="nearest")
        _label(flat, f"error of {_NAMES[component]} / mWb")
        _add_colour_bar(flat, filled, _levels(-limit, limit, 10))
    return figure


def _masked(flux_map: FluxMap, i_max: float, component: str) -> tuple[FloatArray, BoolArray]:
    radius = np.hypot(flux_map.i_d[:, None], flux_map.i_q)
    inside = flux_map.inside & (radius <= i_max)
    values = flux_map.psi_d if component == "d" else flux_map.psi_q
    return np.where(inside, values, np.nan), inside


def _error(identification: Identification, truth: GroundTruth, component: str) -> FloatArray:
    flux_map = identification.flux_map
    grid = flux_map.grid()
    values, _ = _masked(flux_map, identification.i_max, component)
    return np.asarray(values - true_flux(truth, grid)[..., "dq".index(component)])


def _levels(low: float, high: float, count: int) -> FloatArray:
    """Return at most ``count`` round steps that enclose a range."""
    return np.asarray(MaxNLocator(count, steps=[1, 2, 5, 10]).tick_values(low, high))


def _add_colour_bar(axes: Axes, filled: ContourSet | QuadMesh, ticks: FloatArray) -> None:
    """Put a colour bar beside axes, as tall as they are whatever their aspect makes of them."""
    beside = axes.inset_axes((1.04, 0.0, 0.045, 1.0))
    axes.figure.colorbar(filled, cax=beside, ticks=ticks)


def _label(axes: Axes, title: str) -> None:
    axes.set(title=title, xlabel=r"$i_\mathrm{d}$ / A", ylabel=r"$i_\mathrm{q}$ / A", aspect="equal")
