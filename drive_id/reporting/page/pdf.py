"""The report as a PDF, by matplotlib: it needs no browser. The same words, numbers and pictures as on the page."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from drive_id.common.version import VERSION
from drive_id.reporting.page.content import SECTIONS, Content, TextTable
from drive_id.reporting.page.html import GENERATOR

_WIDTH = 8.27  # of a page (A4), inches
_HEIGHT = 11.69  # likewise
_MARGIN = 0.7  # inches
_TEXT = 8.5  # size of text, points
_HEADING = 12.0  # likewise, of headings
_TITLE = 17.0  # of the title
_SMALL = 7.0  # of tables
_CHARACTER = 0.55
"""Mean width of a character over its size."""
_DPI = 180  # of figures, which are drawn as pixels: sharp in print
_WARNING = "#a03000"  # colour of warnings


def rendered_pdf(content: Content, figures: Mapping[str, Figure]) -> bytes:
    """Render the report with figures by the name of their section."""
    sheets = _Sheets()
    sheets.text(content.title, _TITLE, bold=True)
    sheets.text(content.subtitle)
    sheets.heading(SECTIONS["glance"])
    sheets.table(
        TextTable("", ("Quantity", "Value", ""), tuple((q.name, str(q), q.note) for q in content.headline)),
        (0.24, 0.26, 0.5),
    )
    rows = tuple((f.name, f.value, f.level or "–", f.meaning) for f in content.figures)
    sheets.table(TextTable("", ("Figure", "Value", "Level", "Meaning"), rows), (0.24, 0.12, 0.09, 0.55))
    sheets.text(f"What would help most: {content.advice}" if content.advice else "")
    sheets.text("Warnings", bold=True)
    for warning in content.warnings or ("None.",):
        sheets.text(f"• {warning}", colour=_WARNING if content.warnings else "black")
    sheets.heading(SECTIONS["map"], figures.get("map"))
    sheets.picture(figures.get("map"))
    sheets.table(content.values, (0.4, 0.6))
    sheets.heading(SECTIONS["comparison"], figures.get("comparison"))
    sheets.text(content.missing.get("comparison", content.comparison))
    sheets.picture(figures.get("comparison"))
    sheets.table(content.methods, (0.26, 0.16, 0.16, 0.12, 0.14, 0.16))
    for name in ("inverter", "residuals", "currents", "operation"):
        sheets.heading(SECTIONS[name], figures.get(name))
        sheets.text(content.missing.get(name, content.residual if name == "residuals" else ""))
        sheets.picture(figures.get(name))
    sheets.table(content.operation, (0.3, 0.12, 0.12, 0.12, 0.14, 0.2))
    for name in ("losses", "efficiency", "mtpv"):
        sheets.text(content.missing.get(name, ""))
        sheets.picture(figures.get(name))
    sheets.heading(SECTIONS["identifiable"])
    for heading, found in content.knowledge.items():
        sheets.text(f"{heading}:" if found else "", bold=True)
        for sentence in found:
            sheets.text(f"• {sentence}")
    sheets.table(content.calibrations, (0.35, 0.45, 0.2))
    sheets.heading(SECTIONS["method"])
    sheets.text(content.paragraph)
    sheets.heading(SECTIONS["origin"])
    sheets.table(_set(content.settings), (0.35, 0.45, 0.2))
    sheets.table(content.inputs, (0.4, 0.6))
    sheets.table(content.versions, (0.35, 0.65))
    return sheets.saved(content.title)


def _set(settings: TextTable) -> TextTable:
    """Leave the defaults out."""
    return replace(settings, rows=tuple(row for row in settings.rows if row[-1] == "set"))


class _Sheets:
    """Pages that fill from top to bottom."""

    def __init__(self) -> None:
        self._pages: list[Figure] = []
        self._new_page()

    def _new_page(self) -> None:
        page = Figure(figsize=(_WIDTH, _HEIGHT))
        FigureCanvasAgg(page)
        self._pages.append(page)
        self._left = _HEIGHT - _MARGIN  # height above which the page is full

    def _take(self, height: float) -> float:
        """Return the upper edge of a strip of some height, inches, on this page or the next."""
        if self._left - height < _MARGIN:
            self._new_page()
        self._left -= height
        return self._left + height

    def _write(self, x: float, y: float, line: str, size: float, *, bold: bool, colour: str = "black") -> None:
        weight = "bold" if bold else "normal"
        self._pages[-1].text(
            x / _WIDTH, y / _HEIGHT, line, fontsize=size, weight=weight, color=colour, va="top", parse_math=False
        )

    def heading(self, text: str, figure: Figure | None = None) -> None:
        """Write a heading that is not left alone at the foot of a page, and stays with its figure."""
        needed = 1.5 if figure is None else 0.8 + _placed_height(figure)
        if self._left < _MARGIN + needed:
            self._new_page()
        self._left -= 0.12
        self.text(text, _HEADING, bold=True)

    def text(self, text: str, size: float = _TEXT, *, bold: bool = False, colour: str = "black") -> None:
        """Write a paragraph; nothing for an empty one."""
        for line in _wrapped(text, _WIDTH - 2 * _MARGIN, size) if text else ():
            self._write(_MARGIN, self._take(_line(size)), line, size, bold=bold, colour=colour)
        self._left -= 0.05

    def table(self, table: TextTable, shares: Sequence[float]) -> None:
        """Write a table with columns of these shares of the width; nothing for one without rows."""
        if not table.rows:
            return
        if table.caption:
            self.text(table.caption, bold=True)
        width = _WIDTH - 2 * _MARGIN
        starts = _MARGIN + width * np.concatenate([[0.0], np.cumsum(shares)[:-1]])
        for number, row in enumerate((table.header, *table.rows)):
            cells = [_wrapped(cell, width * share, _SMALL) for cell, share in zip(row, shares, strict=True)]
            top = self._take(max(map(len, cells)) * _line(_SMALL) + 0.03)
            for x, lines in zip(starts, cells, strict=True):
                for place, line in enumerate(lines):
                    self._write(x, top - place * _line(_SMALL), line, _SMALL, bold=number == 0)
        self._left -= 0.1

    def picture(self, figure: Figure | None) -> None:
        """Place a figure over the whole width; nothing where there is none."""
        if figure is None:
            return
        canvas = FigureCanvasAgg(figure)
        figure.set_dpi(_DPI)
        canvas.draw()  # type: ignore[no-untyped-call]  # matplotlib is typed in parts
        width, height = _WIDTH - 2 * _MARGIN, _placed_height(figure)
        bottom = self._take(height) - height
        axes = self._pages[-1].add_axes(
            (_MARGIN / _WIDTH, bottom / _HEIGHT, width / _WIDTH, height / _HEIGHT), frameon=False
        )
        axes.set_axis_off()
        drawn = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]  # likewise
        axes.imshow(drawn[..., :3], aspect="auto", interpolation="none")
        self._left -= 0.05

    def saved(self, title: str) -> bytes:
        """Return the file, its pages numbered."""
        stream = io.BytesIO()
        told = {"Title": _printable(title), "Creator": f"{GENERATOR} {VERSION}"}
        with PdfPages(stream, metadata=told) as pdf:
            for number, page in enumerate(self._pages, start=1):
                foot = f"{GENERATOR} {VERSION}, page {number} of {len(self._pages)}"
                page.text(0.5, 0.4 / _HEIGHT, foot, fontsize=_SMALL, ha="center", color="0.4")
                pdf.savefig(page, dpi=_DPI)
        return stream.getvalue()


def _placed_height(figure: Figure) -> float:
    """Return the height of a figure over the whole width of the text, inches."""
    wide, high = figure.get_size_inches()
    return float((_WIDTH - 2 * _MARGIN) * high / wide)


def _line(size: float) -> float:
    """Return the height of a line of text, inches."""
    return 1.35 * size / 72


def _wrapped(text: str, width: float, size: float) -> list[str]:
    """Return the lines of a text in a column, inches wide; at least one."""
    return textwrap.wrap(_printable(text), max(8, int(width * 72 / (_CHARACTER * size)))) or [""]


def _printable(text: str) -> str:
    """Return text without control characters."""
    return "".join(character if character.isprintable() else " " for character in text)
