"""Pages as single files that load nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2

from drive_id.common.version import VERSION
from drive_id.files.results.folder import check_own, replace_file
from drive_id.reporting.web.archive import Entry, rows

GENERATOR = "drive_id archive"
"""By which an earlier page is known."""


def archive_page(entries: Sequence[Entry], title: str, *, ticked: int = 0, live: bool = False) -> str:
    """Return the page of an archive, the first ``ticked`` results compared; ``live``: with a link to the live page."""
    return rendered("archive.html", title=title, rows=rows(entries), ticked=ticked, live=live)


def rendered(template: str, **values: Any) -> str:
    """Render a template of this package, which may use the report's style."""
    places = [jinja2.PackageLoader("drive_id.reporting.web"), jinja2.PackageLoader("drive_id.reporting.page")]
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(places), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template(template).render(generator=f"{GENERATOR} {VERSION}", **values)


def check_page_output(path: Path) -> None:
    """Check that a page may be written: only an earlier page of ours is replaced, else an OutputError is raised."""
    check_own(path, GENERATOR, within=500)


def write_page(path: Path, page: str) -> None:
    """Write a page, in place of an earlier one."""
    check_page_output(path)
    replace_file(path, page.encode(errors="backslashreplace"))
