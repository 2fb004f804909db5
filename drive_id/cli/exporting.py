"""The command ``drive-id export``."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli.options import JsonFlag, LinkOption, PolePairsOption, QuietFlag, say, warn, working
from drive_id.errors import ConfigurationError


def export_result(
    directory: Annotated[Path, typer.Argument(help="Result folder.", show_default=False, metavar="DIR")],
    format_name: Annotated[
        str,
        typer.Option(
            "--format",
            help="csv, netcdf, machine, motulator, gradnet-data, syre, syre-model, simscape, simscape-2d, "
            "motor-control, powertrain, powertrain-controller, c-header, fmu, fmu-2, plecs, modelica, vesc or odrive.",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write.")],
    grid: Annotated[int | None, typer.Option(help="Points on each axis.  \\[default: about 41, a round step]")] = None,
    span: Annotated[
        tuple[float, float] | None,
        typer.Option("--range", metavar="LOW HIGH", help="Ends of both axes, A.  \\[default: -i_max i_max]"),
    ] = None,
    axis_d: Annotated[
        str | None, typer.Option(metavar="LIST", help="Axis of i_d, A: -300,-200,0 or FIRST:STEP:LAST.")
    ] = None,
    axis_q: Annotated[str | None, typer.Option(metavar="LIST", help="Axis of i_q, A, likewise.")] = None,
    fill: Annotated[
        bool, typer.Option("--fill", help="Extrapolate the map to points without data instead of marking them as NaN.")
    ] = False,
    pole_pairs: PolePairsOption = None,
    u_dc: LinkOption = None,
    leakage: Annotated[float, typer.Option(help="Stator leakage inductance for plecs, H.")] = 0.0,
    bandwidth: Annotated[
        float, typer.Option(help="Controller bandwidth for vesc, odrive and c-header, rad/s.")
    ] = 1000.0,
    sample_period: Annotated[
        float | None, typer.Option(help="Of the controllers of c-header, s: their delay limits the bandwidth.")
    ] = None,
    phase_margin: Annotated[float, typer.Option(help="Least phase margin with that delay, degrees.")] = 60.0,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Write the map of a result in the format of another tool, on a grid of your choice."""
    from drive_id.exchange.exports.axes import equal_steps, listed
    from drive_id.exchange.exports.exporting import export_map
    from drive_id.exchange.exports.formats import export_format
    from drive_id.exchange.exports.options import ExportOptions
    from drive_id.exchange.exports.table import TableChoice
    from drive_id.fitting.result import load

    title = export_format(format_name).title
    given = [None if text is None else listed(text, name) for text, name in ((axis_d, "axis-d"), (axis_q, "axis-q"))]
    result = load(directory)
    common = None
    if grid is not None or span is not None:
        low, high = span or (-result.i_max, result.i_max)
        common = equal_steps(41 if grid is None else grid, low, high)
        if all(axis is not None for axis in given):
            raise ConfigurationError(
                "--axis-d and --axis-q leave nothing for --grid and --range to choose: drop one pair."
            )
    i_d, i_q = (common if axis is None else axis for axis in given)
    choice = TableChoice(i_d, i_q, fill, pole_pairs, u_dc)
    wanted = ExportOptions(leakage, bandwidth, sample_period, phase_margin)
    with working(quiet or as_json) as tell:
        tell("Exporting", None)
        exported = export_map(result, format_name, output, choice, wanted, force=force)
    if as_json:
        tree = {"output": str(output), "format": format_name} | dataclasses.asdict(exported)
        typer.echo(json.dumps(tree | {"warnings": list(exported.warnings)}))
    elif not quiet:
        for warning in exported.warnings:
            warn(warning)
        size = f", {exported.points} points" if exported.points else ""
        say(f"{output}: {title}{size}.")
