"""Figures that notebooks show and journals take, and their files."""

from __future__ import annotations

import io
import shutil
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from drive_id.errors import ConfigurationError

_TEX = ("xelatex", "lualatex")
"""Programs that measure text for PGF; pdflatex does not know Ω and ±."""
_DPI = 200
"""Of a picture in a file, for print."""
SCREEN_DPI = 100
"""Of a picture in a notebook."""


class Picture(Figure):
    """A figure that a notebook shows, without pyplot and whatever its backend."""

    def savefig(self, *arguments: Any, **options: Any) -> None:
        """Save the figure as matplotlib does, with fonts of type 42: journals refuse type 3, its own choice."""
        with rc_context({"pdf.fonttype": 42, "ps.fonttype": 42}):
            super().savefig(*arguments, **options)

    def _repr_png_(self) -> bytes:
        return rendered(self, dpi=SCREEN_DPI)


def rendered(figure: Figure, figure_format: str = "png", dpi: int = _DPI) -> bytes:
    """Render a figure as ``png``, ``svg``, ``pdf`` or ``pgf``; raises ConfigurationError for PGF without TeX."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    settings: dict[Any, Any] = {"hatch.linewidth": 0.4, "svg.hashsalt": "drive_id"}
    if figure_format == "pgf":
        found = next(filter(shutil.which, _TEX), None)
        if found is None:
            raise ConfigurationError(f"The text of PGF is measured by TeX: install {' or '.join(_TEX)}, or choose pdf.")
        settings |= {"pgf.texsystem": found, "pgf.rcfonts": False}
    lines = rc_context(settings)
    with lines, np.errstate(over="ignore", invalid="ignore"):  # matplotlib projects uninitialized corners of surfaces
        if figure_format == "png":
            figure.savefig(buffer, format="png", dpi=dpi, pil_kwargs={"compress_level": 3})  # 40 % faster than 6
        else:
            figure.savefig(buffer, format=figure_format, dpi=dpi)
    return buffer.getvalue()
