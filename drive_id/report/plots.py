"""Pictures of a result: flux maps and diagnostics beside its files, each with a caption."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from drive_id.core import frames
from drive_id.core.result.identification import FluxMap, IdentifiedDrive
from drive_id.report.diagnostics import draw_diagnostics, draw_inverter
from drive_id.report.panels import NORMAL, Disc, add_key, draw_flux, place
from drive_id.types import FloatArray, GroundTruth, Samples

FORMATS = ("png", "svg", "pdf")
WIDTH = 7.2
"""Of a figure, inches: the two columns of a journal, or the text of a page."""
_DPI = 200
_LONGEST_NAME = 50
"""Characters of a machine's name in a caption."""
_EARLIEST = 946_684_800 * 10**9
"""1 January 2000, ns: stamps before it are no date."""


@dataclass(frozen=True)
class Caption:
    """What stands below a figure; unknown entries are left out.

    Parameters
    ----------
    machine : str
        Or another name of what was identified.
    method : str
    date : str
        Of the recording.
    resistance, sigma_resistance : float
        Ohm.
    i_max : float
        A.
    speeds : (float, float) or None
        Lowest and highest electrical speed, rad/s.
    pole_pairs : int or None
        With them, the speed is given in rpm.
    """

    machine: str = ""
    method: str = ""
    date: str = ""
    resistance: float = math.nan
    sigma_resistance: float = math.nan
    i_max: float = math.nan
    speeds: tuple[float, float] | None = None
    pole_pairs: int | None = None

    @classmethod
    def of(cls, identification: IdentifiedDrive, samples: Sequence[Samples], machine: str = "") -> Caption:
        """Gather the entries from a result and excerpts of its samples."""
        found = [np.quantile(part.speed, (0.001, 0.999)) for part in samples]
        stamp = int(samples[0].stamp[0]) if samples else 0
        date = datetime.fromtimestamp(stamp // 10**9, timezone.utc)
        return cls(
            machine,
            identification.method,
            f"{date:%Y-%m-%d %H:%M} UTC" if stamp >= _EARLIEST else "",
            identification.resistance,
            identification.sigma_resistance,
            identification.i_max,
            (min(low for low, _ in found), max(high for _, high in found)) if found else None,
        )

    def text(self) -> str:
        """Return two lines, formulas as mathtext: what was identified, and how."""
        what = [_plain(self.machine[:_LONGEST_NAME]), f"method {self.method}" if self.method else "", self.date]
        how = []
        if math.isfinite(self.resistance):
            how.append(rf"$R$ = {_with_error(1e3 * self.resistance, 1e3 * self.sigma_resistance)} m$\Omega$")
        if self.speeds is not None:
            factor, unit = (30 / math.pi / self.pole_pairs, "rpm") if self.pole_pairs else (1.0, "rad/s electrical")
            low, high = (factor * speed for speed in self.speeds)
            narrow = high - low <= 0.02 * max(abs(low), abs(high))
            said = f"{(low + high) / 2:.4g}" if narrow else f"{low:.4g} to {high:.4g}"
            how.append(f"speed {said} {unit}")
        if math.isfinite(self.i_max):
            how.append(rf"$i_\mathrm{{max}}$ = {self.i_max:.4g} A")
        lines = ("  ·  ".join(entry for entry in entries if entry) for entries in (what, how))
        return "\n".join(line for line in lines if line)


def result_pictures(
    identification: IdentifiedDrive,
    samples: Sequence[Samples],
    caption: Caption | str = "",
    *,
    figure_format: str = "png",
) -> dict[str, bytes]:
    """Draw the pictures that stand beside a result's files.

    Parameters
    ----------
    identification : IdentifiedDrive
    samples : sequence of Samples
        Excerpts of the recording: their trajectory is drawn over the maps, their voltage residual over the angle.
    caption : Caption or str
        Or the machine's name, empty when unknown: the other entries then come from the result and the samples.
    figure_format : str
        ``png``, ``svg`` or ``pdf``.

    Returns
    -------
    dict of str to bytes
        File names and contents.
    """
    if isinstance(caption, str):
        caption = Caption.of(identification, samples, caption)
    figures = {
        "flux_map": draw_flux_maps(identification.flux_map, identification.i_max, trajectory(samples), caption),
        "diagnostics": draw_diagnostics(identification, samples),
    }
    add_caption(figures["diagnostics"], caption)
    return {f"{name}.{figure_format}": rendered(figure, figure_format) for name, figure in figures.items()}


def draw_flux_maps(
    flux_map: FluxMap, i_max: float, i_dq: FloatArray | None = None, caption: Caption | str = ""
) -> Figure:
    """Draw psi_d and psi_q side by side over the current disc.

    Parameters
    ----------
    flux_map : FluxMap
    i_max : float
        Radius of the disc, A.
    i_dq : (N, 2) float, optional
        Trajectory to draw over them, A; NaN interrupts it.
    caption : Caption or str
        Below the panels; text is printed as it is.
    """
    figure = Figure(figsize=(WIDTH, 3.75))
    disc = Disc(flux_map, i_max)
    for left, component in zip((0.65, 4.17), "dq", strict=True):
        draw_flux(place(figure, left, 1.05, 2.3, 2.4), disc, component, i_dq)
    add_key(figure, disc, i_dq, height=0.57)
    add_caption(figure, caption)
    return figure


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


def trajectory(samples: Sequence[Samples]) -> FloatArray | None:
    """Return the measured i_dq (N, 2), A, with a NaN after each run; None without samples."""
    pieces = []
    for part in samples:
        i_dq = frames.to_dq(part.i_abc, part.angle)
        for run in part.runs():
            pieces += [i_dq[run], np.full((1, 2), np.nan)]
    return np.concatenate(pieces) if pieces else None


def add_caption(figure: Figure, caption: Caption | str) -> None:
    """Write a caption below the panels."""
    text = caption.text() if isinstance(caption, Caption) else _plain(caption)
    height = figure.get_size_inches()[1]
    figure.text(0.5, 0.07 / height, text, fontsize=NORMAL, ha="center", va="bottom", linespacing=1.4)


def rendered(figure: Figure, figure_format: str = "png", dpi: int = _DPI) -> bytes:
    """Render a figure as ``png``, ``svg`` or ``pdf``."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    lines = rc_context({"hatch.linewidth": 0.4, "svg.hashsalt": "drive_id"})
    with lines, np.errstate(over="ignore", invalid="ignore"):  # matplotlib projects uninitialized corners of surfaces
        figure.savefig(buffer, format=figure_format, dpi=dpi)
    return buffer.getvalue()


def _with_error(value: float, sigma: float) -> str:
    """Return a value to two digits of its standard error, or to four of its own where that is not known."""
    if not (math.isfinite(sigma) and sigma > 0):
        return f"{value:.4g}"
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return rf"{value:.{digits}f} $\pm$ {sigma:.{digits}f}"


def _plain(text: str) -> str:
    """Return text that neither is taken for a formula nor lacks a glyph."""
    printable = "".join(character for character in text if character.isprintable())
    return printable.encode("latin-1", "replace").decode("latin-1").replace("$", r"\$")
