"""The command ``drive-id verify``."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli.options import (
    JsonFlag,
    NamespaceOption,
    QuietFlag,
    SetOption,
    SignalsOption,
    merged_settings,
    say,
    show,
    warn,
    working,
)
from drive_id.errors import ConfigurationError
from drive_id.quantity import plain

_NOT_PASSED = 3
"""Exit code."""


def verify_result(
    directory: Annotated[
        Path, typer.Argument(help="Result folder of fit or import.", show_default=False, metavar="DIR")
    ],
    bags: Annotated[list[Path], typer.Option("--bag", help="Recording to judge the map by; may be repeated.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="HTML file of the certificate.")] = None,
    golden: Annotated[
        Path | None,
        typer.Option(
            metavar="LIMITS",
            help="End of line: the map is of a golden sample; YAML file of limits, no standard errors.",
        ),
    ] = None,
    signals: SignalsOption = None,
    namespace: NamespaceOption = "",
    settings: SetOption = None,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
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
    limits = merged_settings(VerificationLimits, golden, settings, {}, base)
    result = load(directory)
    with working(quiet or as_json) as tell:
        tell("Reading", None)
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
        typer.echo(json.dumps(plain(tree | known), allow_nan=False))
    elif not quiet:
        show(verification_table(map(row, judged)))
        for warning in recording.warnings:
            warn(warning)
        say(verdict(judged))
        if output is not None:
            say(f"Certificate in {output}")
    if not passed:
        raise typer.Exit(_NOT_PASSED)
