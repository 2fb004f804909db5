"""A bag as joined samples, piece by piece: what :func:`~drive_id.files.read.reader.read_recording` gives at once."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from drive_id.core.signals.held_references import HeldReferences
from drive_id.core.signals.join import join
from drive_id.core.signals.stream_join import Piece, StreamJoin
from drive_id.errors import DataError
from drive_id.files.machines.ground_truth import decode_truth
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.extraction import Part, SignalStream, UnusualError, extract_signals
from drive_id.files.read.info import printable_errors
from drive_id.files.read.reader import REQUIRED, find_topics
from drive_id.files.storage.bag import Bag, open_bag
from drive_id.files.storage.container import TRUTH_ATTACHMENT, TopicInfo
from drive_id.types import FloatArray, GroundTruth, IntArray

CAPACITY = 1 << 20
"""Most samples of a signal to keep while others lag behind in the file; a bag that needs more is read as a whole."""
_LOCKING_PAIRS = 1 << 17
_AHEAD = 2
_WAIT = 0.1

Item = TypeVar("Item")


@dataclass(frozen=True, eq=False)
class BagFacts:
    """What is known of a bag when all of it was read.

    Parameters
    ----------
    files : tuple of Path
    truth : GroundTruth or None
    warnings : tuple of str
    """

    files: tuple[Path, ...]
    truth: GroundTruth | None
    warnings: tuple[str, ...]


def bag_pieces(
    path: Path,
    signals: SignalMap,
    namespace: str = "",
    *,
    whole: bool = False,
    threads: bool = True,
    tell: Callable[[float], None] = lambda _: None,
) -> Generator[Piece, None, BagFacts]:
    """Yield the joined samples of a bag in order of time, and return what else there is to know of it.

    Parameters
    ----------
    path : Path
    signals : SignalMap
    namespace : str
        Of the drive, when the bag holds several.
    whole : bool
        Read all of it before anything is joined.
    threads : bool
        Let other threads read, unpack and join meanwhile.
    tell : callable
        Told how much of it was read, 0 to 1.

    Raises
    ------
    UnusualError
        When it must be read as a whole; what was yielded is worth nothing then.
    BagError, DataError, ConfigurationError
        See :func:`~drive_id.files.read.reader.read_recording`.
    """
    with printable_errors(), open_bag(path) as bag:
        topics = find_topics(bag, signals, namespace)
        data = bag.attachment(TRUTH_ATTACHMENT)
        truth = None if data is None else decode_truth(data, str(path))
        stream = SignalStream(bag, signals, topics)
        if whole or not stream.continuous:
            warnings = yield from _joined_at_once(bag, signals, topics)
        else:
            warnings = []
            with closing(prefetched(_joined(path, stream, topics, warnings, threads), _AHEAD, threads)) as pieces:
                for piece, progress in pieces:
                    yield piece
                    tell(progress)
        return BagFacts(bag.files, truth, (*bag.warnings, *warnings))


def _joined_at_once(bag: Bag, signals: SignalMap, topics: dict[str, TopicInfo]) -> Generator[Piece, None, list[str]]:
    found = extract_signals(bag, signals, topics)
    with naming(bag.path):
        result = join(found["currents"], found["voltages"], found["resolver"], found.get("reference"))
    yield Piece(result.samples, False)
    return list(result.report.warnings)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Say in errors of the samples which bag they are of."""
    try:
        yield
    except DataError as error:
        raise type(error)(f"In {path}: {error}") from error


def _joined(
    path: Path, stream: SignalStream, topics: dict[str, TopicInfo], warnings: list[str], threads: bool
) -> Generator[tuple[Piece, float], None, None]:
    """Yield joined samples, and how much of the bag was read for them; at the end, add the warnings."""
    names = (topics["currents"].name, topics["voltages"].name, topics["resolver"].name)
    references = _References()
    joining = StreamJoin(
        names, batch=2 * CAPACITY, capacity=CAPACITY, locking=_LOCKING_PAIRS, recorded=True, reference=references.at
    )
    before: Part | None = None
    with closing(prefetched(stream.parts(), _AHEAD, threads)) as parts:
        for part in parts:
            references.add(part)  # a part ahead: those for the samples at its beginning may stand behind them
            if before is not None:
                yield from ((piece, before.progress) for piece in _advanced(path, joining, before))
            before = part
    if before is not None:
        yield from ((piece, 1.0) for piece in _advanced(path, joining, before))
    end, rest = joining.finished()
    yield from ((piece, 1.0) for piece in rest)
    with naming(path):
        end.check()
    warnings.extend(end.report().warnings)


def _advanced(path: Path, joining: StreamJoin, part: Part) -> list[Piece]:
    for number, section in enumerate(REQUIRED):
        if section in part.signals:
            joining.add(number, part.signals[section])
    with naming(path):
        pieces = joining.advance()
        if joining.failing:
            joining.finished()[0].check()
    if joining.late:
        raise UnusualError
    return pieces


class _References:
    """The current references, where there are any."""

    def __init__(self) -> None:
        self._held: HeldReferences | None = None

    def add(self, part: Part) -> None:
        signal = part.signals.get("reference")
        if signal is None:
            return
        if self._held is None:
            if signal.sample_period is None:
                raise UnusualError
            self._held = HeldReferences(signal.sample_period)
        self._held.add(signal)

    def at(self, stamp: IntArray, period: float) -> FloatArray | None:
        return None if self._held is None else self._held.at(stamp, period)


def prefetched(items: Generator[Item, None, None], ahead: int, threads: bool = True) -> Generator[Item, None, None]:
    """Yield the items, which another thread gets meanwhile, up to so many of them ahead.

    What it raises is raised here. Close it to end the thread; without ``threads`` there is none.
    """
    return _prefetched(items, ahead) if threads else items


def _prefetched(items: Generator[Item, None, None], ahead: int) -> Generator[Item, None, None]:
    waiting: queue.Queue[tuple[Item | None, BaseException | None]] = queue.Queue(ahead)
    closed = threading.Event()

    def put(item: Item | None, error: BaseException | None = None) -> bool:
        while not closed.is_set():
            try:
                waiting.put((item, error), timeout=_WAIT)
            except queue.Full:
                continue
            return True
        return False

    def work() -> None:
        try:
            for item in items:
                if not put(item):
                    return
            put(None)
        except BaseException as error:  # noqa: BLE001  # whatever it is, it is raised where the items are used
            put(None, error)
        finally:
            items.close()

    thread = threading.Thread(target=work, name="reader", daemon=True)
    thread.start()
    try:
        while True:
            item, error = waiting.get()
            if error is not None:
                raise error
            if item is None:
                return
            yield item
    finally:
        closed.set()
        thread.join()
