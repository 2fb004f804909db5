"""The command ``drive-id compare``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli.options import JsonFlag, QuietFlag, say, show


def compare_results(
    first: Annotated[Path, typer.Argument(help="Result folder A.", show_default=False, metavar="A")],
    second: Annotated[Path, typer.Argument(help="Result folder B, the reference.", show_default=False, metavar="B")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Picture (.png) of the differences.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Compare two results where both have data: fluxes, resistance, inverter curve, torque."""
    from drive_id.exchange.comparison import compare
    from drive_id.files.results.folder import check_absent, replace_file
    from drive_id.fitting.result import load
    from drive_id.pictures.plots import rendered
    from drive_id.reporting.difference import difference_table, draw_difference

    if output is not None and not force:
        check_absent(output)
    comparison = compare(load(first), load(second))
    if output is not None:
        replace_file(output, rendered(draw_difference(comparison)))
    if as_json:
        tree = {"first": str(first), "second": str(second)} | comparison.tree()
        typer.echo(json.dumps(tree | {"picture": None if output is None else str(output)}, allow_nan=False))
    elif not quiet:
        show(difference_table(comparison))
        say(comparison.verdict)
        if output is not None:
            say(f"Picture in {output}")
