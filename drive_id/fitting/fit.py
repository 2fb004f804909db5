"""Fit recordings: from Python, for the command line and for the nodes; or accumulate them for a later fit."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from drive_id.common.arguments import expect
from drive_id.common.messages import Message
from drive_id.common.origins import ORIGINS, STATIC
from drive_id.core.accumulation.accumulated import Accumulated
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.diagnostics import COMPARED
from drive_id.core.result.identify import identify
from drive_id.core.signals.pieces import common_truth
from drive_id.core.steady.operating_data import OperatingData
from drive_id.errors import ConfigurationError, DataError
from drive_id.files.messages.signals_file import SignalMap, signals_of
from drive_id.files.read.reader import guesses
from drive_id.files.read.several import digests_of
from drive_id.files.results.folder import check_output, check_recordings, is_result
from drive_id.files.results.information import check_information_output, write_information
from drive_id.fitting.completion import completed
from drive_id.fitting.result import Identification
from drive_id.fitting.sources import Sources, accumulate_sources
from drive_id.fitting.streaming import accumulate
from drive_id.types import Progress, Samples, silent

Method = Literal["full", "joint", "psm", "locked", "static"]
StrPath = str | os.PathLike[str]

_ODD_SAMPLES = ("single_sample", "outlier", "phase_stuck", "current_spike")
"""Findings that flipped bits may cause."""


def fit(
    recordings: StrPath | Samples | OperatingData | Sequence[StrPath] | Sequence[Samples | OperatingData],
    *,
    method: Method | None = None,
    i_max: float | None = None,
    machine: str | None = None,
    serial: str | None = None,
    signals: StrPath | SignalMap | None = None,
    namespace: str = "",
    settings: FitSettings | None = None,
    output: StrPath | None = None,
    force: bool = False,
    workers: int = 1,
    executor: Executor | None = None,
    skip_bad: bool = False,
    compare: bool = False,
    tell: Progress = silent,
) -> Identification:
    """Identify flux maps, resistance and inverter voltage error from recordings of one drive.

    The same as ``drive-id fit``, with the same numbers.

    Parameters
    ----------
    recordings : path, Samples, OperatingData, or a sequence of one of them
        Bags (folders or files) and information files (``drive-id accumulate``), in any mixture, also as URLs of
        object storage (``s3://...``); or samples; or, for method ``static``, slow telemetry in d and q.
    method : {"full", "joint", "psm", "locked", "static"}, optional
        Default: that of ``settings``; ``static`` for OperatingData.
    i_max : float, optional
        Radius of the current disc, A. Default: that of the recorded references, or the largest measured amplitude.
    machine, serial : str, optional
        Name and serial number of the machine, for titles.
    signals : path or SignalMap, optional
        Signals file: where the signals are in a bag with other messages than ours.
    namespace : str
        Of the drive, when a bag holds several.
    settings : FitSettings, optional
        All else. Default: those of the first information file, or else the defaults.
    output : path, optional
        Write a result folder, too, as :meth:`Identification.save` does.
    force : bool
        Let ``output`` be a folder that holds other files.
    workers : int
        Processes that read the recordings; a script that asks for several needs ``if __name__ == "__main__":``.
    executor : concurrent.futures.Executor, optional
        What reads the recordings instead: processes, or a cluster (Dask, MPI) that has drive_id and sees the same
        files. It gets 32 recordings at a time, or twice as many as ``workers``, if that tells how many it has.
    skip_bad : bool
        Leave out recordings that cannot be used, with a warning for each.
    compare : bool
        Keep sums of long bags for the paper's methods, too, so that reports and pictures of the result show them.
    tell : callable, optional
        Called with what is being done and its progress, 0 to 1.

    Returns
    -------
    Identification

    Raises
    ------
    DriveIdError
        When a setting is invalid, a recording cannot be used, or the data do not suffice for a map.

    Examples
    --------
    >>> result = drive_id.fit("my_bag", method="full", signals="my_signals.yaml")  # doctest: +SKIP
    >>> psi_d, psi_q = result.flux_map.psi_dq(-100.0, 150.0)  # doctest: +SKIP
    """
    paths, samples = _divided(recordings)
    signal_map = signals_of(signals)
    target = None if output is None else Path(output)
    chosen = _chosen(settings, samples, method=method, i_max=i_max, machine=machine, serial=serial)
    if samples:
        if signals or namespace or workers > 1 or executor or skip_bad:
            raise ConfigurationError(
                "signals, namespace, workers, executor and skip_bad are about bags: leave them out."
            )
        own = replace(settings or FitSettings(), **chosen)
        return _saved(partial(_fit_memory, samples, own, tell), target, force=force, tell=tell)
    sources = Sources(paths, signal_map, namespace, workers, skip_bad, executor, compare)
    settings = replace(settings or sources.stored_settings() or FitSettings(), **chosen)
    return fit_bags(sources, target, settings, force=force, tell=tell)


def _divided(recordings: object) -> tuple[list[Path], list[Samples | OperatingData]]:
    """Return the paths and the samples among what a user passes; all are of one kind."""
    if isinstance(recordings, (str, os.PathLike, Samples, OperatingData)):
        recordings = [recordings]
    if not isinstance(recordings, Iterable) or isinstance(recordings, Mapping) or hasattr(recordings, "columns"):
        raise ConfigurationError(
            f"drive_id.fit cannot read recordings from a {type(recordings).__name__}: give paths or Samples."
        )
    given = list(recordings)
    samples = [entry for entry in given if isinstance(entry, (Samples, OperatingData))]
    paths = [Path(entry) for entry in given if isinstance(entry, (str, os.PathLike))]
    if len(samples) + len(paths) < len(given) or (samples and paths):
        raise ConfigurationError(
            "The recordings are neither all paths nor all Samples: give one or a list of either, and read bags by "
            "drive_id.read_bag to fit them together with samples."
        )
    return paths, samples


def _chosen(settings: object, samples: Sequence[Samples | OperatingData], **options: Any) -> dict[str, Any]:
    """Return what replaces a setting: the options that are given, and method static for OperatingData alone."""
    expect(settings, (FitSettings, type(None)), "settings", "give drive_id.FitSettings(method=..., ...)")
    given = {name: value for name, value in options.items() if value is not None}
    if settings is None and any(isinstance(entry, OperatingData) for entry in samples):
        given.setdefault("method", STATIC.name)
    return given


def _saved(work: Callable[[], Identification], output: Path | None, *, force: bool, tell: Progress) -> Identification:
    """Return the result of some work, and write it to a folder, which is checked before."""
    if output is None:
        return work()
    check_output(output, force=force)
    result = work()
    tell("Writing", None)
    result.save(output, force=force)
    return result


def _fit_memory(recordings: Sequence[Samples | OperatingData], settings: FitSettings, tell: Progress) -> Identification:
    settings.check_recordings(len(recordings))
    if not ORIGINS[settings.method].live:
        from drive_id.fitting.static import fit_operating_data  # noqa: PLC0415  # other methods do without it

        return fit_operating_data(recordings, settings, tell)
    samples = [part for part in recordings if isinstance(part, Samples)]
    if len(samples) < len(recordings):
        raise ConfigurationError(
            f"Method {settings.method} needs samples of phase quantities: fit OperatingData by method static."
        )
    return completed(
        identify(samples, settings, tell),
        settings,
        excerpts=samples,
        truth=common_truth([part.truth for part in samples]),
        duration=sum(part.duration for part in samples),
        last_stamp=int(samples[-1].stamp[-1]),
    )


def fit_bags(
    sources: Sources, output: Path | None, settings: FitSettings, *, force: bool = False, tell: Progress = silent
) -> Identification:
    """Fit bags and information files of one drive, and write the results to a folder, unless ``output`` is None.

    ``force`` replaces the result of other recordings and writes into a folder that holds other files. Raises
    DriveIdError; nothing is written then. A refusal for what the samples hold names what a draft guessed about them.
    """
    if output is not None and is_result(output) and not (sources.information or sources.skip_bad or sources.remote):
        check_recordings(output, digests_of(sources.paths), force=force)  # before the work; again when it is written
    try:
        return _saved(partial(_fit_sources, sources, settings, tell), output, force=force, tell=tell)
    except DataError as error:
        guessed = next(guesses(sources.signals), None) if sources.signals else None
        error.args = (f"{error} {guessed}" if guessed else str(error),)
        raise


def _fit_sources(sources: Sources, settings: FitSettings, tell: Progress) -> Identification:
    static = not ORIGINS[settings.method].live
    if static or not sources.information:  # these know their own
        settings.check_recordings(len(sources.paths))
    if static:
        from drive_id.fitting.static import fit_logs  # noqa: PLC0415  # other methods do without it

        return fit_logs(sources, settings, tell)
    with one_blas_thread():
        recording = _accumulated(sources, settings, tell)
        tell("Solving", None)
        drive = conclude(recording.evidence, recording.validation)
    evidence = recording.evidence
    warnings, statements = _on_checksums(recording)
    result = completed(
        replace(drive, statements=(*drive.statements, *statements)),
        settings,
        excerpts=recording.validation,
        truth=recording.truth,
        signals=sources.signals,
        duration=evidence.samples * evidence.sample_period,
        last_stamp=recording.last_stamp,
        inputs=recording.digests,
        warnings=(*recording.warnings, *warnings),
    )
    if evidence.information is None:
        return result
    sums = evidence.copy(replace(evidence.settings, method=COMPARED[0]))  # without windows, which take memory
    return replace(result, evidence=sums)


def _on_checksums(recording: Accumulated) -> tuple[tuple[Message, ...], tuple[Message, ...]]:
    """Return what to say of recordings without checksums: as a warning where samples stand out, or as a statement."""
    if not recording.unchecked:
        return (), ()
    first, *others = recording.unchecked
    odd = any(finding.code in _ODD_SAMPLES for finding in recording.evidence.findings)
    said = Message("no_checksums.odd" if odd else "no_checksums", first=first, others=len(others) or None)
    return ((said,), ()) if odd else ((), (said,))


def accumulate_bags(sources: Sources, output: Path, settings: FitSettings, tell: Progress = silent) -> Accumulated:
    """Accumulate bags of one drive, each on its own, and write an information file.

    Raises DriveIdError; nothing is written then.
    """
    check_information_output(output)
    with one_blas_thread():
        accumulated = _accumulated(replace(sources, compared=True), settings, tell, apart=True)
    tell("Writing", None)
    write_information(output, accumulated)
    return accumulated


def _accumulated(sources: Sources, settings: FitSettings, tell: Progress, *, apart: bool = False) -> Accumulated:
    """Accumulate the sources together, or each on its own."""
    apart = apart or sources.skip_bad or sources.remote or sources.workers > 1
    if apart or sources.information or sources.executor:
        return accumulate_sources(sources, settings, tell)
    return accumulate(
        sources.paths, settings, signals=sources.signals, namespace=sources.namespace, compared=sources.compared,
        tell=tell,
    )  # fmt: skip
