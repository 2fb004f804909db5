"""The command ``drive-id analyze``."""

from pathlib import Path
from typing import Annotated, Any

import typer

from drive_id.analysis.settings import AnalysisSettings
from drive_id.cli import console, options


def analyze(
    directory: Annotated[Path, typer.Argument(help="Result folder.", show_default=False, metavar="DIR")],
    output: Annotated[
        Path | None, options.output("Folder to write.  \\[default: a new one beside the result: DIR_analysis]")
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
    pole_pairs: options.PolePairsOption = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with settings of the analysis.")] = None,
    settings: options.SetOption = None,
    force: options.ForceFlag = False,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Derive torque, MTPA, MTPV, field weakening, losses and controller gains from a result, with standard errors."""
    from drive_id.analysis.analyze import analyze as run
    from drive_id.analysis.folder import FORMAT, MARKER, analysis_tree
    from drive_id.files.results.folder import check_output
    from drive_id.fitting.result import load
    from drive_id.reporting.tables import figures_table

    given: dict[str, Any] = {
        "u_dc": tuple(u_dc) if u_dc else None, "speed": speed, "i_max": i_max, "temperature": temperature,
        "magnet_temperature": magnet_temperature, "bandwidth": bandwidth, "modulation": modulation,
        "pole_pairs": pole_pairs,
    }  # fmt: skip
    chosen = options.merged_settings(AnalysisSettings, config, settings, given)
    output = output or options.beside(directory, "_analysis")
    check_output(output, force=force, marker=MARKER, kind=FORMAT)
    result = load(directory)
    with console.working(quiet or as_json, "Analyzing"):
        found = run(result, chosen)
    found.save(output, force=force)
    if as_json:
        console.print_json(analysis_tree(found))
    elif not quiet:
        console.show(figures_table(found.result.machine or directory.name, found.figures))
        for sentence in found.statements:
            console.say(sentence)
        console.warn(*result.warnings)
        console.say(f"Written to {output}")
