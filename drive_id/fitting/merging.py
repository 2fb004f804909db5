"""Many sources to one: bags and information files, accumulated each by itself and merged in an order that is fixed.

The same steps run here one after the other, and in ``cluster`` on many processes, so that both give the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from drive_id.core.accumulation.accumulated import Accumulated, bounded
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, DriveIdError, InformationError
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.extraction import extract_signals
from drive_id.files.read.reader import find_topics
from drive_id.files.results.information import read_information
from drive_id.files.results.information_name import is_information
from drive_id.files.storage.bag import open_bag
from drive_id.fitting.streaming import accumulate
from drive_id.types import Progress, silent

Item = TypeVar("Item")


@dataclass(frozen=True)
class Job:
    """What is to be done with each source.

    Parameters
    ----------
    settings : FitSettings
    signals : SignalMap or None
        Where to find the signals in bags that are not ours.
    namespace : str
        Of the drive, when a bag holds several.
    named : bool
        Put the name of the source before its warnings.
    threads : bool
        Let other threads read meanwhile.
    """

    settings: FitSettings
    signals: SignalMap | None = None
    namespace: str = ""
    named: bool = False
    threads: bool = True

    def of(self, number: int) -> Job:
        """Return the job for one of the sources, by its number."""
        return replace(self, settings=self.settings.of_recording(number))


@dataclass(frozen=True, eq=False)
class Part:
    """What came of some of the sources.

    Parameters
    ----------
    accumulated : Accumulated or None
        None when none of them was good.
    refused : tuple of DriveIdError
        One for each bad source, which it names.
    """

    accumulated: Accumulated | None
    refused: tuple[DriveIdError, ...] = ()

    def merged(self, other: Part) -> Part:
        """Return what came of both."""
        both = self.accumulated or other.accumulated
        if self.accumulated and other.accumulated:
            both = self.accumulated.merged(other.accumulated)
        return Part(both, (*self.refused, *other.refused))

    def result(self, settings: FitSettings) -> Accumulated:
        """Return what was accumulated, to be fitted by these settings, with a warning for each source left out.

        Raises
        ------
        DriveIdError
            The first one, when all were bad.
        """
        if self.accumulated is None:
            raise self.refused[0]
        warnings = (*(f"Left out: {error}" for error in self.refused), *self.accumulated.warnings)
        return replace(self.accumulated, evidence=self.accumulated.evidence.copy(settings), warnings=warnings)


def pairwise(items: Iterable[Item], combine: Callable[[Item, Item], Item]) -> Item:
    """Combine neighbours, then neighbouring pairs, and so on: an order that depends on the number of items alone.

    Parameters
    ----------
    items : iterable
        At least one; taken one by one, and no more kept than the depth of the tree.
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


def accumulate_sources(
    sources: Sequence[Path],
    settings: FitSettings,
    *,
    signals: SignalMap | None = None,
    namespace: str = "",
    skip_bad: bool = False,
    tell: Progress = silent,
) -> Accumulated:
    """Accumulate bags and information files of one drive, each by itself, and merge them.

    Parameters
    ----------
    sources : sequence of Path
    settings : FitSettings
        Without i_max, the radius is that of the first information file, or else of the recorded references.
    signals : SignalMap, optional
    namespace : str
    skip_bad : bool
        Leave out sources that cannot be used, and warn of them.
    tell : callable, optional

    Raises
    ------
    DriveIdError
        When a source cannot be used, or information files were accumulated differently.
    """
    check_sources(sources)
    job = Job(settings, signals, namespace, named=len(sources) > 1)
    if job.settings.i_max is None:
        radii = [radius_of(source, job) for source in sources]
        job = with_radius(job, sources, radii, skip_bad=skip_bad)
    share = 1 / len(sources)
    parts = (_told(source, job.of(number), tell, number * share, skip_bad) for number, source in enumerate(sources))
    return pairwise(parts, Part.merged).result(job.settings)


def _told(source: Path, job: Job, tell: Progress, share: float, skip_bad: bool) -> Part:
    tell("Accumulating", share)
    part = part_of(source, job)
    if part.refused and not skip_bad:
        raise part.refused[0]
    return part


