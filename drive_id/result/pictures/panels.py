"""Panels of figures: maps over the current disc, with areas without data hatched, and how they are placed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.colors import ListedColormap
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, PathPatch
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from drive_id.common.quantity import scaled_unit
from drive_id.core.maps.flux_map import FluxMap
from drive_id.types import BoolArray, FloatArray, IntArray

PSI = {"d": r"$\psi_\mathrm{d}$", "q": r"$\psi_\mathrm{q}$"}
CURRENT = {"d": r"$i_\mathrm{d}$", "q": r"$i_\mathrm{q}$"}
COLOURS = ListedColormap(colormaps["cividis"](np.linspace(0.3, 1.0, 256)), "light_cividis")
"""Readable for the colour-blind and in greyscale, and light enough for black lines and labels."""
SMALL = 7.5  # size of ticks and keys, points
NORMAL = 8.5  # size of titles and labels, points
_LABEL = np.array([0.27, 0.12])
"""Width and height to keep free around the label of a level, relative to the disc's radius."""
_FINE = 181
"""Points along each axis of the disc at which maps are drawn."""
_PALE = 0.35
"""Share of white over what samples only enclose."""
_FILL = 1.0  # drawing order in the disc: from the filled contours
_TRAJECTORY = 1.2  # each one above the one before
_LINES = 1.4
_BLANK = 1.6
_BORDER = 1.8  # to its border


