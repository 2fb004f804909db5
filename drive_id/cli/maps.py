"""The commands ``drive-id import`` and ``drive-id export``: maps of other tools."""

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli import console, options
from drive_id.common.quantity import counted
from drive_id.errors import ConfigurationError


def import_file(
    file: Annotated[Path, typer.Argument(help="Map: .npz, .mat of SyR-e or Motor-CAD, or .csv.", show_default=False)],
    output: Annotated[
        Path | None,
        options.output("Result folder, like that of fit.  \\[default: a new one beside the file: FILE_map]"),
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
    force: options.ForceFlag = False,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Read a flux map of another tool, check that it is plausible, and write it as a result folder."""
    from drive_id.exchange.imports.conventions import Conventions
    from drive_id.exchange.imports.importing import import_map
    from drive_id.exchange.imports.source import Source
    from drive_id.files.results.folder import check_output
    from drive_id.files.results.identification import results_tree, write_results
    from drive_id.result.pictures.picture import rendered

    scalars = _positive(pole_pairs=pole_pairs, resistance=resistance, i_max=i_max, u_dc=u_dc)
    conventions = Conventions(
        order=order, sign=sign, magnet=magnet, q_axis=q_axis, current=current, flux=flux,
        current_scale=current_scale, flux_scale=flux_scale,
    )  # fmt: skip
    source = Source(
        file, format=format_name, axis=axis, conventions=conventions, machine=machine, columns=_columns(columns),
        psi_q_file=psi_q_file, angle=angle, angle_offset=angle_offset, scalars=scalars,
    )  # fmt: skip
    output = output or options.beside(file, "_map")
    check_output(output, force=force)
    with console.working(quiet or as_json, "Importing"):
        result = import_map(source)
        pictures = {"flux_map.png": rendered(result.plot())}
        write_results(output, result.drive, result.provenance, force=force, pictures=pictures)
    if as_json:
        console.print_json(results_tree(result.drive, result.provenance))
    elif not quiet:
        console.show_result(result)
        console.say(f"Results in {output}")


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
    output: Annotated[Path, options.output("File to write.")],
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
        bool,
        typer.Option("--fill", help="Continue the map to points without data, as c-header and fmu do, instead of NaN."),
    ] = False,
    pole_pairs: options.PolePairsOption = None,
    u_dc: options.LinkOption = None,
    leakage: Annotated[float, typer.Option(help="Stator leakage inductance for plecs, H.")] = 0.0,
    bandwidth: Annotated[
        float, typer.Option(help="Of the current controllers of vesc, odrive and c-header, Hz.")
    ] = 160.0,
    sample_period: Annotated[
        float | None, typer.Option(help="Of the controllers of c-header, s: their delay limits the bandwidth.")
    ] = None,
    phase_margin: Annotated[float, typer.Option(help="Minimum phase margin with that delay, degrees.")] = 60.0,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Write the map of a result in the format of another tool, on a grid of your choice."""
    from drive_id.exchange.exports.axes import equal_steps, listed
    from drive_id.exchange.exports.exporting import export_map
    from drive_id.exchange.exports.formats import export_format
    from drive_id.exchange.exports.options import ExportOptions
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
    wanted = ExportOptions(
        i_d=i_d, i_q=i_q, filled=fill, pole_pairs=pole_pairs, u_dc=u_dc, leakage_inductance=leakage,
        bandwidth=bandwidth, sample_period=sample_period, phase_margin=phase_margin,
    )  # fmt: skip
    with console.working(quiet or as_json, "Exporting"):
        exported = export_map(result, format_name, output, wanted, force=force)
    if as_json:
        tree = {"output": str(output), "format": format_name} | dataclasses.asdict(exported)
        console.print_json(tree | {"warnings": list(exported.warnings)})
    elif not quiet:
        console.warn(*exported.warnings)
        size = f", {counted(exported.points, 'point')}" if exported.points else ""
        console.say(f"{output}: {title}{size}.")
