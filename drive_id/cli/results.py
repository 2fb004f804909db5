"""The commands ``drive-id analyze``, ``report``, ``compare`` and ``verify``, on results that are there."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import typer

from drive_id.analysis.settings import AnalysisSettings
from drive_id.cli import console, options
from drive_id.common.quantity import plain
from drive_id.errors import ConfigurationError

_NOT_PASSED = 3
"""Exit code of a verification."""


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
        console.show(figures_table(found.result.machine or directory.name, found))
        for sentence in found.statements:
            console.say(sentence)
        console.warn(*result.warnings)
        console.say(f"Written to {output}")


def report_result(
    directory: options.ResultArgument,
    output: Annotated[
        Path | None,
        options.output(
            "HTML or PDF file; an earlier report is replaced.  \\[default: report.html in the result folder]"
        ),
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also write a PDF of the same name.")] = False,
    pole_pairs: options.PolePairsOption = None,
    u_dc: options.LinkOption = None,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Write a report on a result: one self-contained HTML or PDF file."""
    from drive_id.fitting.result import load
    from drive_id.reporting.page.report import check_report_output, write_report

    output = output or directory / "report.html"
    check_report_output(output, pdf=pdf)
    result = load(directory).given(pole_pairs=pole_pairs, u_dc=u_dc)
    with console.working(quiet or as_json, "Writing the report"):
        written = [str(path) for path in write_report(result, output, pdf=pdf)]
    if as_json:
        console.print_json({"report": written, "warnings": list(result.warnings)})
    elif not quiet:
        console.say(f"Report in {' and '.join(written)}")


def compare_results(
    first: Annotated[Path, typer.Argument(help="Result folder A.", show_default=False, metavar="A")],
    second: Annotated[Path, typer.Argument(help="Result folder B, the reference.", show_default=False, metavar="B")],
    output: Annotated[Path | None, options.output("Picture (.png) of the differences.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Compare two results where both have data: fluxes, resistance, inverter curve, torque."""
    from drive_id.files.results.folder import check_absent, replace_file
    from drive_id.fitting.result import load
    from drive_id.reporting.difference import difference_table, draw_difference
    from drive_id.result.comparison import compare
    from drive_id.result.pictures.picture import rendered

    if output is not None and not force:
        check_absent(output)
    comparison = compare(load(first), load(second))
    if output is not None:
        replace_file(output, rendered(draw_difference(comparison)))
    if as_json:
        tree = {"first": str(first), "second": str(second)} | comparison.tree()
        console.print_json(tree | {"picture": None if output is None else str(output)})
    elif not quiet:
        console.show(difference_table(comparison))
        console.say(comparison.verdict)
        if output is not None:
            console.say(f"Picture in {output}")


def verify_result(
    directory: options.ResultArgument,
    bags: Annotated[list[Path], typer.Option("--bag", help="Recording to judge the map by; may be repeated.")],
    output: Annotated[Path | None, options.output("HTML file of the certificate.")] = None,
    golden: Annotated[
        Path | None,
        typer.Option(
            metavar="LIMITS",
            help="End-of-line test against a golden sample's map: YAML file of limits, no standard errors.",
        ),
    ] = None,
    signals: options.SignalsOption = None,
    namespace: options.NamespaceOption = "",
    settings: options.SetOption = None,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Validate a map by an independent recording, or a machine by a golden map. Exit code 3: not passed."""
    from drive_id.analysis.verification import GOLDEN, VerificationLimits, verify
    from drive_id.files.messages.signals_file import read_signals
    from drive_id.files.read.several import read_recording
    from drive_id.files.results.folder import replace_file
    from drive_id.fitting.result import load
    from drive_id.reporting.page.certificate import certificate, row, verdict
    from drive_id.reporting.page.report import check_report_output
    from drive_id.reporting.tables import verification_table

    if output is not None:
        check_report_output(output)
    base = VerificationLimits() if golden is None else GOLDEN
    limits = options.merged_settings(VerificationLimits, golden, settings, {}, base)
    result = load(directory)
    with console.working(quiet or as_json, "Reading") as tell:
        recording = read_recording(bags, read_signals(signals) if signals else None, namespace=namespace)
        if set(recording.digests.values()) & set(result.provenance.inputs.values()):
            raise ConfigurationError(f"The map in {directory} was fitted to this recording: give another one.")
        tell("Verifying", None)
        found = verify(result, recording.samples)
    judged = found.judged(limits)
    if output is not None:
        names = [f"{Path(file).name} (sha256 {digest[:16]})" for file, digest in recording.digests.items()]
        replace_file(output, certificate(result, found, judged, names).encode(errors="backslashreplace"))
    passed = all(entry.passed is not False for entry in judged)
    if as_json:
        figures = [dataclasses.asdict(entry) for entry in judged]
        tree = {"passed": passed, "figures": figures, "warnings": list(recording.warnings)}
        known = {"resistance": found.resistance, "drop": found.drop, "cells": len(found.i_dq)}
        console.print_json(plain(tree | known))
    elif not quiet:
        console.show(verification_table(map(row, judged)))
        console.warn(*recording.warnings)
        console.say(verdict(judged))
        if output is not None:
            console.say(f"Certificate in {output}")
    if not passed:
        raise typer.Exit(_NOT_PASSED)
