"""The commands ``drive-id check`` and ``drive-id convert``, on a log before a fit."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_id.cli import console, options
from drive_id.common.quantity import counted
from drive_id.errors import ConfigurationError, OutputError

if TYPE_CHECKING:
    from drive_id.inspection.inspect import Inspection


def check_log(
    log: options.LogArgument,
    signals: options.SignalsOption = None,
    draft: Annotated[Path | None, typer.Option(help="Write a proposed signals file (YAML).")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw currents and speed: .png, .svg or .pdf.")] = None,
    namespace: options.NamespaceOption = "",
    force: Annotated[bool, typer.Option("--force", help="Overwrite the draft and the picture.")] = False,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Inspect a log before a fit: list its contents, check it, and draft a signals file."""
    from drive_id.files.results.folder import replace_file
    from drive_id.inspection.inspect import check
    from drive_id.reporting.log_tables import inspection_tables

    _refuse(draft, picture, force=force)
    with console.working(quiet or as_json) as tell:
        found = check(log, signals=signals, namespace=namespace, draft=draft is not None, tell=tell)
    if draft is not None and found.draft is not None:
        replace_file(draft, found.draft.text.encode())
    if picture is not None and found.overview is None:
        console.warn(f"{picture} was not drawn, for there are no joined samples.")
    elif picture is not None and found.overview is not None:
        from drive_id.result.pictures.plots import overview_picture

        replace_file(picture, overview_picture(found.overview, picture.suffix[1:]))
    if as_json:
        console.print_json(found.tree())
    elif not quiet:
        for table in inspection_tables(found):
            console.show(table)
        _comment(found, asked=draft is not None)
        if draft is not None and found.draft is not None:
            how = f"--signals {draft}" + (" --method static" if found.draft.static else "")
            console.say(f"Draft in {draft}: look at lines marked NOT SURE or EDIT, then drive-id fit {log} {how}")
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
        console.say(f"{finding.code}: {finding}", style="red" if finding.kind == "error" else "yellow")
    console.warn(*found.warnings)
    if not found.findings:
        console.say("No problems found.")
    if found.draft is not None:
        console.say("The signals are those of a proposed signals file: --draft FILE writes it.")


def convert_log(
    log: options.LogArgument,
    bag: Annotated[Path, typer.Argument(help="Bag (folder) to write.", show_default=False, metavar="BAG")],
    signals: options.SignalsOption = None,
    namespace: options.NamespaceOption = "",
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Convert a log to a bag with our messages, which needs no signals file. Loads the whole log into memory."""
    from drive_id.files.messages.signals_file import read_signals
    from drive_id.files.read.several import read_recording
    from drive_id.files.results.folder import check_absent
    from drive_id.files.write.writer import write_recording

    check_absent(bag)
    signal_map = read_signals(signals) if signals else None
    with console.working(quiet or as_json, "Reading") as tell:
        recording = read_recording(log, signal_map, namespace=namespace)
        samples, pairs = recording.samples, signal_map.resolver.pole_pairs if signal_map else None
        tell("Writing", None)
        write_recording(bag, samples, recording.truth, start_stamp=0 if int(samples.stamp[0]) < 0 else None)
    if as_json:
        told = {"bag": str(bag), "samples": len(samples), "sample_period": samples.sample_period, "pole_pairs": pairs}
        console.print_json(told | {"runs": len(samples.run_starts), "warnings": list(recording.warnings)})
    elif not quiet:
        console.warn(*recording.warnings)
        period, runs = samples.sample_period * 1e6, len(samples.run_starts)
        console.say(f"{bag}: {counted(len(samples), 'sample')} every {period:.6g} us, {counted(runs, 'run')}.")
        if pairs:
            console.say(f"A bag does not hold the pole pairs: drive-id fit {bag} --set pole_pairs={pairs}")
