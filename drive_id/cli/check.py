"""The command ``drive-id check``."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_id.cli.options import JsonFlag, NamespaceOption, QuietFlag, SignalsOption, say, show, warn, working
from drive_id.errors import ConfigurationError, OutputError

if TYPE_CHECKING:
    from drive_id.inspection.inspect import Inspection


def check_log(
    log: Annotated[
        Path,
        typer.Argument(help="Bag, or CSV, Parquet, MATLAB, MDF, TDMS or HDF5 file.", show_default=False, metavar="LOG"),
    ],
    signals: SignalsOption = None,
    draft: Annotated[Path | None, typer.Option(help="Write a proposed signals file (YAML).")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw currents and speed: .png, .svg or .pdf.")] = None,
    namespace: NamespaceOption = "",
    force: Annotated[bool, typer.Option("--force", help="Overwrite the draft and the picture.")] = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Inspect a log before a fit: list its contents, check it, and propose where the signals are."""
    from drive_id.files.messages.signals_file import read_signals
    from drive_id.files.results.folder import replace_file
    from drive_id.inspection.inspect import inspect_log
    from drive_id.reporting.log_tables import inspection_tables

    _refuse(draft, picture, force=force)
    signal_map = read_signals(signals) if signals else None
    with working(quiet or as_json) as tell:
        found = inspect_log(log, signal_map, namespace=namespace, draft=draft is not None, tell=tell)
    if draft is not None and found.draft is not None:
        replace_file(draft, found.draft.text.encode())
    if picture is not None and found.overview is None:
        warn(f"{picture} was not drawn, for there are no joined samples.")
    elif picture is not None and found.overview is not None:
        from drive_id.reporting.log_picture import overview_picture

        replace_file(picture, overview_picture(found.overview, picture.suffix[1:]))
    if as_json:
        typer.echo(json.dumps(found.tree(), allow_nan=False))
    elif not quiet:
        for table in inspection_tables(found):
            show(table)
        _comment(found, asked=draft is not None)
        if draft is not None and found.draft is not None:
            how = f"--signals {draft}" + (" --method static" if found.draft.static else "")
            say(f"Draft in {draft}: look at lines marked NOT SURE or EDIT, then drive-id fit {log} {how}")

    if draft is not None and found.draft is None:
        why = next(str(finding) for finding in found.findings if finding.code == "no_draft")
        raise ConfigurationError(f"{draft} was not written: {why}")


def _refuse(draft: Path | None, picture: Path | None, *, force: bool) -> None:
    """Refuse to overwrite files, and pictures of other formats."""
    formats = (".png", ".svg", ".pdf")
    if picture is not None and picture.suffix not in formats:
        raise OutputError(f"{picture} is no picture that can be drawn: name a file that ends in {', '.join(formats)}.")
    for path in (draft, picture):
        if path is not None and path.exists() and not force:
            raise OutputError(f"{path} exists: name another file, or overwrite it with --force.")


def _comment(found: "Inspection", *, asked: bool) -> None:
    """Print findings and warnings below the tables; ``asked``: a draft is to be written."""
    for finding in found.findings:
        if finding.code == "no_draft" and asked:
            continue  # reported as the error at the end
        say(f"{finding.code}: {finding}", style="red" if finding.kind == "error" else "yellow")
    for warning in found.warnings:
        warn(warning)
    if not found.findings:
        say("Nothing is wrong with it.")
    if found.draft is not None:
        say("The signals are those of a proposed signals file: --draft FILE writes it.")
