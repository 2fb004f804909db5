"""Messages of a bag to signals: all pieces of a topic put together, in SI units."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np

from drive_id.core.signals.signal import Signal
from drive_id.errors import EmptyTopicError, MessageTypeError, SamplePeriodError
from drive_id.files.messages.block_kernel import FIRST, LOGGED, SAMPLES, STAMP, ByteArray, copy_blocks
from drive_id.files.messages.message_reader import DECODE_ERRORS, STAMP_LIMIT, Piece, Reader, message_reader
from drive_id.files.messages.signals_file import PhaseSource, ReferenceSource, RotorSource, SignalMap, TimeSource
from drive_id.files.storage.bag import Bag
from drive_id.files.storage.container import RawMessage, TopicInfo
from drive_id.types import FloatArray, IntArray

_LONGEST_PERIOD = 1e4
_SAME_PERIOD = 1e-6


def extract_signals(bag: Bag, signals: SignalMap, topics: dict[str, TopicInfo]) -> dict[str, Signal]:
    """Read the signals of a drive from a bag in one pass.

    Parameters
    ----------
    bag : Bag
    signals : SignalMap
    topics : dict
        Section of the signal map (``currents``, ...) to its topic in the bag.

    Returns
    -------
    dict
        Section to signal, in SI units; the reference only when its topic is there.

    Raises
    ------
    MessageTypeError
        When a topic is of a type, or lacks a field, from which the signal cannot be read.
    EmptyTopicError
        When a topic holds no sample.
    SamplePeriodError
        When the declared period of a topic changes, is no time, or is missing where it is needed.
    BagError
        When the bag is damaged, or holds other than the declared number of messages.
    """
    sources = readable_sources(bag, signals, topics)
    readers: dict[str, list[tuple[str, Reader]]] = defaultdict(list)
    for section, source in sources.items():
        readers[topics[section].name].append((section, message_reader(topics[section], source, signals)))
    pieces: dict[str, list[Piece]] = defaultdict(list)
    with np.errstate(invalid="ignore", over="ignore"):  # join names values that are not finite
        for section, piece in read_pieces(bag, readers, topics):
            pieces[section].append(piece)
        return _all_assembled(bag, pieces, sources, topics)


def readable_sources(bag: Bag, signals: SignalMap, topics: dict[str, TopicInfo]) -> dict[str, TimeSource]:
    """Return where the signals come from that are in the bag; EmptyTopicError when a topic of them is empty."""
    sources = {section: source for section, source in signals.sources().items() if section in topics}
    for section in sources:
        if topics[section].count == 0:
            raise empty_error(bag, topics[section].name)
    return sources


def read_pieces(
    bag: Bag, readers: dict[str, list[tuple[str, Reader]]], topics: dict[str, TopicInfo]
) -> Iterator[tuple[str, Piece]]:
    """Yield section and piece for each message of the topics, empty ones aside, in order of arrival."""
    for message in bag.messages(frozenset(readers)):
        for section, reader in readers[message.topic]:
            piece = read_piece(bag, message, reader, topics[section])
            if len(piece.columns[0]):
                yield section, piece


def read_piece(bag: Bag, message: RawMessage, reader: Reader, topic: TopicInfo) -> Piece:
    """Read one message; MessageTypeError when it is not what its type says."""
    try:
        return reader(message)
    except DECODE_ERRORS as error:
        raise MessageTypeError(
            f"A message on {message.topic} of {bag.path}, logged at {message.log_time} ns, cannot be read as "
            f"{topic.type_name} ({_said(error)}): name the right fields in a signals file."
        ) from error


def _all_assembled(
    bag: Bag, pieces: dict[str, list[Piece]], sources: dict[str, TimeSource], topics: dict[str, TopicInfo]
) -> dict[str, Signal]:
    found = {}
    for section, source in sources.items():
        if not pieces[section]:
            raise empty_error(bag, topics[section].name)
        found[section] = SignalBuilder(topics[section].name, section, source).build(pieces[section])
    return found


def empty_error(bag: Bag, topic: str) -> EmptyTopicError:
    """Return the error for a topic without a sample."""
    return EmptyTopicError(f"{topic} in {bag.path} holds no sample: record again while the drive publishes it.")


def _said(error: BaseException) -> str:
    return (str(error) or type(error).__name__).split("\n")[0][:200]


class SignalBuilder:
    """Puts the pieces of one signal together, in order of arrival, all at once or some at a time.

    Parameters
    ----------
    topic : str
    section : str
        Of the signal map.
    source : TimeSource
    """

    def __init__(self, topic: str, section: str, source: TimeSource) -> None:
        self.topic = topic
        self.section = section
        self.source = source
        self.period: float | None = None
        """As declared by the first piece, s."""
        self._begun = False
        self._expected: int | None = None

    def build(self, pieces: list[Piece]) -> Signal:
        """Return the next pieces, at least one, as a signal.

        Raises
        ------
        MessageTypeError, SamplePeriodError
        """
        count = np.array([len(piece.columns[0]) for piece in pieces])
        start = np.concatenate(([0], np.cumsum(count)[:-1]))
        self._check_periods(pieces)
        period = self.period
        if all(isinstance(piece.stamp, int) for piece in pieces):
            each = [int(piece.stamp) for piece in pieces]
            self._check_time(min(each), max(each))
            stamp = np.repeat(np.array(each, np.int64), count)
            if count.max() > 1:
                period = self._block_period(int(count.max()))
                within = np.arange(len(stamp)) - np.repeat(start, count)
                stamp = stamp + np.rint(within * (period * 1e9)).astype(np.int64)
            block_start = start
        else:
            stamp = np.concatenate([np.atleast_1d(np.asarray(piece.stamp, np.int64)) for piece in pieces])
            block_start = np.arange(len(stamp))
        columns = [
            np.concatenate([piece.columns[k] for piece in pieces]).astype(np.float64)
            for k in range(len(pieces[0].columns))
        ]
        counts = [piece.first_sample for piece in pieces]
        known = [first for first in counts if first is not None]
        lost = self._losses(known, count) if len(known) == len(counts) else (0, 0)
        return self._signal(stamp, _in_si_units(columns, self.source), block_start, lost)

    def build_blocks(self, data: ByteArray, table: IntArray, periods: FloatArray, columns: list[int]) -> Signal:
        """Return blocks of our own messages, at least one and none of them empty, as a signal.

        Parameters
        ----------
        data, table, periods
            See :func:`~drive_id.files.messages.block_kernel.read_blocks`.
        columns : list of int
            Which of the arrays to take.

        Raises
        ------
        MessageTypeError, SamplePeriodError
        """
        logged = self.source.stamp == "log_time"
        each, count = table[:, LOGGED if logged else STAMP], table[:, SAMPLES]
        declared = self.period if self._begun else float(periods[0])
        usual = (periods > 0.0) & (periods < _LONGEST_PERIOD)
        usual &= np.abs(periods - (declared or 0.0)) <= _SAME_PERIOD * (declared or 0.0)
        if not usual.all():
            self._begin(declared)
            k = int(np.argmin(usual))
            self._check_period(float(periods[k]), int(each[k]))
        self._begin(declared)
        self._check_time(int(each.min()), int(each.max()))
        self._block_period(int(count.max()))
        stamp, values = np.empty(count.sum(), np.int64), np.empty((count.sum(), len(columns)))
        own = np.full(len(table), declared)
        copy_blocks(data, table, np.array(columns, np.int64), own, logged, stamp, values)
        if not _plain(self.source):
            values = _in_si_units(list(values.T), self.source)
        start = np.concatenate(([0], np.cumsum(count)[:-1]))
        return self._signal(stamp, values, start, self._losses(table[:, FIRST], count))

    def _signal(self, stamp: IntArray, values: FloatArray, block_start: IntArray, lost: tuple[int, int]) -> Signal:
        offset = int(np.rint(self.source.stamp_offset * 1e9))
        if offset:
            stamp += offset
        self._check_time(int(stamp.min()), int(stamp.max()))
        return Signal(self.topic, stamp, values, self.period, block_start, *lost)

    def _check_time(self, earliest: int, latest: int) -> None:
        for stamp in (earliest, latest):
            if abs(stamp) >= STAMP_LIMIT:
                raise MessageTypeError(
                    f"A stamp of {self.topic} is {stamp} ns, beyond all clocks: give the right stamp and stamp_unit."
                )

    def _block_period(self, largest: int) -> float:
        """Return the declared period, s, of messages of up to so many samples."""
        if self.period is None:
            raise SamplePeriodError(
                f"Messages on {self.topic} hold up to {largest} samples: give their sample_period in section "
                f"'{self.section}' of the signals file."
            )
        if self.period * largest * 1e9 > STAMP_LIMIT:
            raise SamplePeriodError(
                f"A message on {self.topic} would last {self.period * largest} s: correct its sample_period."
            )
        return self.period

    def _begin(self, period: float | None) -> None:
        if not self._begun:
            self.period, self._begun = period, True

    def _check_periods(self, pieces: list[Piece]) -> None:
        """Check the period that all messages declare, s."""
        self._begin(pieces[0].sample_period)
        for piece in pieces:
            if piece.sample_period is not None and self.period is not None:
                self._check_period(piece.sample_period, piece.stamp)

    def _check_period(self, period: float, stamp: int | IntArray) -> None:
        if not 0.0 < period < _LONGEST_PERIOD:
            raise SamplePeriodError(
                f"A message on {self.topic} stamped {stamp} ns declares a sample period of {period} s: correct its "
                "publisher, or give the period in a signals file."
            )
        declared = self.period or period
        if abs(period - declared) > _SAME_PERIOD * declared:
            raise SamplePeriodError(
                f"The sample period of {self.topic} changes from {declared} to {period} s at stamp {stamp} ns: "
                "record each rate in a bag of its own."
            )

    def _losses(self, first: Sequence[int] | IntArray, count: IntArray) -> tuple[int, int]:
        """Count samples missing by the messages' own count, and the places; a count that starts again is no loss."""
        begin = np.array(first, object) if isinstance(first, list) else first
        due = begin + count
        before = np.append(begin[0] if self._expected is None else self._expected, due[:-1])
        missing = np.maximum(begin - before, 0)
        self._expected = int(due[-1])
        return int(missing.sum()), int((missing > 0).sum())


def _plain(source: TimeSource) -> bool:
    """Tell whether the fields of a source are in SI units and electrical radians already."""
    if isinstance(source, PhaseSource):
        return len(source.fields) == 3 and set(source.factors) == {1.0}
    if isinstance(source, RotorSource):
        return (source.angle_factor, source.angle_offset, source.speed_factor) == (1.0, 0.0, 1.0)
    return isinstance(source, ReferenceSource) and source.scale == 1.0


def _in_si_units(columns: list[FloatArray], source: TimeSource) -> FloatArray:
    """Return the values (N, K) in SI units and electrical radians."""
    if isinstance(source, PhaseSource):
        phases = [column * factor for column, factor in zip(columns, source.factors, strict=True)]
        return np.column_stack(phases if len(phases) == 3 else [*phases, -phases[0] - phases[1]])
    if isinstance(source, RotorSource):
        scaled = [columns[0] * source.angle_factor + source.angle_offset]
        return np.column_stack([*scaled, *(column * source.speed_factor for column in columns[1:])])
    assert isinstance(source, ReferenceSource)
    return np.column_stack(columns) * source.scale
