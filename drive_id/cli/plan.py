"""The command ``drive-id plan``."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from drive_id.cli import console, options


def plan_experiment(
    machine: Annotated[str, typer.Option(help="ipm, spm, pmsyrm, a machine file, or a result folder.")] = "",
    i_max: Annotated[float | None, typer.Option(help="Radius of the current disc, A.")] = None,
    pole_pairs: Annotated[int | None, typer.Option(help="Number of pole pairs.")] = None,
    resistance: Annotated[float | None, typer.Option(help="Rough resistance, ohm.")] = None,
    inductance_d: Annotated[float | None, typer.Option(help="Rough d inductance, H.")] = None,
    inductance_q: Annotated[float | None, typer.Option(help="Rough q inductance, H.")] = None,
    magnet_flux: Annotated[float | None, typer.Option(help="Rough magnet flux, Wb.")] = None,
    u_dc: Annotated[float | None, typer.Option(help="DC-link voltage, V.")] = None,
    sample_period: Annotated[float | None, typer.Option(help="Sample period, s.  \\[default: 1e-4]")] = None,
    noise: Annotated[
        float | None, typer.Option(help="RMS current noise, fraction of i_max.  \\[default: 0.001]")
    ] = None,
    speed_min: Annotated[float | None, typer.Option(help="Lowest speed, rpm.  \\[default: 250]")] = None,
    speed_max: Annotated[float | None, typer.Option(help="Highest speed, rpm.  \\[default: 1500]")] = None,
    reverse: Annotated[
        bool | None, typer.Option("--reverse/--one-direction", help="Both directions of rotation.")
    ] = None,
    accuracy: Annotated[float | None, typer.Option(help="Target flux accuracy, percent.  \\[default: 0.05]")] = None,
    duration: Annotated[float | None, typer.Option(help="Duration, s.  \\[default: as the accuracy requires]")] = None,
    duration_max: Annotated[float | None, typer.Option(help="Longest duration, s.  \\[default: 60]")] = None,
    free_shaft: Annotated[
        bool, typer.Option("--free-shaft", help="No load machine: swing the shaft by the machine's own torque.")
    ] = False,
    inertia: Annotated[float | None, typer.Option(help="Rough inertia of a free shaft, kg m².")] = None,
    output: Annotated[Path | None, options.output("ROS parameter file (YAML) to write.")] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with planner settings.")] = None,
    settings: options.SetOption = None,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Propose trajectory, speeds and duration for a target accuracy, from rough machine data."""
    from drive_id.core.planning.free_shaft import plan_free_shaft
    from drive_id.core.planning.planner import plan
    from drive_id.core.planning.settings import PlanSettings
    from drive_id.files.results.plan_file import (
        check_plan_output,
        free_shaft_tree,
        free_shaft_yaml,
        plan_tree,
        plan_yaml,
        write_plan,
    )
    from drive_id.fitting.simulated import rough_settings
    from drive_id.reporting.tables import plan_tables

    given: dict[str, Any] = {
        "i_max": i_max, "pole_pairs": pole_pairs, "resistance": resistance, "inductance_d": inductance_d,
        "inductance_q": inductance_q, "magnet_flux": magnet_flux, "u_dc": u_dc, "sample_period": sample_period,
        "current_noise": noise, "speed_min": speed_min, "speed_max": speed_max, "reverse": reverse,
        "accuracy": accuracy, "duration": duration, "duration_max": duration_max,
    }  # fmt: skip
    chosen = options.merged_settings(
        PlanSettings, config, settings, given, rough_settings(machine) if machine else None
    )
    if output is not None:
        check_plan_output(output)
    if free_shaft:
        shaft = plan_free_shaft(chosen, inertia)
        tree, text, tables = free_shaft_tree(shaft), free_shaft_yaml(shaft, machine), []
        sentences, warnings = shaft.statements(), shaft.warnings()
    else:
        with console.working(quiet or as_json) as tell:
            found = plan(chosen, tell)
        tree, text, tables = plan_tree(found), plan_yaml(found, machine), plan_tables(found)
        sentences, warnings = [found.reason(), *found.statements()], found.warnings()
    if output is not None:
        write_plan(output, text)
    if as_json:
        console.print_json(tree)
    elif not quiet:
        _tell(tables, sentences, warnings, f"Written to {output}" if output is not None else f"\n{text.rstrip()}")


def _tell(tables: Iterable[Any], sentences: Iterable[str], warnings: Iterable[str], end: str) -> None:
    for table in tables:
        console.show(table)
    for sentence in sentences:
        console.say(sentence)
    console.warn(*warnings)
    typer.echo(end)  # a file to be copied: not wrapped
