"""Recordings to samples: the one entry for our bags and for anyone's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drive_id.core.signals.join import join
from drive_id.core.signals.join_report import JoinReport
from drive_id.core.signals.pieces import common_truth, merge, overlap_warning
from drive_id.errors import ConfigurationError, DataError, MissingTopicError
from drive_id.files.machines.ground_truth import decode_truth
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.extraction import extract_signals
from drive_id.files.read.info import printable_errors
from drive_id.files.storage.bag import Bag, file_digest, open_bag
from drive_id.files.storage.container import TRUTH_ATTACHMENT, TopicInfo
from drive_id.types import GroundTruth, Samples

REQUIRED = ("currents", "voltages", "resolver")


@dataclass(frozen=True, eq=False)
class Recording:
    """What was read of one bag or of several.

    Parameters
    ----------
    samples : Samples
        Joined; each bag begins a new run.
    reports : tuple of JoinReport
        One per bag.
    truth : GroundTruth or None
        Of the simulation, when all bags carry one of the same machine.
    digests : dict of str to str
        Storage file to its sha256.
    topics : dict of str to str
        Section of the signal map (``currents``, ...) to topic, of the first bag.
    warnings : tuple of str
        Sentences, those of the reports included.
    """

    samples: Samples
    reports: tuple[JoinReport, ...]
    truth: GroundTruth | None
    digests: dict[str, str]
    topics: dict[str, str]
    warnings: tuple[str, ...]


def read_recording(path: Path, signals: SignalMap | None = None, *, namespace: str = "") -> Recording:
    """Read one bag.

    Parameters
    ----------
    path : Path
        Storage file or folder.
    signals : SignalMap, optional
        Default: our own messages.
    namespace : str
        Of the drive, when a bag holds several.

    Raises
    ------
    BagError
        When the bag, a topic or a message cannot be read.
    DataError
        When its samples cannot be joined.
    ConfigurationError
        When it holds several drives and none was chosen.
    """
    signals = signals or SignalMap()
    with printable_errors(), open_bag(path) as bag:
        topics = find_topics(bag, signals, namespace)
        found = extract_signals(bag, signals, topics)
        data = bag.attachment(TRUTH_ATTACHMENT)
        truth = None if data is None else decode_truth(data, str(path))
        files, cut_off = bag.files, bag.warnings
    try:
        result = join(found["currents"], found["voltages"], found["resolver"], found.get("reference"))
    except DataError as error:
        raise type(error)(f"In {path}: {error}") from error
    digests = {str(file): file_digest(file) for file in files}
    names = {section: topic.name for section, topic in topics.items()}
    return Recording(result.samples, (result.report,), truth, digests, names, (*cut_off, *result.report.warnings))


def read_recordings(paths: Sequence[Path], signals: SignalMap | None = None, *, namespace: str = "") -> Recording:
    """Read several bags of one drive as one recording, each joined on its own; see :func:`read_recording`.

    Raises
    ------
    ConfigurationError
        When no bag is given, or the same one twice.
    """
    if not paths:
        raise ConfigurationError("No bag is given: name at least one.")
    recordings = [read_recording(path, signals, namespace=namespace) for path in paths]
    if len(recordings) == 1:
        return recordings[0]
    seen: dict[str, str] = {}
    for recording in recordings:
        for file, digest in recording.digests.items():
            if digest in seen:
                raise ConfigurationError(f"{file} and {seen[digest]} are the same recording: give each bag once.")
            seen[digest] = file
    samples, moved = merge([recording.samples for recording in recordings])
    warnings = [f"{path}: {text}" for path, rec in zip(paths, recordings, strict=True) for text in rec.warnings]
    warnings += [overlap_warning(paths[k]) for k in moved]
    return Recording(
        samples,
        tuple(report for recording in recordings for report in recording.reports),
        common_truth([recording.truth for recording in recordings]),
        {file: digest for digest, file in seen.items()},
        recordings[0].topics,
        tuple(warnings),
    )


def find_topics(bag: Bag, signals: SignalMap, namespace: str = "") -> dict[str, TopicInfo]:
    """Find the topic of each section of a signal map.

    Absolute names are taken as they are; relative ones are searched for below one common namespace.

    Raises
    ------
    MissingTopicError
        Naming the topics that the bag does have.
    ConfigurationError
        When several namespaces hold all topics and none was chosen.
    """
    sources = signals.sources()
    relative = {section: source.topic for section, source in sources.items() if not source.topic.startswith("/")}
    chosen = "/" + namespace.strip("/") if namespace.strip("/") else None
    prefix = _namespace(bag, {k: v for k, v in relative.items() if k in REQUIRED}, chosen)
    found = {}
    for section, source in sources.items():
        name = f"{prefix}/{source.topic}" if section in relative else source.topic
        if name in bag.topics and (section in REQUIRED or bag.topics[name].count != 0):
            found[section] = bag.topics[name]
        elif section in REQUIRED:
            raise _missing(bag, name, section)
    return found


def _namespace(bag: Bag, relative: dict[str, str], chosen: str | None) -> str:
    """Return the namespace, without a trailing slash, that holds all the relative topics."""
    if chosen is not None or not relative:
        return chosen or ""
    holding = {
        section: {name[: -len(topic) - 1] for name in bag.topics if name.endswith(f"/{topic}")}
        for section, topic in relative.items()
    }
    complete = set.intersection(*holding.values())
    if len(complete) > 1:
        names = ", ".join(sorted(prefix or "/" for prefix in complete))
        raise ConfigurationError(f"{bag.path} holds several drives ({names}): choose one with the option namespace.")
    if complete:
        return complete.pop()
    for section, prefixes in holding.items():
        if not prefixes:
            raise _missing(bag, relative[section], section)
    best = max(
        sorted(set.union(*holding.values())), key=lambda prefix: sum(prefix in held for held in holding.values())
    )
    section = next(section for section, prefixes in holding.items() if best not in prefixes)
    raise _missing(bag, f"{best}/{relative[section]}", section)


def _missing(bag: Bag, name: str, section: str) -> MissingTopicError:
    topics = sorted(bag.topics)
    shown = ", ".join(topics[:12]) + (", ..." if len(topics) > 12 else "")
    return MissingTopicError(
        f"{bag.path} has no topic {name} for the {section} (it has {shown or 'none at all'}): record it, or name "
        "another one in a signals file."
    )
