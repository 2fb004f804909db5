"""The command ``drive-id report``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli.options import JsonFlag, LinkOption, PolePairsOption, QuietFlag, say, working

PdfFlag = Annotated[bool, typer.Option("--pdf", help="Also write a PDF of the same name.")]


def report_result(
    directory: Annotated[
        Path, typer.Argument(help="Result folder of fit or import.", show_default=False, metavar="DIR")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="HTML or PDF file; an earlier report is replaced.  \\[default: report.html in the result folder]",
        ),
    ] = None,
    pdf: PdfFlag = False,
    pole_pairs: PolePairsOption = None,
    u_dc: LinkOption = None,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Write a report on a result: one HTML or PDF file that needs no network and no other files."""
    from drive_id.fitting.result import load
    from drive_id.reporting.page.report import check_report_output, write_report

    output = output or directory / "report.html"
    check_report_output(output, pdf=pdf)
    result = load(directory).given(pole_pairs=pole_pairs, u_dc=u_dc)
    with working(quiet or as_json) as tell:
        tell("Writing the report", None)
        written = [str(path) for path in write_report(result, output, pdf=pdf)]
    if as_json:
        typer.echo(json.dumps({"report": written, "warnings": list(result.warnings)}))
    elif not quiet:
        say(f"Report in {' and '.join(written)}")
