"""The signals of a bag, part by part, in the order in which they were recorded and in bounded memory."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np

from drive_id.core.signals.signal import Signal
from drive_id.files.messages.block_kernel import DAMAGED, SAMPLES, SECTION, UNUSUAL, read_blocks
from drive_id.files.messages.message_reader import Piece, Reader, block_columns, message_reader
from drive_id.files.messages.messages import BLOCK_FIELDS
from drive_id.files.messages.signals_file import RotorSource, SignalMap
from drive_id.files.read.extraction import SignalBuilder, empty_error, read_piece, read_pieces, readable_sources
from drive_id.files.storage.bag import Bag
from drive_id.files.storage.container import RawMessage, TopicInfo
from drive_id.files.storage.mcap import MESSAGE, RECORD, McapStorage, PlainChunk

PART_BYTES = 1 << 21
"""Unpacked records worked on at a time, bytes."""
PART_SAMPLES = 1 << 15
"""Samples of the currents worked on at a time where messages are read one by one."""
_LEAST_MESSAGE = RECORD.size + MESSAGE.size


class UnusualError(Exception):
    """The bag cannot be read part by part, or only message by message."""


@dataclass(frozen=True)
class Part:
    """What was read of the signals.

    Parameters
    ----------
    signals : dict of str to Signal
        By section of the signal map; those without a sample in this part are missing.
    progress : float
        How much of the bag was read by then, 0 to 1.
    """

    signals: dict[str, Signal]
    progress: float


class SignalStream:
    """Reads the signals of one drive from an open bag.

    Parameters
    ----------
    bag : Bag
    signals : SignalMap
    topics : dict
        Section of the signal map to its topic in the bag.

    Raises
    ------
    MessageTypeError, EmptyTopicError
    """

    def __init__(self, bag: Bag, signals: SignalMap, topics: dict[str, TopicInfo]) -> None:
        self._bag = bag
        self._topics = topics
        self._sources = readable_sources(bag, signals, topics)
        self._builders = {
            section: SignalBuilder(topics[section].name, section, source) for section, source in self._sources.items()
        }
        self._readers: dict[str, list[tuple[str, Reader]]] = defaultdict(list)
        self._columns: list[list[int]] = []
        for section, source in self._sources.items():
            self._readers[topics[section].name].append((section, message_reader(topics[section], source, signals)))
            self._columns.append(block_columns(topics[section], source, signals) or [])

    @property
    def ours(self) -> bool:
        """Whether all signals stand in blocks of our own messages, in MCAP files."""
        apart = len(self._readers) == len(self._sources)
        mcap = all(isinstance(storage, McapStorage) for storage in self._bag.storages)
        return apart and mcap and all(self._columns)

    @property
    def continuous(self) -> bool:
        """Whether each part says by itself which period its samples have, and each sample its speed."""
        resolver = self._sources["resolver"]
        speed = isinstance(resolver, RotorSource) and bool(resolver.speed)
        return speed and all(source.sample_period is not None for source in self._sources.values())

    def parts(self) -> Generator[Part, None, None]:
        """Yield the signals part by part; what :func:`~drive_id.files.read.extraction.extract_signals` raises.

        Raises
        ------
        UnusualError
            When blocks of our own messages are packed in a way that the quick reader does not know.
        """
        seen: set[str] = set()
        for part in self._chunk_parts() if self.ours else self._message_parts():
            seen.update(part.signals)
            yield part
        for section in self._sources:
            if section not in seen:
                raise empty_error(self._bag, self._topics[section].name)

    def _message_parts(self) -> Iterator[Part]:
        """Read messages one by one."""
        pieces: dict[str, list[Piece]] = defaultdict(list)
        count = 0
        for section, piece in read_pieces(self._bag, self._readers, self._topics):
            pieces[section].append(piece)
            if section == "currents":
                count += len(piece.columns[0])
            if count >= PART_SAMPLES:
                yield self._built(pieces)
                pieces, count = defaultdict(list), 0
        yield self._built(pieces)

    def _built(self, pieces: dict[str, list[Piece]]) -> Part:
        with np.errstate(invalid="ignore", over="ignore"):  # the join names values that are not finite
            signals = {section: self._builders[section].build(found) for section, found in pieces.items()}
        return Part(signals, self._progress())

    def _progress(self) -> float:
        shares = [getattr(storage, "progress", 0.0) for storage in self._bag.storages]
        return sum(shares) / max(len(shares), 1)

    def _chunk_parts(self) -> Iterator[Part]:
        """Read blocks of our own messages straight from the chunks of MCAP files."""
        found: Counter[str] = Counter()
        for storage in self._bag.storages:
            assert isinstance(storage, McapStorage)
            channels = storage.channels(self._readers)
            counts: Counter[int] = Counter()
            chunks: list[PlainChunk] = []
            size = 0
            for chunk in storage.chunks(channels):
                chunks.append(chunk)
                size += len(chunk.data)
                if size >= PART_BYTES:
                    yield self._read(storage, channels, chunks, counts)
                    chunks, size = [], 0
            yield self._read(storage, channels, chunks, counts)
            storage.check_counts(channels, counts)
            for key, topic in channels.items():
                found[topic] += counts[key]
        self._bag.check_counts(frozenset(self._readers), found)

    def _read(
        self, storage: McapStorage, channels: dict[int, str], chunks: list[PlainChunk], counts: Counter[int]
    ) -> Part:
        data = np.frombuffer(b"".join(chunk.data for chunk in chunks), np.uint8)
        sections = np.full(1 << 16, -1, np.int64)
        names = list(self._sources)
        for key, topic in channels.items():
            sections[key] = names.index(self._readers[topic][0][0])
        fields = np.array([len(BLOCK_FIELDS[self._topics[section].type_name]) for section in names], np.int64)
        table = np.empty((len(data) // _LEAST_MESSAGE + 1, 6), np.int64)
        periods = np.empty(len(table))
        count = start = 0
        found = np.zeros(len(sections), np.int64)
        for chunk in chunks:
            stop, room = start + len(chunk.data), slice(count, None)
            end, more, position = read_blocks(data, start, stop, sections, fields, table[room], periods[room], found)
            if end == DAMAGED:
                storage.refuse(chunk)
            if end == UNUSUAL:
                self._refuse(channels, chunk.data, position - start)
            count += more
            start = stop
        table, periods = table[:count], periods[:count]
        for key in channels:
            counts[key] += int(found[key])
        signals = {}
        for number, section in enumerate(names):
            own = (table[:, SECTION] == number) & (table[:, SAMPLES] > 0)
            if own.any():
                build = self._builders[section].build_blocks
                signals[section] = build(data, table[own], periods[own], self._columns[number])
        return Part(signals, self._progress())

    def _refuse(self, channels: dict[int, str], data: bytes, position: int) -> None:
        """Raise what is wrong with the message at a position of a chunk, or that it is good but unusual."""
        body = position + RECORD.size
        length = RECORD.unpack_from(data, position)[1]
        channel, _, log_time, _ = MESSAGE.unpack_from(data, body)
        topic = channels[channel]
        message = RawMessage(topic, log_time, memoryview(data)[body + MESSAGE.size : body + length])
        ((section, reader),) = self._readers[topic]
        read_piece(self._bag, self._bag.decompressed(message), reader, self._topics[section])
        raise UnusualError