class Disc:
    """The current disc of a map, of radius ``i_max``, A, finely sampled, and where in it there are data."""

    def __init__(self, flux_map: FluxMap, i_max: float) -> None:
        self.flux_map, self.i_max = flux_map, i_max
        self.axis = np.linspace(-i_max, i_max, _FINE)
        i_d, i_q = np.meshgrid(self.axis, self.axis, indexing="ij")
        self.radius = np.hypot(i_d, i_q)
        inside = flux_map.known
        self.known: BoolArray = inside & (np.hypot(flux_map.i_d[:, None], flux_map.i_q) <= i_max)
        cell = max(float(np.diff(axis).max()) for axis in (flux_map.i_d, flux_map.i_q))
        # The last cell at the rim counts as the one before it: nodes there stand for half a cell only.
        pulled = np.minimum(1.0, max(i_max - 1.5 * cell, 0.5 * i_max) / np.maximum(self.radius, 1e-9 * i_max))
        i_d, i_q = i_d * pulled, i_q * pulled
        self.support = flux_map.sampled(inside.astype(np.float64), i_d, i_q)
        for x, axis in ((i_d, flux_map.i_d), (i_q, flux_map.i_q)):
            self.support[(x < axis[0]) | (x > axis[-1])] = 0.0  # sampled, it is that at the end of the axis
        self.pale: FloatArray | None = None  # below 0.5 where samples only enclose the current
        if flux_map.enclosed is not None and flux_map.enclosed.any():
            self.pale = flux_map.sampled(flux_map.inside.astype(np.float64), i_d, i_q)
        self.blank: BoolArray = (self.support < 0.5) & (self.radius <= i_max)
        self.depth = _depth(~self.blank & (self.radius <= i_max))

    def field(self, values: FloatArray) -> FloatArray:
        """Return values (D, Q) at the map's nodes on the fine axes."""
        return self.flux_map.sampled(values, *np.meshgrid(self.axis, self.axis, indexing="ij"))

    def spot(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Return the nearest indices on the fine axes to currents (N, 2), A."""
        m, n = (np.rint(np.interp(x, self.axis, np.arange(_FINE))).astype(np.int64) for x in points.T)
        return m, n


def _depth(area: BoolArray) -> IntArray:
    """Return how many cells lie between each point of an area (N, N) and its edge, up to a quarter of the width."""
    left, depth = area.copy(), np.zeros(area.shape, np.int64)
    for _ in range(len(area) // 4):
        inner = np.zeros_like(left)
        inner[1:-1, 1:-1] = left[1:-1, 1:-1] & left[2:, 1:-1] & left[:-2, 1:-1] & left[1:-1, 2:] & left[1:-1, :-2]
        left = inner
        depth += left
    return depth


def continued(values: FloatArray, known: BoolArray) -> FloatArray:
    """Fill unknown nodes by the mean of known ones around them, in four rounds from the data outwards."""
    values, known = np.where(known, values, 0.0), known.copy()
    height, width = values.shape
    for _ in range(4):
        padded, weight = np.pad(values, 1), np.pad(known, 1).astype(np.float64)
        windows = [(slice(a, a + height), slice(b, b + width)) for a in range(3) for b in range(3)]
        total, count = (sum(array[window] for window in windows) for array in (padded, weight))
        new = ~known & (np.asarray(count) > 0)
        values[new] = np.asarray(total)[new] / np.asarray(count)[new]
        known |= new
    return values


def place(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a place in inches, their text small."""
    whole = figure.get_size_inches()
    axes = figure.add_axes((left / whole[0], bottom / whole[1], width / whole[0], height / whole[1]))
    axes.tick_params(labelsize=SMALL, width=0.6, length=2.5)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
    return axes


def name(axes: Axes, title: str, x: str, y: str) -> None:
    """Set title and labels of the axes."""
    axes.set_title(title, fontsize=NORMAL, y=1.0, pad=4)  # a given y saves looking for what it may hit
    axes.set_xlabel(x, fontsize=NORMAL, labelpad=2)
    axes.set_ylabel(y, fontsize=NORMAL, labelpad=2)


def draw_flux(axes: Axes, disc: Disc, component: str, i_dq: FloatArray | None = None) -> None:
    """Draw one flux as filled contours with labelled level lines, and the trajectory (N, 2), A, over them."""
    scale, unit = scaled_unit(disc.flux_map.largest, "Wb")
    frame(axes, disc, f"{PSI[component]} / {unit}")
    if i_dq is not None:
        axes.plot(
            i_dq[:, 0], i_dq[:, 1], color="black", linewidth=0.25, alpha=0.15, zorder=_TRAJECTORY, rasterized=True
        )
    if not disc.known.any():
        return
    psi = scale * (disc.flux_map.psi_d if component == "d" else disc.flux_map.psi_q)
    low, high = float(psi[disc.known].min()), float(psi[disc.known].max())
    steps, lines = levels(low, high, 20), levels(low, high, 11)
    field = disc.field(np.clip(psi, steps[0], steps[-1]))  # without data the map may hold anything
    filled = axes.contourf(disc.axis, disc.axis, field.T, levels=steps, cmap=COLOURS, zorder=_FILL)
    if disc.pale is not None:
        axes.contourf(disc.axis, disc.axis, disc.pale.T, levels=[-1.0, 0.5], colors="white", alpha=_PALE, zorder=_FILL)
    add_colour_bar(axes, filled, lines)
    drawn = lines[(lines > field.min()) & (lines < field.max())]
    if len(drawn):  # without any, matplotlib before 3.11 warns
        contours = axes.contour(
            disc.axis, disc.axis, field.T, levels=drawn, colors="black", linewidths=0.7, linestyles="solid",
            zorder=_LINES,
        )  # fmt: skip
        _label_levels(contours, disc)


def draw_field(axes: Axes, disc: Disc, values: FloatArray, title: str, *, symmetric: bool = False) -> None:
    """Draw any quantity (D, Q) over the disc as filled contours; ``symmetric``: with white at zero."""
    frame(axes, disc, title)
    known = disc.known & np.isfinite(values)
    if not known.any():
        return
    low, high = float(values[known].min()), float(values[known].max())
    if symmetric:
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    steps = levels(low, high, 20)
    if len(steps) < 2 or steps[-1] <= steps[0]:
        return
    field = disc.field(np.clip(continued(values, known), steps[0], steps[-1]))
    filled = axes.contourf(
        disc.axis, disc.axis, field.T, levels=steps, cmap="RdBu_r" if symmetric else COLOURS, zorder=_FILL
    )
    add_colour_bar(axes, filled, levels(low, high, 11))


def name_currents(axes: Axes, title: str) -> None:
    """Set a title, and label the axes as those of the current plane."""
    name(axes, title, f"{CURRENT['d']} / A", f"{CURRENT['q']} / A")


def frame(axes: Axes, disc: Disc, title: str) -> None:
    """Draw the disc's border, blank what lies outside, hatch what has no data, and scale both axes alike."""
    name_currents(axes, title)
    reach = 1.04 * disc.i_max
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    circle = Path.circle((0.0, 0.0), disc.i_max)
    square = 1.1 * disc.i_max * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1], [-1, -1]])
    outside = Path.make_compound_path(Path(square, closed=True), circle)
    axes.add_patch(PathPatch(outside, facecolor="white", edgecolor="none", zorder=_BLANK))
    axes.add_patch(Circle((0.0, 0.0), disc.i_max, fill=False, linewidth=0.8, zorder=_BORDER))
    if not disc.blank.any():
        return
    if disc.support.max() >= 0.5:
        axes.contourf(disc.axis, disc.axis, disc.support.T, levels=[-1.0, 0.5], colors="white", zorder=_BLANK)
        axes.contour(
            disc.axis, disc.axis, np.where(disc.radius <= disc.i_max, disc.support, np.nan).T, levels=[0.5],
            colors="0.35", linewidths=0.5, zorder=_BLANK,
        )  # fmt: skip
    hatch = _hatch(disc)
    axes.plot(hatch[:, 0], hatch[:, 1], color="0.55", linewidth=0.4, zorder=_BLANK)
    spot = _widest(disc)
    if spot is not None:
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        axes.text(*spot, "no data", fontsize=SMALL, ha="center", va="center", bbox=box, zorder=_BORDER)


