"""The report as one HTML file that loads nothing: text, style, script, data and plotly itself are in it."""

from __future__ import annotations

import base64
import gzip
import re
from collections.abc import Mapping
from functools import cache
from html import escape
from typing import Any

import jinja2

from drive_id.common.version import VERSION
from drive_id.reporting.page.content import SECTIONS, Content

_SYMBOL = re.compile(r"\b(ψ|i|u|L|T|sigma|σ)_(PM|max|dc|[dq]{1,2})\b")
_NUMBER = re.compile(r"[\d\N{MINUS SIGN}][\S ]{0,23}$")
GENERATOR = "drive_id report"
"""By which an earlier report is known."""


def rendered_page(content: Content, charts: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Render the page with the data of its charts, and PNG by name for print and for browsers without scripts."""
    levels = {figure.level for figure in content.figures}
    return filled(
        "report.html",
        sections=SECTIONS,
        content=content,
        worst=next((level for level in ("weak", "fair", "unknown") if level in levels), "good"),
        charts=charts,
        pictures={name: base64.b64encode(png).decode() for name, png in pictures.items()},
        plotly=_plotly(),
    )


def with_subscripts(text: object) -> str:
    """Return text as markup, the indices of the field's symbols lowered."""
    return _SYMBOL.sub(r"\1<sub>\2</sub>", escape(str(text)))


def whole(cell: str) -> str:
    """Return the text of a cell; that of a number with its unit is not broken between lines."""
    return cell.replace(" ", "\N{NO-BREAK SPACE}") if _NUMBER.match(cell) else cell


def filled(template: str, **values: Any) -> str:
    """Return one of our templates, filled with values and the name of its generator."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("drive_id.reporting.page"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"sub": with_subscripts, "whole": whole}
    return environment.get_template(template).render(generator=f"{GENERATOR} {VERSION}", **values)


@cache
def _plotly() -> str:
    """Return plotly's bundle as base64 of gzip: 2 MB instead of 5."""
    from plotly.offline import get_plotlyjs  # noqa: PLC0415  # only a report needs it

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 9, mtime=0)).decode()
