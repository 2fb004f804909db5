"""Pictures of a result, flux maps and diagnostics beside its files with captions, and of a log before a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.result.diagnostics import thinned_trajectory
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.errors import ConfigurationError
from drive_id.result.pictures.caption import NO_CAPTION, Caption
from drive_id.result.pictures.diagnostics import draw_diagnostics
from drive_id.result.pictures.panels import NORMAL, Disc, add_key, draw_flux, name, place
from drive_id.result.pictures.picture import Picture, rendered
from drive_id.result.pictures.styles import style_of
from drive_id.types import FloatArray, Samples

if TYPE_CHECKING:
    from drive_id.core.checks.overview import Overview

WIDTH = 7.2
"""Of a figure, inches: the two columns of a journal, or the text of a page."""
_MOST_POINTS = 30_000
"""Of a trajectory: more look the same, and take longer to draw than the map."""


def result_pictures(
    identification: IdentifiedDrive,
    samples: Sequence[Samples],
    caption: Caption = NO_CAPTION,
    *,
    figure_format: str = "png",
    style: str = "screen",
) -> dict[str, bytes]:
    """Draw the pictures that stand beside a result's files, by file name, as ``png``, ``svg``, ``pdf`` or ``pgf``.

    The trajectory of the samples, excerpts of the recording, is drawn over the maps, their residual over the angle.
    """
    look = style_of(style)
    i_dq = None if figure_format == "pgf" else trajectory(samples)  # PGF in one file holds no pixels
    with rc_context(look.settings):
        figures = {
            "flux_map": draw_flux_maps(identification.answering, identification.i_max, i_dq, caption, style=style),
            "diagnostics": draw_diagnostics(identification, samples, style),
        }
        if look.told:
            add_caption(figures["diagnostics"], caption)
    return {f"{name}.{figure_format}": rendered(figure, figure_format) for name, figure in figures.items()}


def draw_flux_maps(
    flux_map: FluxMap,
    i_max: float,
    i_dq: FloatArray | None = None,
    caption: Caption = NO_CAPTION,
    panels: Sequence[Axes] | None = None,
    *,
    style: str = "screen",
) -> Figure:
    """Draw psi_d and psi_q side by side over the current disc, and a trajectory (N, 2), A, which NaN interrupts.

    On given panels, two axes, instead of those of a new figure, there are no key and caption.

    Raises ConfigurationError when there are not two panels.
    """
    disc, look = Disc(flux_map, i_max), style_of(style)
    with rc_context(look.settings):
        if panels is None:
            figure = Picture(figsize=look.size)
            if look.told:
                add_key(figure, disc, i_dq, height=0.57)
                add_caption(figure, caption)
            panels = [place(figure, *where) for where in look.maps]
        if len(panels) != len("dq"):
            raise ConfigurationError("ax is not a pair of axes: give two, as of plt.subplots(1, 2).")
        for panel, component in zip(panels, "dq", strict=True):
            draw_flux(panel, disc, component, i_dq if look.told else None)
    return panels[0].figure  # type: ignore[return-value]  # or the part of it that holds the panels


def draw_torque_speed(curves: Mapping[str, Sequence[FloatArray]], panel: Axes | None = None) -> Figure:
    """Draw by name speed (S,), rad/s, largest torque and its standard error, Nm, on a panel or in a new figure."""
    axes = Picture(figsize=(WIDTH, 3.75), layout="constrained").add_subplot() if panel is None else panel
    for label, (speed, torque, sigma) in curves.items():
        axes.plot(speed * 30 / np.pi, torque, label=label)
        axes.fill_between(speed * 30 / np.pi, torque - 2 * sigma, torque + 2 * sigma, alpha=0.3)
    name(axes, "Largest torque, band of two standard errors", "Speed / rpm", "Torque / Nm")
    axes.legend(fontsize=NORMAL)
    return axes.figure  # type: ignore[return-value]  # or the part of it that holds the panel


def overview_picture(view: Overview, figure_format: str = "png") -> bytes:
    """Draw a log: currents and references over time, the current plane, and the speed."""
    figure = Picture(figsize=(9.0, 5.0), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.5, 1.0))
    for row, component in enumerate("dq"):
        axes = figure.add_subplot(grid[row, 0])
        axes.plot(view.time, view.reference_dq[:, row], color="0.6", linewidth=1.2, label="reference")
        axes.plot(view.time, view.i_dq[:, row], linewidth=0.5, label="measured")
        name(axes, f"i_{component}", "Time / s", "Current / A")
        if np.isfinite(view.reference_dq).any() and row == 0:
            axes.legend(fontsize=NORMAL, loc="upper right")
    axes = figure.add_subplot(grid[2, 0])
    axes.plot(view.time, view.speed * 30 / np.pi, linewidth=0.5)
    name(axes, "Electrical speed", "Time / s", "Speed / rpm")
    axes = figure.add_subplot(grid[:, 1])
    axes.plot(view.i_dq[:, 0], view.i_dq[:, 1], ".", markersize=1)
    turn = np.linspace(0, 2 * np.pi, 200)
    i_max, coverage = view.figures["i_max"], view.figures["coverage"]
    axes.plot(i_max * np.cos(turn), i_max * np.sin(turn), color="0.5", linewidth=0.8)
    axes.set_aspect("equal")
    name(axes, f"Disc of {i_max:.4g} A, {100 * coverage:.0f} % visited", "i_d / A", "i_q / A")
    return rendered(figure, figure_format)


def trajectory(samples: Sequence[Samples]) -> FloatArray | None:
    """Return the measured i_dq (N, 2), A, of at most some 30000 samples, with a NaN after each run; None without."""
    return thinned_trajectory(samples, _MOST_POINTS) if samples else None


def add_caption(figure: Figure, caption: Caption) -> None:
    """Write a caption below the panels."""
    height = figure.get_size_inches()[1]
    figure.text(0.5, 0.07 / height, caption.text(), fontsize=NORMAL, ha="center", va="bottom", linespacing=1.4)
