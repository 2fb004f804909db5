"""The figure to judge a result by: standard errors, inverter curve, fluxes along the axes, residual voltage."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drive_id.common.quantity import scaled_unit
from drive_id.core.result.diagnostics import drive_residual
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.validation.residuals import AngleBins, over_angle
from drive_id.result.pictures.panels import (
    COLOURS,
    CURRENT,
    NORMAL,
    PSI,
    SMALL,
    Disc,
    add_colour_bar,
    continued,
    frame,
    name,
    place,
)
from drive_id.result.pictures.picture import Picture
from drive_id.result.pictures.styles import style_of
from drive_id.types import BoolArray, FloatArray, GroundTruth, Samples

DARK = "#00429d"
"""Colour of the d axis, told from :data:`LIGHT` by the colour-blind and in greyscale."""
LIGHT = "#d55e00"
"""Colour of the q axis."""
COLOUR = {"d": DARK, "q": LIGHT}
_DASHES = {"d": "solid", "q": "dashed"}
Section = tuple[FloatArray, FloatArray, FloatArray, BoolArray]
"""Current, A, flux and its standard error, in the figure's unit, and where there are data, (N,) each."""
_Z = 1.96
"""Standard errors on either side of a 95 % band."""


def draw_diagnostics(identification: IdentifiedDrive, samples: Sequence[Samples], style: str = "screen") -> Figure:
    """Draw what a result may be judged by; the residual voltage is that of excerpts of the recording."""
    look = style_of(style)
    figure = Picture(figsize=look.diagnostics_size)
    disc = Disc(identification.flux_map, identification.i_max)
    sigma, inverter, own, cross, residual = (place(figure, *where) for where in look.diagnostics)
    _draw_sigma(sigma, disc)
    draw_inverter(inverter, identification)
    _draw_along_axes(own, cross, disc)
    draw_residual(residual, over_angle(drive_residual(identification, samples)))
    return figure


def draw_inverter(axes: Axes, identification: IdentifiedDrive, truth: GroundTruth | None = None) -> None:
    """Draw the drop of one phase over its current, with its 95 % band where known, and the truth of a simulation."""
    current, voltage = identification.inverter_current, identification.inverter_voltage
    name(axes, "Inverter voltage drop of one phase", "phase current / A", "drop / V")
    axes.set_xlim(current[0], current[-1])
    _grid(axes)
    if not identification.origin.inverter:
        axes.set_yticks([])
        _say(axes, textwrap.fill(identification.origin.no_inverter, 40))
        return
    if (sigma := identification.sigma_drop) is not None:
        label = f"±1.96 σ ≤ {_Z * sigma.max():.2g} V"
        axes.fill_between(
            current, voltage - _Z * sigma, voltage + _Z * sigma, color=DARK, alpha=0.3, linewidth=0, label=label
        )
    axes.plot(current, voltage, color=DARK, linewidth=1.2, label="identified")
    if identification.phase_voltages is not None:
        for phase, dashes in zip(range(3), ((4, 1), (2, 1), (1, 1)), strict=True):
            axes.plot(
                current, identification.phase_voltages[:, phase], color="0.3", linewidth=0.7, linestyle=(0, dashes),
                label=f"phase {'abc'[phase]}",
            )  # fmt: skip
    if truth is not None:
        axes.plot(
            truth.inverter_current, truth.inverter_voltage, color="black", linewidth=0.8, linestyle=":", label="true"
        )
    axes.legend(
        fontsize=SMALL, loc="lower right", frameon=False, handlelength=1.0, handletextpad=0.4, borderaxespad=0.2
    )


def _draw_sigma(axes: Axes, disc: Disc) -> None:
    """Draw the larger of the standard errors of both fluxes, in steps of 1, 2, 5."""
    scale, unit = scaled_unit(disc.flux_map.largest, "Wb")
    frame(axes, disc, f"σ of {PSI['d']} or {PSI['q']}, the larger / {unit}")
    sigma = scale * np.maximum(disc.flux_map.sigma_d, disc.flux_map.sigma_q)
    known = disc.known & np.isfinite(sigma) & (sigma > 0)
    if not known.any():
        if disc.known.any():
            _say(axes, "σ unknown:\nthe recording is too short")
        return
    low, high = np.log10(np.quantile(sigma[known], (0.01, 0.99)))
    decades = 10.0 ** np.arange(np.floor(low), np.ceil(high) + 1)
    steps = (decades[:, None] * [1, 2, 5]).ravel()
    first, last = np.searchsorted(steps, 10.0**low, side="right") - 1, np.searchsorted(steps, 10.0**high)
    chosen = steps[max(first, 0) : max(last, first + 1) + 1]
    field = disc.field(continued(np.log10(np.where(known, sigma, 1.0)), known))
    filled = axes.contourf(
        disc.axis, disc.axis, field.T, levels=np.log10(chosen), cmap=COLOURS, extend="both", zorder=1.0
    )
    add_colour_bar(axes, filled, np.log10(chosen), [f"{step:.3g}" for step in chosen])


