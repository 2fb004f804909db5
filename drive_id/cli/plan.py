"""The command ``drive-id plan``, which has many options."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from drive_id.cli.options import (
    JsonFlag,
    QuietFlag,
    RadiusOption,
    SetOption,
    merged_settings,
    say,
    show,
    warn,
    working,
)


def plan_experiment(
    machine: Annotated[str, typer.Option(help="ipm, spm, pmsyrm, or a machine file, to take all data from.")] = "",
    i_max: RadiusOption = None,
    pole_pairs: Annotated[int | None, typer.Option(help="Of the machine.")] = None,
    resistance: Annotated[float | None, typer.Option(help="Rough, ohm.")] = None,
    inductance_d: Annotated[float | None, typer.Option(help="Rough, H.")] = None,
    inductance_q: Annotated[float | None, typer.Option(help="Rough, H.")] = None,
    magnet_flux: Annotated[float | None, typer.Option(help="Rough, Wb.")] = None,
    u_dc: Annotated[float | None, typer.Option(help="DC link, V.")] = None,
    sample_period: Annotated[float | None, typer.Option(help="s.  \\[default: 1e-4]")] = None,
    noise: Annotated[float | None, typer.Option(help="Current noise, fraction of i_max.  \\[default: 0.001]")] = None,
    speed_min: Annotated[float | None, typer.Option(help="Lowest, rpm.  \\[default: 250]")] = None,
    speed_max: Annotated[float | None, typer.Option(help="Highest, rpm.  \\[default: 1500]")] = None,
    reverse: Annotated[bool | None, typer.Option("--reverse/--one-direction", help="Turn backwards, too.")] = None,
    accuracy: Annotated[float | None, typer.Option(help="Of the flux, percent.  \\[default: 0.05]")] = None,
    duration: Annotated[float | None, typer.Option(help="s.  \\[default: what the accuracy needs]")] = None,
    duration_max: Annotated[float | None, typer.Option(help="s.  \\[default: 60]")] = None,
    output: Annotated[Path | None, typer.Option(help="File of ROS parameters to write (YAML).")] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with settings of the plan.")] = None,
    settings: SetOption = None,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Propose trajectory, speeds and duration for a wanted accuracy, from rough data of the machine."""
    from drive_id.core.planning.planner import plan
    from drive_id.core.planning.settings import PlanSettings
    from drive_id.files.results.plan_file import check_plan_output, plan_tree, plan_yaml, write_plan
    from drive_id.fitting.simulated import rough_settings
    from drive_id.report.tables import plan_tables

    options: dict[str, Any] = {
        "i_max": i_max, "pole_pairs": pole_pairs, "resistance": resistance, "inductance_d": inductance_d,
        "inductance_q": inductance_q, "magnet_flux": magnet_flux, "u_dc": u_dc, "sample_period": sample_period,
        "current_noise": noise, "speed_min": speed_min, "speed_max": speed_max, "reverse": reverse,
        "accuracy": accuracy, "duration": duration, "duration_max": duration_max,
    }  # fmt: skip
    chosen = merged_settings(PlanSettings, config, settings, options, rough_settings(machine) if machine else None)
    if output is not None:
        check_plan_output(output)
    with working(quiet or as_json) as tell:
        found = plan(chosen, tell)
    text = plan_yaml(found, machine)
    if output is not None:
        write_plan(output, text)
    if as_json:
        typer.echo(json.dumps(plan_tree(found), allow_nan=False))
    elif not quiet:
        for table in plan_tables(found):
            show(table)
        for sentence in (found.reason(), *found.statements()):
            say(sentence)
        for warning in found.warnings():
            warn(warning)
        shown = f"Written to {output}" if output is not None else "\n" + text.rstrip()
        say(shown)
