"""The command ``drive-id import``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli.options import JsonFlag, QuietFlag, say, show_result, working
from drive_id.cli.outputs import beside
from drive_id.errors import ConfigurationError


def import_file(
    file: Annotated[Path, typer.Argument(help="Map: .npz, .mat of SyR-e or Motor-CAD, or .csv.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Result folder, like that of fit.  \\[default: a new one beside the file: FILE_map]"
        ),
    ] = None,
    format_name: Annotated[
        str | None, typer.Option("--format", help="npz, syre, syre-flux, motor-cad or csv.  \\[default: by the file]")
    ] = None,
    axis: Annotated[
        str | None,
        typer.Option(help="d axis: pm (magnet) or sr (largest permeance).  \\[default: as the file says, or pm]"),
    ] = None,
    order: Annotated[str, typer.Option(help="dq or qd: order of the arrays' indices, or of the columns.")] = "dq",
    sign: Annotated[str, typer.Option(help="motor or generator: sign convention of currents and torque.")] = "motor",
    magnet: Annotated[str, typer.Option(help="plus or minus: side of its axis on which the magnet lies.")] = "plus",
    q_axis: Annotated[str, typer.Option(help="leads or lags: q is 90 degrees ahead of or behind d.")] = "leads",
    current: Annotated[str, typer.Option(help="peak, rms, or power (power-invariant): scaling of currents.")] = "peak",
    flux: Annotated[str, typer.Option(help="peak, rms, or power (power-invariant): scaling of fluxes.")] = "peak",
    current_scale: Annotated[float, typer.Option(help="Factor from the file's unit to ampere.")] = 1.0,
    flux_scale: Annotated[float, typer.Option(help="Factor from the file's unit to weber.")] = 1.0,
    columns: Annotated[
        str | None,
        typer.Option(metavar="NAME=COLUMN,...", help="Columns of a text file: i_d=Id,i_q=Iq,psi_d=3,psi_q=4."),
    ] = None,
    psi_q_file: Annotated[
        Path | None, typer.Option(help="Text file with the matrix of psi_q; FILE then holds that of psi_d.")
    ] = None,
    angle: Annotated[str, typer.Option(help="electrical or mechanical: angle of the rotor positions.")] = "electrical",
    angle_offset: Annotated[
        float, typer.Option(help="Electrical angle from phase a to d at the file's position 0, degrees.")
    ] = 0.0,
    pole_pairs: Annotated[int | None, typer.Option(help="Number of pole pairs.", min=1)] = None,
    resistance: Annotated[float | None, typer.Option(help="Stator resistance, ohm.")] = None,
    i_max: Annotated[
        float | None, typer.Option(help="Radius of the current disc, A.  \\[default: that of the map]")
    ] = None,
    u_dc: Annotated[float | None, typer.Option(help="DC-link voltage, V.")] = None,
    machine: Annotated[str, typer.Option(help="Name of the machine.  \\[default: that of the file]")] = "",
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")] = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Read a flux map of another tool, check that it is plausible, and write it as a result folder."""
    from drive_id.exchange.imports.conventions import Conventions
    from drive_id.exchange.imports.importing import ImportOptions, import_map
    from drive_id.exchange.imports.source import Source
    from drive_id.files.results.folder import check_output
    from drive_id.files.results.identification import results_tree, write_results
    from drive_id.pictures.plots import rendered

    scalars = _positive(pole_pairs=pole_pairs, resistance=resistance, i_max=i_max, u_dc=u_dc)
    source = Source(
        file, columns=_columns(columns), psi_q_file=psi_q_file, angle=angle, angle_offset=angle_offset, scalars=scalars
    )
    conventions = Conventions(
        order=order, sign=sign, magnet=magnet, q_axis=q_axis, current=current, flux=flux,
        current_scale=current_scale, flux_scale=flux_scale,
    )  # fmt: skip
    output = output or beside(file, "_map")
    check_output(output, force=force)
    with working(quiet or as_json) as tell:
        tell("Importing", None)
        result = import_map(source, ImportOptions(format_name, axis, conventions, machine))
        pictures = {"flux_map.png": rendered(result.plot())}
        write_results(output, result.drive, result.provenance, force=force, pictures=pictures)
    if as_json:
        typer.echo(json.dumps(results_tree(result.drive, result.provenance), allow_nan=False))
    elif not quiet:
        show_result(result)
        say(f"Results in {output}")


def _positive(**given: float | None) -> dict[str, float]:
    """Return the numbers that are given; refuse what is not positive."""
    scalars = {name: float(value) for name, value in given.items() if value is not None}
    for name, value in scalars.items():
        if not 0 < value < float("inf"):
            raise ConfigurationError(f"--{name.replace('_', '-')} is {value}: it must be positive.")
    return scalars


def _columns(text: str | None) -> dict[str, str]:
    pairs = [entry.partition("=") for entry in (text or "").split(",") if entry.strip()]
    for name, sign, column in pairs:
        if not (name.strip() and sign and column.strip()):
            raise ConfigurationError(
                f"--columns {text} is not of the form i_d=Id,i_q=Iq,psi_d=Fd,psi_q=Fq: write it so."
            )
    return {name.strip(): column.strip() for name, _, column in pairs}
