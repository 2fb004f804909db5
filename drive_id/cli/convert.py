"""The command ``drive-id convert``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli.options import JsonFlag, NamespaceOption, QuietFlag, SignalsOption, say, warn, working


def convert_log(
    log: Annotated[
        Path,
        typer.Argument(help="Bag, or CSV, Parquet, MATLAB, MDF, TDMS or HDF5 file.", show_default=False, metavar="LOG"),
    ],
    bag: Annotated[Path, typer.Argument(help="Bag (folder) to write.", show_default=False, metavar="BAG")],
    signals: SignalsOption = None,
    namespace: NamespaceOption = "",
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Convert a log to a bag with our messages, which needs no signals file. Loads the whole log into memory."""
    from drive_id.files.messages.signals_file import read_signals
    from drive_id.files.read.several import read_recording
    from drive_id.files.results.folder import check_absent
    from drive_id.files.write.writer import write_recording

    check_absent(bag)
    signal_map = read_signals(signals) if signals else None
    with working(quiet or as_json) as tell:
        tell("Reading", None)
        recording = read_recording(log, signal_map, namespace=namespace)
        samples = recording.samples
        tell("Writing", None)
        write_recording(bag, samples, recording.truth, start_stamp=0 if int(samples.stamp[0]) < 0 else None)
    if as_json:
        told = {"bag": str(bag), "samples": len(samples), "sample_period": samples.sample_period}
        typer.echo(json.dumps(told | {"runs": len(samples.run_starts), "warnings": list(recording.warnings)}))
    elif not quiet:
        for warning in recording.warnings:
            warn(warning)
        say(
            f"{bag}: {len(samples)} samples every {samples.sample_period * 1e6:.6g} us, {len(samples.run_starts)} runs."
        )
