"""The command ``drive-id report``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli.options import JsonFlag, QuietFlag, say, working

PdfFlag = Annotated[bool, typer.Option("--pdf", help="Also write a PDF of the same name.")]


def report_result(
    directory: Annotated[
        Path, typer.Argument(help="Result folder of fit or import.", show_default=False, metavar="DIR")
    ],
    output: Annotated[Path, typer.Option(help="HTML file to write; an earlier report is replaced.")],
    pdf: PdfFlag = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Write a report on a result: one HTML file that needs no network and no other files."""
    from drive_id.fitting.result import load
    from drive_id.report.page.report import check_report_output, write_report

    check_report_output(output, pdf=pdf)
    result = load(directory)
    with working(quiet or as_json) as tell:
        tell("Writing the report", None)
        written = [str(path) for path in write_report(result, output, pdf=pdf)]
    if as_json:
        typer.echo(json.dumps({"report": written, "warnings": list(result.warnings)}))
    elif not quiet:
        say(f"Report in {' and '.join(written)}")