def _hatch(disc: Disc) -> FloatArray:
    """Return points of diagonal lines in the areas without data, NaN between lines."""
    count = len(disc.axis)
    shift = np.arange(-count + 6, count, 6)[:, None]
    m = np.broadcast_to(np.arange(count), (len(shift), count))
    n = m + shift
    there = (n >= 0) & (n < count)
    there[there] = disc.blank[m[there], n[there]]
    points = np.stack([disc.axis[m], disc.axis[np.clip(n, 0, count - 1)]], axis=-1)
    points[~there] = np.nan
    return np.concatenate([points, np.full((len(shift), 1, 2), np.nan)], axis=1).reshape(-1, 2)


def _widest(disc: Disc) -> tuple[float, float] | None:
    """Return the middle of the widest area without data; None when a label does not fit."""
    depth = _depth(disc.blank)
    m, n = np.unravel_index(int(depth.argmax()), depth.shape)
    return (float(disc.axis[m]), float(disc.axis[n])) if depth[m, n] >= 0.09 * len(disc.axis) else None


def _label_levels(contours: ContourSet, disc: Disc) -> None:
    """Label every level once, away from the other labels and well inside of the data."""
    placed: list[FloatArray] = []
    room = disc.i_max * _LABEL
    for segments in contours.allsegs:
        points = np.concatenate([np.zeros((0, 2)), *segments])
        depth = disc.depth[disc.spot(points)] * (disc.axis[1] - disc.axis[0]) / disc.i_max
        apart = np.array([np.abs((points - other) / room).max(axis=1) for other in placed])
        nearest = apart.min(axis=0, initial=3.0)
        score = np.minimum(depth / 0.12, 1.0) + 0.3 * nearest - 0.2 * np.hypot(*points.T) / disc.i_max
        fits = np.hypot(*(np.abs(points) + room / 2).T) < disc.i_max
        score[(depth < 0.03) | (nearest < 1.0) | ~fits] = -np.inf
        if np.isfinite(score).any():
            placed.append(points[score.argmax()])
    if not placed:
        return
    manual = [tuple(point) for point in placed]
    for text in contours.clabel(manual=manual, fmt=_number, fontsize=SMALL, inline_spacing=1):
        text.set(rotation=0, zorder=_BORDER, path_effects=[withStroke(linewidth=1.2, foreground="white")])


def _number(level: float) -> str:
    return f"{level:g}".replace("-", "\N{MINUS SIGN}")


def levels(low: float, high: float, count: int) -> FloatArray:
    """Return at most ``count`` round steps that enclose a range."""
    return np.asarray(MaxNLocator(count, steps=[1, 2, 5, 10]).tick_values(low, high))


def add_colour_bar(
    axes: Axes, filled: ContourSet | QuadMesh | PathCollection, ticks: FloatArray, labels: Sequence[str] | None = None,
    *, extend: str | None = None,
) -> None:  # fmt: skip
    """Put a colour bar beside axes, as tall as they are, with arrows for what lies beyond the ends to ``extend``."""
    beside = axes.inset_axes((1.04, 0.0, 0.045, 1.0))
    bar = axes.figure.colorbar(filled, cax=beside, ticks=ticks, extend=extend)
    if labels is not None:
        bar.set_ticks(ticks.tolist(), labels=labels)
    bar.outline.set_linewidth(0.6)
    beside.tick_params(labelsize=SMALL, width=0.6, length=2.5)


def add_key(figure: Figure, disc: Disc, i_dq: FloatArray | None, height: float) -> None:
    """Explain the trajectory and the hatching below the panels, at a height in inches."""
    handles: list[Line2D | Patch] = []
    if i_dq is not None:
        handles.append(Line2D([], [], color="black", linewidth=0.5, alpha=0.3, label="measured trajectory"))
    if disc.pale is not None:
        handles.append(Patch(facecolor="0.75", edgecolor="none", label="paler: only enclosed by samples"))
    if disc.blank.any():
        handles.append(Patch(facecolor="white", edgecolor="0.55", hatch="//////", linewidth=0.5, label="no data"))
    if handles:
        where = (0.5, height / figure.get_size_inches()[1])
        figure.legend(handles=handles, loc="center", bbox_to_anchor=where, ncols=3, fontsize=SMALL, frameon=False)
