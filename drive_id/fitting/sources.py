"""What to fit from, and how several sources become one: each is accumulated on its own, then all are merged.

The sources are read here one after the other, on further processes (``workers``), or by an executor, which may be that
of a cluster. The order of merging is fixed, so all give the same result.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from drive_id.common.arguments import path_of
from drive_id.common.messages import Message
from drive_id.common.origins import ORIGINS
from drive_id.core.accumulation.accumulated import Accumulated, bounded
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.errors import ConfigurationError, DriveIdError, InformationError, NotABagError
from drive_id.files.inputs.remote import fetched, shown, url_of
from drive_id.files.logs.log_kind import log_kind
from drive_id.files.messages.signals_file import SignalMap, signals_of
from drive_id.files.read.column_stream import largest_reference
from drive_id.files.read.extraction import SignalStream
from drive_id.files.read.reader import find_topics
from drive_id.files.read.several import read_recording
from drive_id.files.results.folder import is_information
from drive_id.files.results.information import read_information
from drive_id.files.storage.bag import open_bag
from drive_id.fitting.processes import in_processes
from drive_id.fitting.streaming import accumulate
from drive_id.types import Progress, Samples, silent

Item = TypeVar("Item")


@dataclass(frozen=True)
class Sources:
    """What to fit from, and how to read it: one bundle from the command line and :func:`drive_id.fit` down.

    Raises
    ------
    ConfigurationError
        When there is no path, or no worker.
    """

    paths: Sequence[Path]  # bags (folders or files) and information files of one drive
    signals: SignalMap | None = None  # where the signals are in bags with other messages than ours
    namespace: str = ""  # of the drive, when a bag holds several
    workers: int = 1  # processes that read the sources; 1: this one, or as many as the executor has
    skip_bad: bool = False  # leave out sources that cannot be used, with a warning for each
    executor: Executor | None = None  # what reads the sources instead of processes of ours
    compared: bool = False  # keep the sums of the paper's methods, too, whatever the method of the fit

    def __post_init__(self) -> None:
        if not self.paths:
            raise ConfigurationError("No bag is given: name at least one.")
        if self.workers < 1:
            raise ConfigurationError(f"The number of workers is {self.workers}: give 1 or more.")

    @property
    def information(self) -> list[Path]:
        """Those of the paths that are information files."""
        return [path for path in self.paths if is_information(path)]

    @property
    def remote(self) -> bool:
        """Whether any of the paths is a URL."""
        return any(map(url_of, self.paths))

    def stored_settings(self) -> FitSettings | None:
        """Return the settings, with i_max, by which the first information file was accumulated; None without one.

        Raises InformationError when it cannot be read, unless ``skip_bad`` allows to try the next one.
        """
        for path in self.information:
            with suppress(*[InformationError, NotABagError] if self.skip_bad else []), fetched(path) as here:
                evidence = read_information(here).accumulated.evidence
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
    one = isinstance(bag, (str, os.PathLike)) or not isinstance(bag, Iterable)
    given: Any = [bag] if one else bag
    paths = [path_of(entry, "bag") for entry in given]
    signal_map = signals_of(signals)
    recording = read_recording(paths, signal_map, namespace=namespace)
    for text in recording.warnings:
        warnings.warn(text, stacklevel=2)
    return replace(recording.samples, truth=recording.truth)


def pairwise(items: Iterable[Item], combine: Callable[[Item, Item], Item]) -> Item:
    """Combine neighbours, then neighbouring pairs, and so on: the order depends on the number of items alone.

    Of the items, at least one, never more are kept than the depth of the tree.
    """
    stack: list[tuple[int, Item]] = []  # combined items and how many they are of, ever fewer
    for item in items:
        count, last = 1, item
        while stack and stack[-1][0] == count:
            count, last = 2 * count, combine(stack.pop()[1], last)
        stack.append((count, last))
    _, last = stack.pop()
    while stack:
        last = combine(stack.pop()[1], last)
    return last


def accumulate_sources(sources: Sources, settings: FitSettings, tell: Progress = silent) -> Accumulated:
    """Accumulate each source on its own, and merge them.

    Where the settings have no i_max, it is that of the first information file, or else of the recorded references.

    Raises DriveIdError when a source cannot be used, or information files were accumulated differently.
    """
    workers = min(sources.workers, len(sources.paths))
    elsewhere = sources.executor is not None  # perhaps in another folder
    paths = [path if url_of(path) else path.absolute() for path in sources.paths] if elsewhere else sources.paths
    asked = replace(sources, paths=paths[:1], executor=None)  # goes along with each path, so without the others
    if settings.i_max is None:
        radii = list(in_processes(partial(radius_of, sources=asked), paths, workers, sources.executor))
        settings = replace(settings, i_max=_common_radius(sources, radii))
    work = partial(_accumulated, sources=asked, threads=workers == 1 and not elsewhere)  # else a process is a core's
    each = ((path, settings.of_recording(number)) for number, path in enumerate(paths))
    refused: list[DriveIdError] = []
    with closing(in_processes(work, each, workers, sources.executor)) as parts:
        found = pairwise(_usable(parts, sources, refused, tell), _merged)
    if found is None:
        raise refused[0]
    left_out = (Message("left_out.recording", reason=str(error)) for error in refused)
    return replace(found, evidence=found.evidence.copy(settings), warnings=(*left_out, *found.warnings))


def _usable(
    parts: Iterable[Accumulated | DriveIdError], sources: Sources, refused: list[DriveIdError], tell: Progress
) -> Iterator[Accumulated | None]:
    """Yield what each source gave; None for one that cannot be used, whose error is raised, or kept in ``refused``."""
    tell("Accumulating", 0.0)
    for done, part in enumerate(parts, start=1):
        if isinstance(part, DriveIdError):
            if not sources.skip_bad:
                raise part
            refused.append(part)
        tell("Accumulating", done / len(sources.paths))
        if isinstance(part, DriveIdError):
            yield None
        elif len(sources.paths) > 1:
            source = shown(sources.paths[done - 1])
            yield replace(part, warnings=tuple(message.of(source) for message in part.warnings))
        else:
            yield part


def _merged(one: Accumulated | None, other: Accumulated | None) -> Accumulated | None:
    return one.merged(other) if one and other else one or other


def _common_radius(sources: Sources, radii: Sequence[float | DriveIdError | None]) -> float:
    """Return the i_max that the sources have in common, A, from that of each, see :func:`radius_of`."""
    found = list(zip(sources.paths, radii, strict=True))
    known = [radius for radius in radii if isinstance(radius, float)]
    stored = [radius for path, radius in found if isinstance(radius, float) and is_information(path)]
    unknown = next((shown(path) for path, radius in found if radius is None), None)
    bad = next((radius for radius in radii if isinstance(radius, DriveIdError)), None)
    if bad and (not sources.skip_bad or not (known or unknown)):
        raise bad
    if stored:
        return stored[0]
    if unknown:
        raise ConfigurationError(
            f"{unknown} has no current references to take i_max from, and sources can only be merged with one in "
            "common: give --i-max, the largest current amplitude of the trajectory in A."
        )
    return max(known)


def radius_of(path: Path, sources: Sources) -> float | DriveIdError | None:
    """Return i_max of a source, A; None for a bag without references, or the error that makes it unusable.

    That of a bag is the largest amplitude of its references to three digits, so that recordings of one trajectory have
    it in common although the peak lies between two samples.
    """
    try:
        with fetched(path) as here:
            return _radius(here, sources)
    except DriveIdError as error:
        return _naming(path, error)


def _radius(path: Path, sources: Sources) -> float | None:
    signals = sources.signals or SignalMap()
    if is_information(path):
        return read_information(path).accumulated.evidence.i_max
    if log_kind(path):
        largest = largest_reference(path, signals)
    else:
        with open_bag(path) as bag:
            topics = find_topics(bag, signals, sources.namespace)
            if "reference" not in topics:
                return None
            found = SignalStream(bag, signals, {"reference": topics["reference"]}).whole()
        amplitude = np.hypot(*found["reference"].values[:, :2].T)
        largest = float(np.max(amplitude, initial=0.0, where=np.isfinite(amplitude)))
    return None if largest is None else float(f"{largest:.3g}") or None


def _accumulated(source: tuple[Path, FitSettings], sources: Sources, *, threads: bool) -> Accumulated | DriveIdError:
    """Accumulate one source with its settings, which have an i_max, or return the error that makes it unusable.

    Raises ConfigurationError when an information file was accumulated with other settings.
    """
    path, settings = source
    try:
        with fetched(path) as here:
            found, stored = _read(here, settings, sources, threads=threads), is_information(here)
    except DriveIdError as error:
        return _naming(path, error)
    if here != path:
        found = _renamed(found, str(here), shown(path))
    if stored:
        before = found.evidence.settings.method
        if ORIGINS[before].turning != ORIGINS[settings.method].turning:
            raise ConfigurationError(
                f"{shown(path)} was accumulated and checked for method {before}, and method locked alone fits a rotor "
                f"that does not turn: fit it by method {before}, or accumulate it again for method {settings.method}."
            )
        own = replace(found.evidence.settings, method=settings.method)
        found = replace(found, evidence=found.evidence.copy(own))  # without what another method needed
        wanted = Evidence.within(settings, settings.i_max or found.evidence.i_max)
        if difference := found.evidence.difference(wanted, "there", "here"):
            raise ConfigurationError(
                f"{shown(path)} was accumulated differently ({difference}) and cannot be merged: accumulate it again "
                "with these settings, or remove them."
            )
    return replace(found, validation=bounded(found.validation))


def _read(path: Path, settings: FitSettings, sources: Sources, *, threads: bool) -> Accumulated:
    if is_information(path):
        return read_information(path).accumulated
    with one_blas_thread():  # whatever the process that this is
        return accumulate(
            [path], settings, signals=sources.signals, namespace=sources.namespace, threads=threads,
            compared=sources.compared,
        )  # fmt: skip


def _renamed(found: Accumulated, here: str, name: str) -> Accumulated:
    """Return what was read from a copy as that of its origin."""
    return replace(
        found,
        digests={file.replace(here, name): digest for file, digest in found.digests.items()},
        unchecked=tuple(file.replace(here, name) for file in found.unchecked),
        warnings=tuple(
            Message.told(text.replace(here, name), text.code, text.values, text.kind) for text in found.warnings
        ),
    )


def _naming(source: Path, error: DriveIdError) -> DriveIdError:
    """Return the error with the name of its source in it."""
    name = shown(source)
    return error if name in str(error) else type(error)(f"In {name}: {error}")