def _draw_along_axes(own: Axes, cross: Axes, disc: Disc) -> None:
    """Draw each flux over its own current and over the other one, with 95 % bands."""
    _, unit = scaled_unit(disc.flux_map.largest, "Wb")
    name(own, "Fluxes along the axes", "current / A", f"flux / {unit}")
    name(cross, "Cross saturation", "current / A", f"change of flux / {unit}")
    for component, other in ("dq", "qd"):
        _draw_section(own, _section(disc, component, other), component, f"{PSI[component]} over {CURRENT[component]}")
        current, psi, sigma, known = _section(disc, component, component)
        if known.any():
            psi = psi - psi[np.argmin(np.where(known, np.abs(current), np.inf))]
        _draw_section(cross, (current, psi, sigma, known), component, f"{PSI[component]} over {CURRENT[other]}")
    for axes in (own, cross):
        axes.set_xlim(-disc.i_max, disc.i_max)
        _grid(axes)
        if axes.lines:
            if not disc.known[np.hypot(disc.flux_map.i_d[:, None], disc.flux_map.i_q) <= disc.i_max].all():
                axes.plot([], [], linewidth=0.6, color="black", linestyle=":", label="no data")
            axes.legend(fontsize=SMALL, loc="best", frameon=False)
        else:
            _say(axes, "no data on the axes")


def _section(disc: Disc, component: str, zero: str) -> Section:
    """Cut through the map where the current ``zero`` is zero."""
    flux_map, axis = disc.flux_map, "dq".index(zero)
    currents = (flux_map.i_d, flux_map.i_q)
    over, across = currents[1 - axis], currents[axis]
    at = float(np.interp(0.0, across, np.arange(len(across))))
    first = min(int(at), len(across) - 2)
    share = at - first

    def cut(values: FloatArray | BoolArray) -> tuple[FloatArray, FloatArray]:
        return np.take(values, first, axis=axis), np.take(values, first + 1, axis=axis)

    scale, _ = scaled_unit(flux_map.largest, "Wb")
    psi, sigma = (
        scale * ((1 - share) * low + share * high)
        for low, high in (cut(getattr(flux_map, f"{quantity}_{component}")) for quantity in ("psi", "sigma"))
    )
    known = np.logical_and(*cut(disc.known)) & (across[0] <= 0.0 <= across[-1])
    return over, psi, sigma, known


def _draw_section(axes: Axes, section: Section, component: str, label: str) -> None:
    """Draw a flux with its band where there are data, and its continuation dotted."""
    current, psi, sigma, known = section
    if not (known[1:] & known[:-1]).any():
        return
    line = np.where(known, psi, np.nan)
    axes.plot(current, line, linewidth=1.1, label=label, color=COLOUR[component], linestyle=_DASHES[component])
    axes.plot(current, psi, linewidth=0.6, color=COLOUR[component], linestyle=":", scalex=False, scaley=False)
    if np.isfinite(sigma[known]).any():
        band = _Z * np.where(np.isfinite(sigma), sigma, np.nan)
        axes.fill_between(current, line - band, line + band, color=COLOUR[component], alpha=0.25, linewidth=0)


def draw_residual(axes: Axes, bins: AngleBins) -> None:
    """Draw mean and rms of the voltage that the model leaves, over the electrical angle."""
    name(axes, "Residual voltage over the rotor position", "electrical angle / °", "residual / V")
    axes.set(xlim=(0, 360), xticks=range(0, 361, 60))
    _grid(axes)
    if not np.isfinite(bins.mean).any():
        _say(axes, "no samples")
        return
    degrees = np.rad2deg(bins.angle)
    for number, component in enumerate("dq"):
        colour, dashes = COLOUR[component], _DASHES[component]
        for values, width, alpha, label in ((bins.mean, 1.1, 1.0, "mean"), (bins.rms, 0.6, 0.8, "rms")):
            axes.plot(
                degrees, values[:, number], linewidth=width, alpha=alpha, label=f"{component}: {label}", color=colour,
                linestyle=dashes,
            )  # fmt: skip
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.3 * (high - low))
    axes.legend(
        fontsize=SMALL,
        loc="upper right",
        frameon=False,
        ncols=4,
        handlelength=1.4,
        handletextpad=0.4,
        columnspacing=0.8,
    )


def _grid(axes: Axes) -> None:
    axes.grid(color="0.85", linewidth=0.5)
    axes.set_axisbelow(True)


def _say(axes: Axes, sentence: str) -> None:
    axes.text(0.5, 0.5, sentence, transform=axes.transAxes, fontsize=NORMAL, ha="center", va="center", zorder=3)
