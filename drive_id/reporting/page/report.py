"""Make the report of a result and write it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from drive_id.errors import ConfigurationError
from drive_id.files.results.folder import check_own, replace_file
from drive_id.reporting.page.charts import charts_of
from drive_id.reporting.page.content import content_of
from drive_id.reporting.page.html import GENERATOR, rendered_page
from drive_id.reporting.page.operation import torque_map
from drive_id.reporting.page.pdf import rendered_pdf
from drive_id.reporting.page.pictures import figures_of
from drive_id.result.pictures.picture import rendered
from drive_id.result.result import Result

_DPI = 110
"""Of the pictures in the page, which only print and browsers without scripts show: it shall stay small."""
_PDF = ".pdf"
_BEGINNING = 2000
"""Bytes of a page that hold its generator."""


def report_files(result: Result, names: Iterable[str] = ("report.html",)) -> dict[str, bytes]:
    """Return the report by file name: as PDF where the name ends so, otherwise as HTML."""
    operation = torque_map(result)
    content, figures = content_of(result, operation), figures_of(result, operation)

    def page() -> bytes:
        pictures = {name: rendered(figure, dpi=_DPI) for name, figure in figures.items()}
        text = rendered_page(content, charts_of(result, operation), pictures)
        return text.encode(errors="backslashreplace")  # names of files may hold any byte

    return {name: rendered_pdf(content, figures) if name.endswith(_PDF) else page() for name in names}


def check_report_output(path: Path, *, pdf: bool = False) -> None:
    """Check, before the work is done, that a report may be written.

    Raises ConfigurationError when the name does not end with .html or .pdf, and OutputError when there is something
    else than an earlier report.
    """
    if path.suffix not in {".html", ".htm", _PDF}:
        raise ConfigurationError(f"The report {path} is neither HTML nor PDF: let its name end with .html or .pdf.")
    for file in _paths(path, pdf=pdf):
        check_own(file, GENERATOR, within=-1 if file.suffix == _PDF else _BEGINNING)


def write_report(result: Result, path: Path, *, pdf: bool = False) -> tuple[Path, ...]:
    """Write the report to a file, and beside it the PDF if wanted, and return the paths; an earlier report is replaced.

    Raises what :func:`check_report_output` does.
    """
    check_report_output(path, pdf=pdf)
    paths = _paths(path, pdf=pdf)
    for file, content in zip(paths, report_files(result, map(str, paths)).values(), strict=True):
        replace_file(file, content)
    return paths


def _paths(path: Path, *, pdf: bool) -> tuple[Path, ...]:
    return (path, path.with_suffix(_PDF)) if pdf and path.suffix != _PDF else (path,)
