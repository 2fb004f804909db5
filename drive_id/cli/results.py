"""The commands ``drive-id report``, ``compare`` and ``verify``, on results that are there."""

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli import console, options
from drive_id.errors import ConfigurationError
from drive_id.quantity import plain

_NOT_PASSED = 3
"""Exit code of a verification."""


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
    """Write a report on a result: one HTML or PDF file that needs no network and no other files."""
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
            help="End of line: the map is of a golden sample; YAML file of limits, no standard errors.",
        ),
    ] = None,
    signals: options.SignalsOption = None,
    namespace: options.NamespaceOption = "",
    settings: options.SetOption = None,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Judge a map by a recording that it was not fitted to, or a machine by a golden map. Exit code 3: not passed."""
    from drive_id.analysis.verification import VerificationLimits, verify
    from drive_id.files.messages.signals_file import read_signals
    from drive_id.files.read.several import read_recording
    from drive_id.files.results.folder import replace_file
    from drive_id.fitting.result import load
    from drive_id.reporting.page.certificate import certificate, row, verdict
    from drive_id.reporting.page.report import check_report_output
    from drive_id.reporting.tables import verification_table

    if output is not None:
        check_report_output(output)
    base = VerificationLimits() if golden is None else VerificationLimits(rms_in_sigma=None, worst_in_sigma=None)
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
