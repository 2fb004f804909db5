"""Recordings to joined samples, at once or piece by piece: the one way in for our bags and for any other."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from drive_id.common.messages import Message
from drive_id.core.signals.held_references import HeldReferences
from drive_id.core.signals.join import SECTIONS, Piece, StreamJoin, join
from drive_id.core.signals.signal import Signal
from drive_id.errors import ConfigurationError, DataError, MissingTopicError
from drive_id.files.logs.column_log import ColumnLog
from drive_id.files.logs.log_kind import log_kind
from drive_id.files.logs.open_log import open_log
from drive_id.files.machines.ground_truth import decode_truth
from drive_id.files.messages.messages import SCALAR_SAMPLES
from drive_id.files.messages.signals_file import SignalMap, our_scalar
from drive_id.files.read.column_stream import ColumnStream
from drive_id.files.read.conversion import conversions, rotor_at_currents, undecimated
from drive_id.files.read.extraction import (
    INTERPOLATED,
    DividedError,
    LogSignals,
    SignalPart,
    SignalStream,
    UnusualError,
)
from drive_id.files.read.info import printable_errors
from drive_id.files.storage.bag import Bag, open_bag
from drive_id.files.storage.container import TRUTH_ATTACHMENT, TopicInfo
from drive_id.types import SCALARS, GroundTruth

CAPACITY = 1 << 20
"""Most samples of a signal to keep while others lag behind in the file; a bag that needs more is read as a whole."""
_LOCKING_PAIRS = 1 << 17  # samples by which the offset between the signals is measured, 13 s at 10 kHz
_AHEAD = 2
"""Parts that another thread prepares."""
_BEAT = 0.2
"""Seconds after which the progress is told again while a part is awaited: a bar that moves less often seems stuck."""

_FOLLOWS = {
    "stamp_unit": "flux linkages and inductances are proportional to it",
    "sample_period": "flux linkages and inductances are proportional to it",
    "scale": "R and all fluxes, all currents, or the DC link, are proportional to it",
    "offset": "it goes with the scale, and the currents are off by its error",
    "pole_pairs": "the fluxes are inversely proportional to it",
    "speed_unit": "the fluxes are inversely proportional to it",
    "angle_offset": "the map's axes turn by its error, and are exchanged or reversed by 90 degrees or more",
    "angle_advance": "R and the fluxes are wrong where the drive's angle is ahead, by 0.5 or 1.5 as a rule",
}
"""What depends on a setting that was guessed."""

Item = TypeVar("Item")


def read_signals_only(
    path: Path, signals: SignalMap, *, namespace: str = ""
) -> tuple[dict[str, Signal], tuple[Message, ...]]:
    """Read the signals of a log one by one, without joining them: a speed is enough, and no angle is needed.

    Returns them by section, and warnings. Raises BagError, DataError or ConfigurationError, as
    :func:`~drive_id.files.read.several.read_recording` does.
    """
    with _opened(path, signals, namespace, angle=False) as (log, _, stream):
        return stream.whole(), (*log.warnings, *stream.remarks(), *guesses(signals))


@dataclass(frozen=True, eq=False)
class BagFacts:
    """What is known when all of a bag has been read."""

    truth: GroundTruth | None
    warnings: tuple[Message, ...]
    checked: bool  # checksums covered all of it


def bag_pieces(
    path: Path,
    signals: SignalMap,
    namespace: str = "",
    *,
    whole: bool = False,
    threads: bool = True,
    tell: Callable[[float], None] = lambda _: None,
    end: Callable[[BagFacts], None] = lambda _: None,
    part: range | None = None,
) -> Iterator[Piece]:
    """Yield the joined samples of a bag in order of time, in bounded memory.

    ``part`` is as in :class:`~drive_id.files.read.extraction.SignalStream`. ``whole`` reads all of the bag before
    joining, for those that raise UnusualError otherwise; with ``threads``, others read, unpack and join ahead. ``tell``
    is called with the part of the bag that has been read, 0 to 1, and ``end`` with what is known when all of it has
    been read.

    Raises UnusualError when the bag must be read as a whole, and DividedError when it must be read by its parts, see
    :func:`~drive_id.files.read.drive_parts.drive_parts`: discard the pieces yielded so far. For the other errors, see
    :func:`~drive_id.files.read.several.read_recording`.
    """
    with _opened(path, signals, namespace, part=part) as (log, truth, stream):
        if part is None and isinstance(log, Bag) and log.metadata is not None and log.metadata.changes:
            raise DividedError
        warnings: list[Message] = []
        at_once = whole or not stream.continuous
        if at_once:  # by this thread, which an interrupt stops at any time
            joined = _joined_at_once(path, stream, signals, warnings, tell)
        else:
            joined = _joined(path, stream, signals, warnings, threads)
        with closing(prefetched(joined, _AHEAD, threads and not at_once, lambda: tell(stream.progress()))) as pieces:
            yield from pieces
        end(BagFacts(truth, (*log.warnings, *warnings, *guesses(signals)), log.checked))


def guesses(signals: SignalMap) -> Iterator[Message]:
    """Yield the settings of a signals file that its draft guessed and nobody confirmed."""
    for setting, lines in signals.guessed.items():
        what = _FOLLOWS.get(setting.partition(":")[0], "the result depends on it")
        yield Message(
            "guessed_setting", setting=setting, lines=", ".join(map(str, lines)), several=len(lines) > 1, what=what
        )


@contextmanager
def _opened(
    path: Path, signals: SignalMap, namespace: str, *, angle: bool = True, part: range | None = None
) -> Iterator[tuple[Bag | ColumnLog, GroundTruth | None, LogSignals]]:
    if angle and not signals.resolver.angle:
        raise ConfigurationError(
            "Section 'resolver' of the signals file names no angle: name it, or fit with --method static, which needs "
            "none."
        )
    if log_kind(path):
        with printable_errors(), open_log(path) as log:
            yield log, None, ColumnStream(log, signals)
        return
    with printable_errors(), open_bag(path) as bag:
        topics = find_topics(bag, signals, namespace)
        data = bag.attachment(TRUTH_ATTACHMENT)
        truth = None if data is None else decode_truth(data, str(path))
        yield bag, truth, SignalStream(bag, signals, topics, part)


def _joined_at_once(
    path: Path, stream: LogSignals, signals: SignalMap, warnings: list[Message], tell: Callable[[float], None]
) -> Generator[Piece, None, None]:
    """Yield all samples as one piece; add the warnings."""
    found = stream.whole(tell)
    if stream.divided:
        raise DividedError
    with naming(path):
        resolver, angle_error, said = rotor_at_currents(found, signals)
        result = join(
            found["currents"],
            found["voltages"],
            resolver,
            found.get("reference"),
            {name: signal for name, signal in found.items() if name in INTERPOLATED},
            scaled_by=signals.voltages.scaled_by,
            to_phases=conversions(signals),
            turned=signals.turned,
        )
    warnings.extend((*result.report.warnings, *stream.remarks(), *said))
    yield Piece(undecimated(replace(result.samples, angle_error=angle_error), signals), False)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the path of the log to errors of its samples."""
    try:
        yield
    except DataError as error:
        raise type(error)(f"In {path}: {error}") from error


