"""What to fit from, and how several sources become one: each is accumulated on its own, then all are merged.

The sources are read here one after the other, or on further processes (``workers``). The order of merging is fixed, so
both give the same result.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from drive_id.core.accumulation.accumulated import Accumulated, bounded
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, DriveIdError, InformationError
from drive_id.files.logs.log_kind import log_kind
from drive_id.files.messages.signals_file import SignalMap, read_signals
from drive_id.files.read.column_stream import largest_reference
from drive_id.files.read.extraction import SignalStream
from drive_id.files.read.reader import find_topics
from drive_id.files.read.several import read_recording
from drive_id.files.results.information import read_information
from drive_id.files.results.information_name import is_information
from drive_id.files.storage.bag import open_bag
from drive_id.fitting.processes import in_processes
from drive_id.fitting.streaming import accumulate
from drive_id.messages import Message
from drive_id.types import Progress, Samples, silent

Item = TypeVar("Item")


@dataclass(frozen=True)
class Sources:
    """What to fit from, and how to read it: one bundle from the command line and :func:`drive_id.fit` down.

    Parameters
    ----------
    paths : sequence of Path
        Bags (folders or files) and information files of one drive.
    signals : SignalMap, optional
        Where the signals are in bags with other messages than ours.
    namespace : str
        Of the drive, when a bag holds several.
    workers : int
        Processes that read the sources; 1: this one.
    skip_bad : bool
        Leave out sources that cannot be used, with a warning for each.

    Raises
    ------
    ConfigurationError
        When there is no path, or no worker.
    """

    paths: Sequence[Path]
    signals: SignalMap | None = None
    namespace: str = ""
    workers: int = 1
    skip_bad: bool = False

    def __post_init__(self) -> None:
        if not self.paths:
            raise ConfigurationError("No bag is given: name at least one.")
        if self.workers < 1:
            raise ConfigurationError(f"The number of workers is {self.workers}: give 1 or more.")

    @property
    def information(self) -> list[Path]:
        """Those of the paths that are information files."""
        return [path for path in self.paths if is_information(path)]

    def stored_settings(self) -> FitSettings | None:
        """Return the settings, with i_max, by which the first information file was accumulated; None without one.

        Raises
        ------
        InformationError
            When it cannot be read, unless ``skip_bad`` allows to try the next one.
        """
        for path in self.information:
            with suppress(*[InformationError] if self.skip_bad else []):
                evidence = read_information(path).accumulated.evidence
                return replace(evidence.settings, i_max=evidence.i_max)
        return None


def read_bag(
    bag: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    signals: str | os.PathLike[str] | SignalMap | None = None,
    namespace: str = "",
) -> Samples:
    """Read the samples of a bag, or of several bags of one drive one behind the other.

    What is wrong with the recording but can be lived with (lost samples, gaps) is a Python warning.

    Parameters
    ----------
    bag : path or sequence of path
        Folders or files: MCAP, sqlite3, ROS 1, or files of columns (CSV, Parquet, MATLAB, MDF, TDMS, HDF5).
    signals : path or SignalMap, optional
        Signals file: where the signals are in a bag with other messages than ours.
    namespace : str
        Of the drive, when a bag holds several.

    Returns
    -------
    Samples
        With ``truth`` when the bags are simulations of one machine.

    Raises
    ------
    DriveIdError
        When a bag cannot be read, or its signals cannot be joined.
    """
    paths = [Path(bag)] if isinstance(bag, (str, os.PathLike)) else [Path(entry) for entry in bag]
    signal_map = read_signals(Path(signals)) if isinstance(signals, (str, os.PathLike)) else signals
    recording = read_recording(paths, signal_map, namespace=namespace)
    for text in recording.warnings:
        warnings.warn(text, stacklevel=2)
    return replace(recording.samples, truth=recording.truth)


@dataclass(frozen=True)
class Job:
    """How to accumulate each source.

    Parameters
    ----------
    settings : FitSettings
    sources : Sources
    threads : bool
        Read in further threads; not where each process keeps to one core.
    """

    settings: FitSettings
    sources: Sources
    threads: bool = True

    def of(self, number: int) -> Job:
        """Return the job for one of the sources, by its number."""
        return replace(self, settings=self.settings.of_recording(number))


@dataclass(frozen=True, eq=False)
class Part:
    """What some of the sources gave.

    Parameters
    ----------
    accumulated : Accumulated or None
        None when all of them were refused.
    refused : tuple of DriveIdError
        One for each source that cannot be used, which it names.
    """

    accumulated: Accumulated | None
    refused: tuple[DriveIdError, ...] = ()

    def merged(self, other: Part) -> Part:
        """Return what both gave."""
        both = self.accumulated or other.accumulated
        if self.accumulated and other.accumulated:
            both = self.accumulated.merged(other.accumulated)
        return Part(both, (*self.refused, *other.refused))

    def result(self, settings: FitSettings) -> Accumulated:
        """Return what was accumulated, with these settings for the fit and a warning for each source left out.

        Raises
        ------
        DriveIdError
            The first one, when all sources were refused.
        """
        if self.accumulated is None:
            raise self.refused[0]
        said = (
            *(Message("left_out.recording", reason=str(error)) for error in self.refused),
            *self.accumulated.warnings,
        )
        return replace(self.accumulated, evidence=self.accumulated.evidence.copy(settings), warnings=said)


def pairwise(items: Iterable[Item], combine: Callable[[Item, Item], Item]) -> Item:
    """Combine neighbours, then neighbouring pairs, and so on: the order depends on the number of items alone.

    Parameters
    ----------
    items : iterable
        At least one; taken one by one, and never more kept than the depth of the tree.
    combine : callable
    """
    stack: list[tuple[int, Item]] = []  # combined items and how many they are of, ever fewer
    for item in items:
        stack.append((1, item))
        while len(stack) > 1 and stack[-2][0] == stack[-1][0]:
            _combine_last(stack, combine)
    while len(stack) > 1:
        _combine_last(stack, combine)
    return stack[0][1]


def _combine_last(stack: list[tuple[int, Item]], combine: Callable[[Item, Item], Item]) -> None:
    (count, last), (before, other) = stack.pop(), stack.pop()
    stack.append((before + count, combine(other, last)))


def accumulate_sources(sources: Sources, settings: FitSettings, tell: Progress = silent) -> Accumulated:
    """Accumulate each source on its own, and merge them.

    Parameters
    ----------
    sources : Sources
    settings : FitSettings
        Without i_max, it is that of the first information file, or else of the recorded references.
    tell : callable, optional

    Raises
    ------
    DriveIdError
        When a source cannot be used, or information files were accumulated differently.
    """
    workers = min(sources.workers, len(sources.paths))
    job = Job(settings, sources, threads=workers == 1)  # else a process is a core's
    if settings.i_max is None:
        job = with_radius(job, list(in_processes(partial(radius_of, job=job), sources.paths, workers)))
    jobs = ((path, job.of(number)) for number, path in enumerate(sources.paths))
    with closing(in_processes(_part, jobs, workers)) as parts:
        return pairwise(_told(parts, sources, tell), Part.merged).result(job.settings)


def _part(source: tuple[Path, Job]) -> Part:
    return part_of(*source)


def _told(parts: Iterable[Part], sources: Sources, tell: Progress) -> Iterator[Part]:
    tell("Accumulating", 0.0)
    for done, part in enumerate(parts, start=1):
        if part.refused and not sources.skip_bad:
            raise part.refused[0]
        tell("Accumulating", done / len(sources.paths))
        yield part


def with_radius(job: Job, radii: Sequence[float | DriveIdError | None]) -> Job:
    """Give a job the i_max that its sources have in common.

    Parameters
    ----------
    job : Job
    radii : sequence
        Of each source, see :func:`radius_of`.

    Raises
    ------
    DriveIdError
        When a source cannot be used, or a bag has no references.
    """
    known, stored, unknown = [], [], None
    bad = next((radius for radius in radii if isinstance(radius, DriveIdError)), None)
    for path, radius in zip(job.sources.paths, radii, strict=True):
        if isinstance(radius, float):
            known.append(radius)
            stored += [radius] if is_information(path) else []
        elif radius is None:
            unknown = unknown or path
    if bad and (not job.sources.skip_bad or not (known or unknown)):
        raise bad
    if stored:
        return replace(job, settings=replace(job.settings, i_max=stored[0]))
    if unknown:
        raise ConfigurationError(
            f"{unknown} has no current references to take i_max from, and sources can only be merged with one in "
            "common: give --i-max, the largest current amplitude of the trajectory in A."
        )
    return replace(job, settings=replace(job.settings, i_max=max(known)))


def radius_of(path: Path, job: Job) -> float | DriveIdError | None:
    """Return i_max of a source, A; None for a bag without references, or the error that makes it unusable.

    That of a bag is the largest amplitude of its references to three digits, so that recordings of one trajectory have
    it in common although the peak lies between two samples.
    """
    signals = job.sources.signals or SignalMap()
    try:
        if is_information(path):
            return read_information(path).accumulated.evidence.i_max
        if log_kind(path):
            largest = largest_reference(path, signals)
            return None if largest is None else float(f"{largest:.3g}") or None
        with open_bag(path) as bag:
            topics = find_topics(bag, signals, job.sources.namespace)
            if "reference" not in topics:
                return None
            found = SignalStream(bag, signals, {"reference": topics["reference"]}).whole()
    except DriveIdError as error:
        return _naming(path, error)
    amplitude = np.hypot(*found["reference"].values[:, :2].T)
    largest = float(np.max(amplitude, initial=0.0, where=np.isfinite(amplitude)))
    return float(f"{largest:.3g}") or None


def part_of(path: Path, job: Job) -> Part:
    """Accumulate one source, or return the error that makes it unusable; the settings have an i_max by now.

    Raises
    ------
    ConfigurationError
        When an information file was accumulated with other settings.
    """
    sources = job.sources
    try:
        if is_information(path):
            found = read_information(path).accumulated
        else:
            found = accumulate(
                [path], job.settings, signals=sources.signals, namespace=sources.namespace, threads=job.threads
            )
    except DriveIdError as error:
        return Part(None, (_naming(path, error),))
    if is_information(path):
        own = replace(found.evidence.settings, method=job.settings.method)
        found = replace(found, evidence=found.evidence.copy(own))  # without what another method needed
        wanted = Evidence.within(job.settings, job.settings.i_max or found.evidence.i_max)
        if difference := found.evidence.difference(wanted, "there", "here"):
            raise ConfigurationError(
                f"{path} was accumulated differently ({difference}) and cannot be merged: accumulate it again with "
                "these settings, or remove them."
            )
    said = tuple(message.of(path) for message in found.warnings) if len(sources.paths) > 1 else found.warnings
    return Part(replace(found, warnings=said, validation=bounded(found.validation)))


def _naming(source: Path, error: DriveIdError) -> DriveIdError:
    """Return the error with the name of its source in it."""
    return error if str(source) in str(error) else type(error)(f"In {source}: {error}")
