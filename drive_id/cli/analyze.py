"""The command ``drive-id analyze``."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from drive_id.cli.options import (
    JsonFlag,
    PolePairsOption,
    QuietFlag,
    SetOption,
    merged_settings,
    say,
    show,
    warn,
    working,
)
from drive_id.cli.outputs import beside


def analysis_settings() -> type[Any]:
    """Return the settings of this command."""
    from drive_id.analysis.settings import AnalysisSettings

    return AnalysisSettings


def analyze(
    directory: Annotated[Path, typer.Argument(help="Result folder.", show_default=False, metavar="DIR")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder to write.  \\[default: a new one beside the result: DIR_analysis]"),
    ] = None,
    u_dc: Annotated[
        list[float] | None, typer.Option(help="DC-link voltage, V; may be repeated.  \\[default: that of the result]")
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="Highest mechanical speed of the tables, rpm.  \\[default: 4 x corner speed]")
    ] = None,
    i_max: Annotated[
        float | None, typer.Option(help="Largest current amplitude, A.  \\[default: that of the experiment]")
    ] = None,
    temperature: Annotated[
        float | None, typer.Option(help="Winding temperature, degC.  \\[default: that of the experiment]")
    ] = None,
    magnet_temperature: Annotated[
        float | None, typer.Option(help="Magnet temperature, degC.  \\[default: that of the winding]")
    ] = None,
    bandwidth: Annotated[
        float | None, typer.Option(help="Bandwidth of the current controllers, Hz.  \\[default: 500]")
    ] = None,
    modulation: Annotated[float | None, typer.Option(help="Usable share of u_dc / sqrt(3).  \\[default: 1]")] = None,
    pole_pairs: PolePairsOption = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with settings of the analysis.")] = None,
    settings: SetOption = None,
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")] = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Derive torque, MTPA, MTPV, field weakening, losses and controller gains from a result, with standard errors."""
    from drive_id.analysis.analyze import analyze as run
    from drive_id.analysis.folder import FORMAT, MARKER, analysis_tree
    from drive_id.analysis.settings import AnalysisSettings
    from drive_id.files.results.folder import check_output
    from drive_id.fitting.result import load
    from drive_id.reporting.tables import figures_table

    options: dict[str, Any] = {
        "u_dc": tuple(u_dc) if u_dc else None, "speed": speed, "i_max": i_max, "temperature": temperature,
        "magnet_temperature": magnet_temperature, "bandwidth": bandwidth, "modulation": modulation,
        "pole_pairs": pole_pairs,
    }  # fmt: skip
    chosen = merged_settings(AnalysisSettings, config, settings, options)
    output = output or beside(directory, "_analysis")
    check_output(output, force=force, marker=MARKER, kind=FORMAT)
    result = load(directory)
    with working(quiet or as_json) as tell:
        tell("Analyzing", None)
        found = run(result, chosen)
    found.save(output, force=force)
    if as_json:
        typer.echo(json.dumps(analysis_tree(found), allow_nan=False))
    elif not quiet:
        show(figures_table(found.result.machine or directory.name, found.figures))
        for sentence in found.statements:
            say(sentence)
        for warning in result.warnings:
            warn(warning)
        say(f"Written to {output}")
