"""Messages of a bag to signals: all pieces of a topic put together, in SI units."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from drive_id.core.signal import Signal
from drive_id.errors import EmptyTopicError, MessageTypeError, SamplePeriodError
from drive_id.files.bag import Bag
from drive_id.files.bag_storage import TopicInfo
from drive_id.files.message_reader import DECODE_ERRORS, STAMP_LIMIT, Piece, Reader, message_reader
from drive_id.files.signals import PhaseSource, ReferenceSource, RotorSource, SignalMap, TimeSource
from drive_id.types import FloatArray

_LONGEST_PERIOD = 1e4


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
    sources = {section: source for section, source in signals.sources().items() if section in topics}
    for section in sources:
        if topics[section].count == 0:
            raise _empty(bag, topics[section].name)
    readers: dict[str, list[tuple[str, Reader]]] = defaultdict(list)
    for section, source in sources.items():
        readers[topics[section].name].append((section, message_reader(topics[section], source, signals)))
    with np.errstate(invalid="ignore", over="ignore"):  # join names values that are not finite
        pieces = _read_pieces(bag, readers, topics)
        return _all_assembled(bag, pieces, sources, topics)


def _read_pieces(
    bag: Bag, readers: dict[str, list[tuple[str, Reader]]], topics: dict[str, TopicInfo]
) -> dict[str, list[Piece]]:
    pieces: dict[str, list[Piece]] = defaultdict(list)
    for message in bag.messages(frozenset(readers)):
        for section, reader in readers[message.topic]:
            try:
                piece = reader(message)
            except DECODE_ERRORS as error:
                raise MessageTypeError(
                    f"A message on {message.topic} of {bag.path}, logged at {message.log_time} ns, cannot be read as "
                    f"{topics[section].type_name} ({_said(error)}): name the right fields in a signals file."
                ) from error
            if len(piece.columns[0]):
                pieces[section].append(piece)
    return pieces


def _all_assembled(
    bag: Bag, pieces: dict[str, list[Piece]], sources: dict[str, TimeSource], topics: dict[str, TopicInfo]
) -> dict[str, Signal]:
    found = {}
    for section, source in sources.items():
        if not pieces[section]:
            raise _empty(bag, topics[section].name)
        found[section] = _assembled(topics[section].name, section, pieces[section], source)
    return found


def _empty(bag: Bag, topic: str) -> EmptyTopicError:
    return EmptyTopicError(f"{topic} in {bag.path} holds no sample: record again while the drive publishes it.")


def _said(error: BaseException) -> str:
    return (str(error) or type(error).__name__).split("\n")[0][:200]


def _assembled(topic: str, section: str, pieces: list[Piece], source: TimeSource) -> Signal:
    """Put the pieces of one signal together, in order of arrival."""
    count = np.array([len(piece.columns[0]) for piece in pieces])
    start = np.concatenate(([0], np.cumsum(count)[:-1]))
    period = _declared_period(topic, pieces)
    if all(isinstance(piece.stamp, int) for piece in pieces):
        each = [int(piece.stamp) for piece in pieces]
        _check_time(topic, min(each), max(each))
        stamp = np.repeat(np.array(each, np.int64), count)
        if count.max() > 1:
            if period is None:
                raise SamplePeriodError(
                    f"Messages on {topic} hold up to {count.max()} samples: give their sample_period in section "
                    f"'{section}' of the signals file."
                )
            if period * int(count.max()) * 1e9 > STAMP_LIMIT:
                raise SamplePeriodError(
                    f"A message on {topic} would last {period * int(count.max())} s: correct its sample_period."
                )
            within = np.arange(len(stamp)) - np.repeat(start, count)
            stamp = stamp + np.rint(within * (period * 1e9)).astype(np.int64)
        block_start = start
    else:
        stamp = np.concatenate([np.atleast_1d(np.asarray(piece.stamp, np.int64)) for piece in pieces])
        block_start = np.arange(len(stamp))
    columns = [
        np.concatenate([piece.columns[k] for piece in pieces]).astype(np.float64) for k in range(len(pieces[0].columns))
    ]
    lost, losses = _losses(pieces)
    stamp += int(np.rint(source.stamp_offset * 1e9))
    _check_time(topic, int(stamp.min()), int(stamp.max()))
    return Signal(topic, stamp, _in_si_units(columns, source), period, block_start, lost, losses)


def _check_time(topic: str, earliest: int, latest: int) -> None:
    for stamp in (earliest, latest):
        if abs(stamp) >= STAMP_LIMIT:
            raise MessageTypeError(
                f"A stamp of {topic} is {stamp} ns, beyond all clocks: give the right stamp and stamp_unit."
            )


def _declared_period(topic: str, pieces: list[Piece]) -> float | None:
    """Return the period that all messages declare, s."""
    declared = pieces[0].sample_period
    for piece in pieces:
        period = piece.sample_period
        if period is None or declared is None:
            continue
        if not 0.0 < period < _LONGEST_PERIOD:
            raise SamplePeriodError(
                f"A message on {topic} stamped {piece.stamp} ns declares a sample period of {period} s: correct its "
                "publisher, or give the period in a signals file."
            )
        if abs(period - declared) > 1e-6 * declared:
            raise SamplePeriodError(
                f"The sample period of {topic} changes from {declared} to {period} s at stamp {piece.stamp} ns: "
                "record each rate in a bag of its own."
            )
    return declared


def _losses(pieces: list[Piece]) -> tuple[int, int]:
    """Count samples missing by the messages' own count, and the places; a count that starts again is no loss."""
    lost, losses = 0, 0
    expected: int | None = None
    for piece in pieces:
        if piece.first_sample is None:
            return 0, 0
        if expected is not None and piece.first_sample > expected:
            lost, losses = lost + piece.first_sample - expected, losses + 1
        expected = piece.first_sample + len(piece.columns[0])
    return lost, losses


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