def _joined(
    path: Path, stream: LogSignals, signals: SignalMap, warnings: list[Message], threads: bool
) -> Generator[Piece, None, None]:
    """Yield joined samples; add the warnings at the end."""
    topics = stream.topics
    names = (topics["currents"].name, topics["voltages"].name, topics["resolver"].name)
    held: HeldReferences | None = None  # references; none if the bag has no such topic
    joining = StreamJoin(
        names,
        batch=2 * CAPACITY,
        capacity=CAPACITY,
        locking=_LOCKING_PAIRS,
        recorded=True,
        reference=lambda stamp, period: None if held is None else held.at(stamp, period),
        scalars={name: topics[name].name for name in INTERPOLATED if name in topics},
        scaled_by=signals.voltages.scaled_by,
        to_phases=conversions(signals),
        turned=signals.turned,
    )
    before: SignalPart | None = None
    with closing(prefetched(stream.parts(), _AHEAD, threads)) as parts:
        for part in parts:
            if stream.divided:
                raise DividedError
            if "reference" in part:  # one part ahead: a set-point may be stored behind the samples it is due at
                period = part["reference"].sample_period
                if period is None:
                    raise UnusualError
                held = held or HeldReferences(period)
                held.add(part["reference"])
            for name in INTERPOLATED:
                if name in part:
                    joining.add_scalar(name, part[name])
            if before is not None:
                yield from _advanced(path, joining, before)
            before = part
    if before is not None:
        yield from _advanced(path, joining, before)
    end, rest = joining.finished()
    yield from rest
    with naming(path):
        end.check()
    warnings.extend((*end.report().warnings, *stream.remarks()))


def _advanced(path: Path, joining: StreamJoin, part: SignalPart) -> list[Piece]:
    for number, section in enumerate(SECTIONS):
        if section in part:
            joining.add(number, part[section])
    with naming(path):
        pieces = joining.advance()
        if joining.failing:
            joining.finished()[0].check()
    if joining.late:
        raise UnusualError
    return pieces


def find_topics(bag: Bag, signals: SignalMap, namespace: str = "") -> dict[str, TopicInfo]:
    """Return the topic of each section of a signal map: absolute names as given, others below one common namespace.

    Raises MissingTopicError when a required topic is not there, listing those that are, and ConfigurationError when
    several namespaces hold all topics and ``namespace`` is empty.
    """
    sources, needed = signals.sources(), signals.needed
    if signals.of_columns:
        raise ConfigurationError(
            f"{bag.path} is a bag, and the signals file names columns: name the topic of each section."
        )
    relative = {section: source.topic for section, source in sources.items() if not source.topic.startswith("/")}
    chosen = "/" + namespace.strip("/") if namespace.strip("/") else None
    prefix = _namespace(bag, {k: v for k, v in relative.items() if k in SECTIONS}, chosen)
    found = {}
    for section, source in sources.items():
        name = f"{prefix}/{source.topic}" if section in relative else source.topic
        needs_ours = section in SCALARS and replace(source, topic=section) == our_scalar(section)
        if name in bag.topics and needs_ours and bag.topics[name].type_name != SCALAR_SAMPLES:
            continue  # somebody else's topic of the same name
        if name in bag.topics and (section in needed or bag.topics[name].count != 0):
            found[section] = bag.topics[name]
        elif section in needed:
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


def prefetched(
    items: Generator[Item, None, None], ahead: int, threads: bool = True, tell: Callable[[], None] = lambda: None
) -> Generator[Item, None, None]:
    """Yield the items, produced in another thread up to ``ahead`` of them in advance if ``threads``.

    ``tell`` is called, by the thread of the caller, with every item and while one is waited for. Errors in the other
    thread are raised here. Close the generator to end it.
    """
    if not threads:
        for item in items:
            tell()
            yield item
        return
    with ThreadPoolExecutor(1, "reader") as pool:
        waiting = [pool.submit(next, items, None) for _ in range(ahead)]
        try:
            while True:
                while not wait(waiting[:1], _BEAT).done:
                    tell()
                found = waiting.pop(0).result()
                if found is None:
                    break
                tell()
                waiting.append(pool.submit(next, items, None))
                yield found
        finally:
            pool.shutdown(cancel_futures=True)
            items.close()
