"""The difference of two results as a picture and as a table."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table

from drive_id.common.quantity import scaled_unit
from drive_id.reporting.tables import plain_table
from drive_id.result.comparison import Comparison
from drive_id.result.pictures.panels import PSI, SMALL, add_colour_bar, levels, name_currents, place
from drive_id.result.result import Result
from drive_id.types import FloatArray


def draw_difference(comparison: Comparison) -> Figure:
    """Draw the differences of both fluxes over the current plane and, below, in units of the joint standard error.

    The lower row is left out when no standard errors are known.
    """
    scale, unit = scaled_unit(comparison.first.flux_map.largest, "Wb")
    rows = [(scale * comparison.difference, unit)]
    if np.isfinite(comparison.in_sigma).any():
        rows.append((comparison.in_sigma, "joint standard errors"))
    height = 0.45 + 3.35 * len(rows)
    figure = Figure(figsize=(8.6, height))
    for row, (values, unit) in enumerate(rows):
        for column, component in enumerate("dq"):
            bottom = height - 3.35 * (row + 1) + 0.35
            panel = place(figure, 0.75 + 4.2 * column, bottom, 2.6, 2.6)
            _draw(panel, comparison, values[..., column], f"A - B of {PSI[component]} in {unit}")
            if row == 0:
                i_d, i_q, _ = comparison.worst()
                panel.plot([i_d], [i_q], "kx", markersize=7)
    tree = comparison.tree()
    text = (
        f"A: {_name(comparison.first)}, B: {_name(comparison.second)}; NRMSE "
        f"{100 * tree['nrmse_d']:.3g} % (d), {100 * tree['nrmse_q']:.3g} % (q); cross: largest difference"
    )
    figure.text(0.5, 0.12 / height, text, ha="center", fontsize=SMALL)
    return figure


def _draw(panel: Axes, comparison: Comparison, values: FloatArray, title: str) -> None:
    limit = float(np.nanmax(np.abs(values), initial=0.0)) or 1e-9
    filled = panel.pcolormesh(
        comparison.i_d, comparison.i_q, values.T, cmap="RdBu_r", vmin=-limit, vmax=limit, shading="nearest"
    )
    name_currents(panel, title)
    ticks = levels(-limit, limit, 8)
    add_colour_bar(panel, filled, ticks[np.abs(ticks) <= limit])


def _name(result: Result) -> str:
    return f"{result.machine or 'unknown machine'} ({result.method})"


def difference_table(comparison: Comparison) -> Table:
    """Lay out the figures of a comparison."""
    (name, *numbers), *rows = comparison.rows()
    table = plain_table(comparison.title, [name], numbers)
    for row in rows:
        table.add_row(*row)
    return table
