"""Picture of a log before a fit: currents and references over time, the current plane, and the speed."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from drive_id.core.checks.overview import Overview
from drive_id.pictures.panels import NORMAL, name
from drive_id.pictures.plots import rendered


def overview_picture(view: Overview, figure_format: str = "png") -> bytes:
    """Draw an overview as ``png``, ``svg`` or ``pdf``."""
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.5, 1.0))
    for row, component in enumerate("dq"):
        axes = figure.add_subplot(grid[row, 0])
        axes.plot(view.time, view.reference_dq[:, row], color="0.6", linewidth=1.2, label="reference")
        axes.plot(view.time, view.i_dq[:, row], linewidth=0.5, label="measured")
        name(axes, f"i_{component}", "Time / s", "Current / A")
        if np.isfinite(view.reference_dq).any() and row == 0:
            axes.legend(fontsize=NORMAL, loc="upper right")
    axes = figure.add_subplot(grid[2, 0])
    axes.plot(view.time, view.speed_curve * 30 / np.pi, linewidth=0.5)
    name(axes, "Electrical speed", "Time / s", "Speed / rpm")
    axes = figure.add_subplot(grid[:, 1])
    axes.plot(view.i_dq[:, 0], view.i_dq[:, 1], ".", markersize=1)
    turn = np.linspace(0, 2 * np.pi, 200)
    axes.plot(view.i_max * np.cos(turn), view.i_max * np.sin(turn), color="0.5", linewidth=0.8)
    axes.set_aspect("equal")
    name(axes, f"Disc of {view.i_max:.4g} A, {100 * view.coverage:.0f} % visited", "i_d / A", "i_q / A")
    return rendered(figure, figure_format)