def stored_settings(sources: Sequence[Path], *, skip_bad: bool = False) -> FitSettings | None:
    """Return the settings, radius included, by which the first information file was accumulated; None without one.

    Raises
    ------
    InformationError
        When it cannot be read, unless ``skip_bad`` says to look at the next one.
    """
    for source in filter(is_information, sources):
        with suppress(*[InformationError] if skip_bad else []):
            evidence = read_information(source).accumulated.evidence
            return replace(evidence.settings, i_max=evidence.i_max)
    return None


def check_sources(sources: Sequence[Path]) -> None:
    """Check that there are any.

    Raises
    ------
    ConfigurationError
    """
    if not sources:
        raise ConfigurationError("No bag is given: name at least one.")


def with_radius(
    job: Job, sources: Sequence[Path], radii: Sequence[float | DriveIdError | None], *, skip_bad: bool
) -> Job:
    """Give a job the radius that its sources have in common.

    Parameters
    ----------
    job : Job
    sources : sequence of Path
    radii : sequence
        Of each source, see :func:`radius_of`.
    skip_bad : bool

    Raises
    ------
    DriveIdError
        When a source is bad, or a bag has no references.
    """
    known, stored, unknown = [], [], None
    bad = next((radius for radius in radii if isinstance(radius, DriveIdError)), None)
    for source, radius in zip(sources, radii, strict=True):
        if isinstance(radius, float):
            known.append(radius)
            stored += [radius] if is_information(source) else []
        elif radius is None:
            unknown = unknown or source
    if bad and (not skip_bad or not (known or unknown)):
        raise bad
    if stored:
        return replace(job, settings=replace(job.settings, i_max=stored[0]))
    if unknown:
        raise ConfigurationError(
            f"{unknown} has no current references to take the radius of the disc from, and merging needs one in "
            "common: give --i-max, the largest amplitude of the trajectory in A."
        )
    return replace(job, settings=replace(job.settings, i_max=max(known)))


def radius_of(source: Path, job: Job) -> float | DriveIdError | None:
    """Return the radius of the disc of a source, A; None for a bag without references, or why it is bad.

    That of a bag is the largest amplitude of its references to three digits, so that trajectories that reach their
    radius between two samples have it in common.
    """
    try:
        if is_information(source):
            return read_information(source).accumulated.evidence.i_max
        with open_bag(source) as bag:
            topics = find_topics(bag, job.signals or SignalMap(), job.namespace)
            if "reference" not in topics:
                return None
            found = extract_signals(bag, job.signals or SignalMap(), {"reference": topics["reference"]})
    except DriveIdError as error:
        return _naming(source, error)
    amplitude = np.hypot(*found["reference"].values[:, :2].T)
    largest = float(np.max(amplitude, initial=0.0, where=np.isfinite(amplitude)))
    return float(f"{largest:.3g}") or None


def part_of(source: Path, job: Job) -> Part:
    """Accumulate one source, or tell why it is bad; the settings have a radius by now.

    Raises
    ------
    ConfigurationError
        When an information file was accumulated otherwise than the settings say.
    """
    try:
        if is_information(source):
            found = read_information(source).accumulated
        else:
            found = accumulate(
                [source], job.settings, signals=job.signals, namespace=job.namespace, threads=job.threads
            )
    except DriveIdError as error:
        return Part(None, (_naming(source, error),))
    if is_information(source):
        own = replace(found.evidence.settings, method=job.settings.method)
        found = replace(found, evidence=found.evidence.copy(own))  # without what another method needed
        wanted = Evidence.within(job.settings, job.settings.i_max or found.evidence.i_max)
        if difference := found.evidence.difference(wanted, "there", "here"):
            raise ConfigurationError(
                f"{source} was accumulated differently ({difference}) and cannot be merged: accumulate it again with "
                "these settings, or leave them out."
            )
    names = f"{source}: " if job.named else ""
    warnings = tuple(f"{names}{text}" for text in found.warnings)
    return Part(replace(found, warnings=warnings, validation=bounded(found.validation)))


def _naming(source: Path, error: DriveIdError) -> DriveIdError:
    """Return the error with the name of its source in it."""
    return error if str(source) in str(error) else type(error)(f"In {source}: {error}")
