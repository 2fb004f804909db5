"""Messages of a bag to signals in SI units: all at once, or part by part in bounded memory."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.common.messages import Message
from drive_id.common.quantity import counted
from drive_id.core.signals.equal_spacing import EqualSpacing, equal_spacing
from drive_id.core.signals.join import SECTIONS
from drive_id.core.signals.signal import SampleCount, Signal
from drive_id.errors import BagError, EmptyTopicError, MessageTypeError, SamplePeriodError
from drive_id.files.messages.block_codec import LONGEST_PERIOD, read_head
from drive_id.files.messages.message_reader import (
    DECODE_ERRORS,
    STAMP_LIMIT,
    BlocksReader,
    MessageSamples,
    Reader,
    blocks_reader,
    message_reader,
)
from drive_id.files.messages.messages import BLOCK_FIELDS
from drive_id.files.messages.signal_sources import VOLTAGE_SCALE, SignalMap, TimeSource
from drive_id.files.read.memory import MemoryGuard
from drive_id.files.storage.bag import Bag
from drive_id.files.storage.container import RawMessage, TopicInfo
from drive_id.types import SCALARS, FloatArray, IntArray

PART_SAMPLES = 1 << 15
"""Size of a part, samples of the currents."""
_AT_ONCE = 1 << 14
"""Messages that are decoded at once: more of them, of one sample each, take memory and save nothing."""
_SAME_PERIOD = 1e-6  # relative difference up to which two declared periods are the same
INTERPOLATED = (*SCALARS, VOLTAGE_SCALE)
"""Sections of any rate, which may begin late and have gaps."""


class UnusualError(Exception):
    """The bag cannot be read part by part: read it as a whole."""


class DividedError(Exception):
    """The drive was restarted or exchanged within the bag: read each of its parts by itself."""


SignalPart = dict[str, Signal]
"""One part of the signals, by section, those without a sample in it missing."""


class LogSignals:
    """The signals of one drive in an open log; its kinds say how the samples are read.

    ``sources``, and ``topics`` or what stands for them, are by section of the signal map; ``required`` must hold
    samples. With ``blanks``, a row in which a value of a signal is missing is a missing sample.
    """

    def __init__(
        self,
        path: Path,
        signals: SignalMap,
        sources: dict[str, TimeSource],
        topics: dict[str, TopicInfo],
        required: Iterable[str],
        *,
        blanks: bool = False,
    ) -> None:
        self._path = path
        self._signals = signals
        self._sources = sources
        self.topics = topics
        self._required = [section for section in required if section not in INTERPOLATED]
        self._builders = {
            section: SignalBuilder(topics[section].name, section, source, blanks=blanks)
            for section, source in sources.items()
        }

    @property
    def divided(self) -> bool:
        """Whether what has been read is of several drives."""
        return False

    @property
    def continuous(self) -> bool:
        """Whether every part is complete by itself: all sample periods are declared and the speed is recorded."""
        required = (source for name, source in self._sources.items() if name not in INTERPOLATED)
        declared = all(source.sample_period is not None for source in required)
        return bool(self._signals.resolver.own_speed) and declared and not self._signals.at_once

    def whole(self, tell: Callable[[float], None] = lambda _: None) -> SignalPart:
        """Return the complete signals by section, in SI units; reference and optional signals only if they are there.

        ``tell`` is called with the part of the log that has been read, 0 to 1.

        Raises MessageTypeError when a signal cannot be read from the type or fields of its topic, EmptyTopicError when
        a topic holds no sample, SamplePeriodError when its declared period changes, is not positive, or is missing
        where it is needed, BagError when the bag is damaged, or holds more or fewer messages than declared.
        """
        pieces: dict[str, list[MessageSamples]] = defaultdict(list)
        guard = MemoryGuard(self._path)
        for section, piece in self._pieces():
            pieces[section].append(piece)
            if section == "currents":
                guard.add(len(piece.columns[0]), self.progress())
                tell(self.progress())
        self._refuse_empty(pieces)
        return self._built({section: pieces[section] for section in self._sources if section in pieces})

    def parts(self) -> Generator[SignalPart, None, None]:
        """Yield the signals part by part; for the errors, see :meth:`whole`."""
        seen: set[str] = set()
        pieces: dict[str, list[MessageSamples]] = defaultdict(list)
        count = 0
        for section, piece in self._pieces():
            seen.add(section)
            pieces[section].append(piece)
            if section == "currents":
                count += len(piece.columns[0])
            if count >= PART_SAMPLES:
                yield self._built(pieces)
                pieces, count = defaultdict(list), 0
        yield self._built(pieces)
        self._refuse_empty(seen)

    def remarks(self) -> tuple[Message, ...]:
        """Return how the time of the signals was found, and what is missing in them; after all has been read."""
        found: dict[tuple[str, str], Message] = {}
        for builder in self._builders.values():
            spacing, topic = builder.spacing, builder.topic
            if spacing is not None:
                said = Message(
                    "equally_spaced",
                    topic=topic,
                    period=spacing.period,
                    jitter=spacing.jitter,
                    missing=spacing.missing or None,
                    gaps=spacing.gaps,
                    counted=bool(builder.source.first_sample),
                    unseen=spacing.least - 1 if builder.period is None and spacing.least > 1 else None,
                )
                found.setdefault((said.code, topic), said)
            if builder.blank:
                said = Message("values_missing", samples=builder.blank, topic=topic)
                found.setdefault((said.code, topic), said)
        return tuple(found.values())

    def _refuse_empty(self, seen: Collection[str]) -> None:
        for section in self._required:
            if section not in seen:
                raise EmptyTopicError(
                    f"{self.topics[section].name} in {self._path} holds no sample: record again while the drive "
                    "publishes it, or name another source in a signals file."
                )

    def _built(self, pieces: dict[str, list[MessageSamples]]) -> SignalPart:
        with np.errstate(invalid="ignore", over="ignore"):  # the join reports values that are not finite
            return {section: self._builders[section].build(found) for section, found in pieces.items()}

    def _pieces(self) -> Iterator[tuple[str, MessageSamples]]:
        """Yield section and piece for whatever is read at once, if it holds samples, in order of arrival."""
        raise NotImplementedError

    def progress(self) -> float:
        """Return the part of the log that has been read, 0 to 1."""
        raise NotImplementedError


class SignalStream(LogSignals):
    """The signals of one drive in an open bag, whose ``topics`` are given by section of the signal map.

    Of the messages on the topics of currents, voltages and resolver, only those of the numbers in ``part`` are read;
    None: all.

    Raises MessageTypeError or EmptyTopicError, see :meth:`whole`.
    """

    def __init__(self, bag: Bag, signals: SignalMap, topics: dict[str, TopicInfo], part: range | None = None) -> None:
        sources = {section: source for section, source in signals.sources().items() if section in topics}
        super().__init__(bag.path, signals, sources, topics, sources)
        self._bag = bag
        self._part = part
        self._feedback = {topics[section].name for section in SECTIONS if section in topics}
        self._refuse_empty({section for section in sources if topics[section].count != 0})
        self._readers: dict[str, list[tuple[str, Reader]]] = defaultdict(list)
        self._of_blocks: dict[str, tuple[str, BlocksReader]] = {}  # by section
        for section, source in sources.items():
            given = topics[section], source, signals
            self._readers[given[0].name].append((section, message_reader(*given)))
            if reader := blocks_reader(*given):
                self._of_blocks[section] = given[0].name, reader

    @property
    def divided(self) -> bool:
        """Whether what has been read of a whole bag is of several drives, or of one before and after a restart."""
        return self._part is None and any(self._builders[section].divided for section in SECTIONS)

    def _pieces(self) -> Iterator[tuple[str, MessageSamples]]:
        messages = self._chosen(self._bag.messages(frozenset(self._readers)))
        if len(self._of_blocks) < len(self._sources):
            yield from self._one_by_one(messages)
            return
        for batch in self._batches(messages):
            found = self._at_once(batch)
            yield from self._one_by_one(batch) if found is None else found

    def _batches(self, messages: Iterator[RawMessage]) -> Iterator[list[RawMessage]]:
        """Yield messages by the part, also those before a damage."""
        clock = self.topics.get("currents") or next(iter(self.topics.values()))  # where only references are read
        row = 4 * len(BLOCK_FIELDS[clock.type_name])
        batch: list[RawMessage] = []
        besides: int | None = None
        left = PART_SAMPLES
        try:
            for message in messages:
                batch.append(message)
                if message.topic == clock.name:
                    besides = _bytes_besides(message.data, row) if besides is None else besides
                    left -= (len(message.data) - besides) // row
                if left <= 0 or len(batch) == _AT_ONCE:
                    yield batch
                    batch, left = [], left if left > 0 else PART_SAMPLES
        except BagError:
            yield batch
            raise
        yield batch

    def _at_once(self, batch: list[RawMessage]) -> list[tuple[str, MessageSamples]] | None:
        """Return the pieces of messages, the currents last, which complete a part; None where one is unusual."""
        of_topic: dict[str, list[bytes | memoryview]] = defaultdict(list)
        for message in batch:
            of_topic[message.topic].append(message.data)
        found = []
        for section, (topic, reader) in self._of_blocks.items():
            if messages := of_topic.get(topic):
                piece = reader(messages)
                if piece is None:
                    return None
                found.append((section, piece))
        return sorted(found, key=lambda entry: entry[0] == "currents")

    def _one_by_one(self, messages: Iterable[RawMessage]) -> Iterator[tuple[str, MessageSamples]]:
        for message in messages:
            for section, reader in self._readers[message.topic]:
                try:
                    piece = reader(message)
                except DECODE_ERRORS as error:
                    said = (str(error) or type(error).__name__).split("\n")[0][:200]
                    raise MessageTypeError(
                        f"A message on {message.topic} of {self._path}, logged at {message.log_time} ns, cannot be "
                        f"read as {self.topics[section].type_name} ({said}): name the right fields in a signals file."
                    ) from error
                if len(piece.columns[0]):
                    yield section, piece

    def _chosen(self, messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
        if self._part is None:
            yield from messages
            return
        number = 0
        for message in messages:
            if number in self._part:
                yield message
            number += message.topic in self._feedback

    def progress(self) -> float:  # noqa: D102  # as in LogSignals
        return sum(storage.progress for storage in self._bag.storages) / max(len(self._bag.storages), 1)


class SignalBuilder:
    """Puts the pieces of one signal together in order of arrival, all at once or part by part."""

    def __init__(self, topic: str, section: str, source: TimeSource, *, blanks: bool = False) -> None:
        self.topic = topic
        self.section = section
        self.source = source
        self.period: float | None = None
        """As declared by the first piece, s."""
        self.spacing: EqualSpacing | None = None
        """Of equally spaced samples, once built."""
        self.blank = 0
        """Samples left out because a value is missing."""
        self._blanks = blanks
        self.divided = False
        """Whether the messages are of several drives, or of one before and after a restart, by count and frame_id."""
        self._frame: str | None = None
        self._begun = False
        self._count = SampleCount()
        self._read = 0
        self._last_stamp: int | None = None
        self._last_angle: float | None = None

    def build(self, pieces: list[MessageSamples]) -> Signal:
        """Return the next pieces, one or more, as a signal; raises MessageTypeError, SamplePeriodError."""
        count = _put_together([len(piece.columns[0]) if piece.samples is None else piece.samples for piece in pieces])
        self._check_periods(pieces)
        whole = [piece.stamp for piece in pieces if isinstance(piece.stamp, int)]
        self._check_time(min(whole, default=0), max(whole, default=0))
        stamp = _put_together([piece.stamp for piece in pieces])
        first = _counts(pieces)
        if len(stamp) > len(count) or (first is not None and len(first) > len(count)):
            count = np.ones(int(count.sum()), np.int64)
            first = first if first is None or len(first) == len(count) else None
        lost, losses = self._count.lost, self._count.losses
        if first is not None:
            self._add_counts(pieces, first, count, stamp)
        stamp, period = self._timed(stamp, first, count)
        start = np.concatenate(([0], np.cumsum(count)[:-1]))
        if count.max() > 1:
            period = self._block_period(int(count.max())) if period is None else period
            within = np.arange(int(count.sum())) - np.repeat(start, count)
            stamp = np.repeat(stamp, count) + np.rint(within * (period * 1e9)).astype(np.int64)
        columns = [
            np.concatenate([piece.columns[k] for piece in pieces]).astype(np.float64)
            for k in range(len(pieces[0].columns))
        ]
        if self._blanks:
            there = np.isfinite(columns).all(axis=0)
            if there.any() and not there.all():
                self.blank += int((~there).sum())
                stamp, columns = stamp[there], [column[there] for column in columns]
                start = np.arange(len(stamp))
        self._unwrap_angle(columns)
        values = self.source.in_si_units(columns)
        stamp += int(np.rint(self.source.stamp_offset * 1e9))
        self._check_time(int(stamp.min()), int(stamp.max()))
        lost, losses = self._count.lost - lost, self._count.losses - losses  # late blocks undo losses
        return Signal(self.topic, stamp, values, period, start, lost, losses)

    def _add_counts(self, pieces: list[MessageSamples], first: NDArray[Any], count: IntArray, stamp: IntArray) -> None:
        """Count messages; only the counts of our own are those of a drive, whatever those of others start again for."""
        frames = {piece.frame for piece in pieces}
        if None in frames or len(stamp) != len(first):
            self._count.add_blocks(first, count)
            return
        restarts = self._count.restarts
        self._count.add_blocks(first, count, stamp, self.period or 0.0)
        self._frame = pieces[0].frame if self._frame is None else self._frame
        self.divided |= self._count.restarts > restarts or frames != {self._frame}

    def _timed(self, stamp: IntArray, first: NDArray[Any] | None, count: IntArray) -> tuple[IntArray, float | None]:
        """Return stamps of messages (B,), ns, as the source says how to take them, and the period, s, if known."""
        source = self.source
        if source.stamp_bits is not None:
            modulus = round(2.0**source.stamp_bits * source.tick)
            stamp = _unwrapped(stamp, modulus, self._last_stamp)
            self._last_stamp = int(stamp[-1])
        if source.stamp == "index":
            period = self._block_period(int(count.max()))
            index = self._read + np.concatenate([[0], np.cumsum(count)[:-1]]) if first is None else first
            self._read += int(count.sum())
            return np.rint(index * (period * 1e9)).astype(np.int64), period
        if source.equally_spaced:
            known = None if first is None or first.dtype == object else first
            spacing = equal_spacing(stamp, count, known, self.period, self.topic)
            self.spacing = spacing
            return spacing.stamp, spacing.period
        return stamp, self.period

    def _unwrap_angle(self, columns: list[FloatArray]) -> None:
        """Make the angle of an encoder continuous that starts again at another value than whole revolutions."""
        modulus = getattr(self.source, "angle_modulus", None)
        if modulus is None or not len(columns[0]):
            return
        columns[0] = np.unwrap(columns[0], period=modulus)
        if self._last_angle is not None:
            columns[0] += modulus * np.rint((self._last_angle - columns[0][0]) / modulus)
        self._last_angle = float(columns[0][-1])

    def _check_time(self, earliest: int, latest: int) -> None:
        for stamp in (earliest, latest):
            if abs(stamp) >= STAMP_LIMIT:
                raise MessageTypeError(
                    f"A stamp of {self.topic} is {stamp} ns, out of range: give the right stamp and stamp_unit."
                )

    def _block_period(self, largest: int) -> float:
        """Return the declared period, s, of messages of up to ``largest`` samples."""
        if self.period is None:
            raise SamplePeriodError(
                f"Messages on {self.topic} hold up to {counted(largest, 'sample')}: give their sample_period in "
                f"section '{self.section}' of the signals file."
            )
        if self.period * largest * 1e9 > STAMP_LIMIT:
            raise SamplePeriodError(
                f"A message on {self.topic} would last {self.period * largest} s: correct its sample_period."
            )
        return self.period

    def _check_periods(self, pieces: list[MessageSamples]) -> None:
        if not self._begun:
            self.period, self._begun = pieces[0].sample_period, True
        first: dict[float | None, MessageSamples] = {}
        for piece in pieces:
            first.setdefault(piece.sample_period, piece)
        for period, piece in first.items():
            if period is None or self.period is None:
                continue
            if not 0.0 < period < LONGEST_PERIOD:
                raise SamplePeriodError(
                    f"A message on {self.topic} stamped {_earliest(piece)} ns declares a sample period of {period} "
                    "s: correct its publisher, or give the period in a signals file."
                )
            if abs(period - self.period) > _SAME_PERIOD * self.period:
                raise SamplePeriodError(
                    f"The sample period of {self.topic} changes from {self.period} to {period} s at stamp "
                    f"{_earliest(piece)} ns: record each rate in a bag of its own."
                )


def _counts(pieces: list[MessageSamples]) -> NDArray[Any] | None:
    """Return the running counts of the messages, or of all their samples; None unless each has one."""
    counts = [piece.first_sample for piece in pieces if piece.first_sample is not None]
    if len(counts) < len(pieces):
        return None
    whole = [abs(first) for first in counts if isinstance(first, int)]
    return _put_together(counts, np.int64 if max(whole, default=0) < STAMP_LIMIT else object)


def _put_together(found: Sequence[int | IntArray], kind: type = np.int64) -> NDArray[Any]:
    """Return numbers, and arrays of them (n,), as one array."""
    if all(isinstance(entry, int) for entry in found):
        return np.array(found, kind)
    return np.concatenate([np.atleast_1d(np.asarray(entry, kind)) for entry in found])


def _bytes_besides(data: bytes | memoryview, row: int) -> int:
    """Return the bytes of a block besides its samples, of ``row`` bytes each; all if it is none."""
    try:
        return len(data) - row * read_head(data).samples
    except ValueError:
        return len(data)


def _earliest(piece: MessageSamples) -> int:
    """Return the stamp of a message, ns: its first one, or that of the first of several blocks."""
    return int(np.min(piece.stamp) if piece.samples is None else np.ravel(piece.stamp)[0])


def _unwrapped(stamp: IntArray, modulus: int, before: int | None) -> IntArray:
    """Return a time that starts again at zero, ns, as one that goes on; ``before`` is the last one so far."""
    ahead = np.diff(stamp, prepend=stamp[0] if before is None else before)
    rounds = np.cumsum(-np.floor_divide(ahead + modulus // 2, modulus))
    return np.asarray(stamp + rounds * modulus, np.int64)
