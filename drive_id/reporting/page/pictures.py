"""The report's pictures without a script: for print, for the PDF and for browsers that run none."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from drive_id.common.quantity import scaled_unit
from drive_id.core.result.diagnostics import ComparedMethod, Diagnostics
from drive_id.core.validation.simulated_current import SimulatedCurrent
from drive_id.reporting.page.content import map_difference
from drive_id.reporting.page.operation import LossMap, SpeedMap, TorqueMap
from drive_id.result.pictures.diagnostics import COLOUR, LIGHT, draw_inverter, draw_residual
from drive_id.result.pictures.panels import (
    COLOURS,
    CURRENT,
    PSI,
    SMALL,
    Disc,
    add_colour_bar,
    draw_field,
    levels,
    name,
    name_currents,
    place,
)
from drive_id.result.pictures.plots import WIDTH, draw_flux_maps
from drive_id.result.result import Result


def figures_of(result: Result, operation: TorqueMap | None) -> dict[str, Figure]:
    """Return the figures that a result has data for, by the name of their section."""
    judged, drive = result.diagnostics, result.drive
    found = {"map": draw_flux_maps(drive.flux_map, drive.i_max, judged.trajectory if judged else None)}
    if judged is not None:
        others = [other for other in judged.comparisons if other.psi_d is not None]
        if others:
            found["comparison"] = _draw_comparison(result, others[0])
        if np.isfinite(judged.over_time.mean).any():
            found["residuals"] = _draw_residuals(judged, result.i_max)
        if judged.simulated is not None:
            found["currents"] = _draw_currents(judged.simulated)
    if drive.origin.inverter and np.any(drive.inverter_voltage):
        found["inverter"] = Figure(figsize=(WIDTH, 2.9))
        draw_inverter(place(found["inverter"], 0.65, 0.45, 6.3, 2.15), drive)
    if operation is not None:
        for axes in found["map"].axes:
            _draw_lines(axes, operation)
        found["operation"] = _draw_operation(result, operation)
        if operation.losses is not None:
            found["losses"] = _draw_losses(result, operation.losses)
        if operation.speeds is not None:
            found["efficiency"] = _draw_efficiency(operation.speeds)
    return found


def _draw_comparison(result: Result, other: ComparedMethod) -> Figure:
    """Draw the maps of another method minus those of the result."""
    figure = Figure(figsize=(WIDTH, 3.3))
    disc = Disc(result.drive.flux_map, result.i_max)
    scale, unit = scaled_unit(result.flux_map.largest, "Wb")
    for left, component, apart in zip((0.65, 4.17), "dq", map_difference(result, other), strict=True):
        axes = place(figure, left, 0.5, 2.3, 2.4)
        title = f"{PSI[component]}: {other.method} minus {result.method} / {unit}"
        draw_field(axes, disc, scale * apart, title, symmetric=True)
    return figure


def _draw_residuals(judged: Diagnostics, i_max: float) -> Figure:
    plane = judged.over_plane
    low = 0.0 if plane is None else 3.2
    figure = Figure(figsize=(WIDTH, low + 4.6))
    axes, time = place(figure, 0.65, low + 2.8, 6.35, 1.5), judged.over_time
    name(axes, "Residual voltage over time", "time of data / s", "residual / V")
    for number, component in enumerate("dq"):
        for values, width, label in ((time.mean, 1.0, "mean"), (time.rms, 0.5, "rms")):
            axes.plot(
                time.time, values[:, number], color=COLOUR[component], linewidth=width, label=f"{component}: {label}"
            )
    _finished(axes)
    draw_residual(place(figure, 0.65, low + 0.5, 6.35, 1.5), judged.over_angle)
    if plane is None:
        return figure
    ticks = levels(0.0, float(np.nanmax(plane.rms)), 8)
    for left, component, values in zip((0.65, 4.17), "dq", plane.rms.T, strict=True):
        axes = place(figure, left, 0.5, 2.3, 2.3)
        drawn = axes.pcolormesh(plane.i_d, plane.i_q, values, cmap=COLOURS, vmin=0.0, vmax=ticks[-1], shading="nearest")
        axes.add_patch(Circle((0, 0), i_max, fill=False, linewidth=0.8))
        axes.set_aspect("equal")
        name_currents(axes, f"Residual in {component}, rms / V")
        add_colour_bar(axes, drawn, ticks)
    return figure


def _draw_currents(found: SimulatedCurrent) -> Figure:
    figure = Figure(figsize=(WIDTH, 5.2))
    for number, (component, bottom) in enumerate((("d", 3.75), ("q", 2.05))):
        axes = place(figure, 0.65, bottom, 6.35, 1.15)
        name(axes, f"{CURRENT[component]}, the second with the largest deviation", "", "current / A")
        axes.plot(found.time, found.measured[:, number], color="0.45", linewidth=1.6, label="measured")
        axes.plot(found.time, found.simulated[:, number], color=COLOUR[component], linewidth=0.8, label="simulated")
        _finished(axes)
    axes = place(figure, 0.65, 0.45, 6.35, 1.1)
    name(axes, "Deviation over all data that were simulated", "time of data / s", "mean deviation / A")
    for number, component in enumerate("dq"):
        deviation, label = found.deviation[:, number], CURRENT[component]
        axes.plot(found.bin_time, deviation, color=COLOUR[component], linewidth=0.8, label=label)
    _finished(axes)
    return figure


def _draw_operation(result: Result, operation: TorqueMap) -> Figure:
    figure = Figure(figsize=(WIDTH, 3.9))
    axes = place(figure, 2.1, 0.5, 2.9, 3.0)
    draw_field(axes, Disc(result.flux_map.whole, result.i_max), operation.torque, "Torque / Nm", symmetric=True)
    _draw_lines(axes, operation)
    if operation.lines:
        axes.legend(fontsize=SMALL, loc="lower right")
    return figure


def _draw_losses(result: Result, found: LossMap) -> Figure:
    """Draw each loss over the disc."""
    width = WIDTH / len(found.losses)
    size, disc = min(2.3, width - 1.2), Disc(result.flux_map.whole, result.i_max)
    figure = Figure(figsize=(WIDTH, size + 0.9))
    for number, (label, (values, _)) in enumerate(found.losses.items()):
        scale, unit = scaled_unit(float(np.nanmax(values)), "W")
        at = f", {found.speed * 30 / np.pi:.4g} rpm" if label == "iron" else ""
        axes = place(figure, number * width + 0.6, 0.5, size, size)
        draw_field(axes, disc, scale * values, f"{label}{at} / {unit}")
    return figure


def _draw_lines(axes: Axes, operation: TorqueMap) -> None:
    for (label, line), dashes in zip(operation.lines.items(), ("solid", "dashed", "dotted"), strict=False):
        axes.plot(line.i_d, line.i_q, color=LIGHT, linewidth=1.6, linestyle=dashes, label=label, zorder=3)


def _draw_efficiency(speeds: SpeedMap) -> Figure:
    figure = Figure(figsize=(WIDTH, 3.2))
    axes, rpm = place(figure, 0.75, 0.5, 5.6, 2.3), speeds.speed * 30 / np.pi
    name(axes, f"Efficiency / %, {speeds.u_dc:g} V", "speed / rpm", "torque / Nm")
    values = 100 * speeds.efficiency.T
    known = values[np.isfinite(values)]
    steps = np.unique(np.quantile(known, np.linspace(0.05, 1.0, 9))) if known.size else known
    if len(steps) > 1:
        filled = axes.contourf(rpm, speeds.torque, values, levels=steps, cmap=COLOURS, extend="min")
        add_colour_bar(axes, filled, steps, [f"{step:.1f}" for step in steps])
    top = 1.05 * np.nanmax(speeds.largest)
    axes.fill_between(rpm, speeds.largest, top, color=axes.get_facecolor())
    axes.plot(rpm, speeds.largest, color="black", linewidth=1.2, label="largest torque")
    axes.set(xlim=(0, rpm[-1]), ylim=(0, top))
    axes.legend(fontsize=SMALL, loc="upper right")
    return figure


def _finished(axes: Axes) -> None:
    axes.grid(color="0.85", linewidth=0.5)
    axes.margins(x=0.01)
    axes.legend(fontsize=SMALL, loc="upper right", ncols=4, framealpha=0.8)
