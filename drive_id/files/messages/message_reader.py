"""Reading one message: the samples that it holds of a signal, and their time."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drive_id.common.quantity import counted
from drive_id.errors import MessageTypeError
from drive_id.files.messages.block_codec import decode_block, decode_blocks
from drive_id.files.messages.field_path import FieldPath, FieldPathError, parse_field_path
from drive_id.files.messages.messages import BLOCK_FIELDS, message_typestore, schema_text
from drive_id.files.messages.signal_sources import NAMED_STAMPS, SignalMap, TimeSource
from drive_id.files.storage.container import RawMessage, TopicInfo
from drive_id.types import IntArray

DECODE_ERRORS = (
    struct.error, ValueError, LookupError, TypeError, AssertionError, OverflowError, MemoryError, RecursionError,
)  # fmt: skip
"""What a :data:`Reader` raises when a message does not fit its type."""
_LARGEST_MESSAGE = 1 << 24
"""Bytes of a message that is read through its definition, which takes a Python object for each element."""
STAMP_LIMIT = 2**62
"""Largest stamp, ns (146 years, for clocks from 1900 or 1904): differences of larger ones could overflow."""


class MessageSamples(NamedTuple):
    """The samples of one signal in one message, or in several blocks."""

    stamp: int | IntArray  # of the first sample, of that of each block (b,), or of each sample (n,), ns
    first_sample: int | IntArray | None  # running count of the first sample, of that of each block, or of each sample
    sample_period: float | None  # s
    columns: tuple[NDArray[np.floating], ...]  # each (n,), float32 or float64
    frame: str | None = None  # frame_id of one of our messages, whose count is that of a drive
    samples: IntArray | None = None  # (b,), of each block; None: one message


Reader = Callable[[RawMessage], MessageSamples]
BlocksReader = Callable[[Sequence[bytes | memoryview]], MessageSamples | None]
"""Reads several messages at once, or returns None: a :data:`Reader` then reads each, or says what is wrong."""


def message_reader(topic: TopicInfo, source: TimeSource, signals: SignalMap) -> Reader:
    """Return the function that reads one signal from a message of a topic."""
    if topic.encoding == "cdr":
        columns = block_columns(topic, source, signals)
        if columns is not None:
            return _block_reader(columns, len(BLOCK_FIELDS[topic.type_name]), source)
    return _field_reader(decoder(topic, signals), source, source.paths)


def blocks_reader(topic: TopicInfo, source: TimeSource, signals: SignalMap) -> BlocksReader | None:
    """Return the function that reads one signal from several messages of a topic; None where they are not ours."""
    columns = block_columns(topic, source, signals)
    if columns is None or source.stamp != "header":
        return None
    fields = len(BLOCK_FIELDS[topic.type_name])

    def read(messages: Sequence[bytes | memoryview]) -> MessageSamples | None:
        found = decode_blocks(messages, fields)
        if found is None:
            return None
        chosen = tuple(found.values[k] for k in columns)
        return MessageSamples(found.stamp, found.first_sample, found.sample_period, chosen, found.frame, found.samples)

    return read


def decoder(topic: TopicInfo, signals: SignalMap) -> Callable[[bytes | memoryview], object]:
    """Return the function that decodes a message of a topic; it raises one of :data:`DECODE_ERRORS`.

    Raises MessageTypeError when the type or the encoding of the topic is not known.
    """
    name = topic.type_name
    if topic.encoding == "json":
        return lambda data: json.loads(bytes(data))
    if topic.encoding not in ("cdr", "ros1"):
        raise MessageTypeError(
            f"{topic.name} is encoded as '{topic.encoding}', not as CDR, ROS 1 or JSON: record it with ROS 2, or "
            "write its messages as JSON or CSV."
        )
    from rosbags.serde import SerdeError  # noqa: PLC0415  # not needed for bags of our own messages

    from drive_id.files.messages.message_types import typestore_for  # noqa: PLC0415  # likewise

    store = typestore_for(topic, signals)
    deserialize = store.deserialize_cdr if topic.encoding == "cdr" else store.deserialize_ros1

    def decode(data: bytes | memoryview) -> object:
        try:
            return deserialize(data, name)
        except SerdeError as error:
            raise ValueError(str(error)) from error

    return decode


def block_columns(topic: TopicInfo, source: TimeSource, signals: SignalMap) -> list[int] | None:
    """Return the arrays of our own messages that hold the signal; ``None`` if it is not read from such messages."""
    arrays = BLOCK_FIELDS.get(topic.type_name, ())
    usual = topic.encoding == "cdr" and source.stamp in ("header", "log_time") and not source.equally_spaced
    usual = usual and source.sample_period == "sample_period" and source.first_sample == "first_sample"
    if usual and set(source.paths) <= set(arrays) and _is_ours(topic, signals):
        return [arrays.index(path) for path in source.paths]
    return None


def _is_ours(topic: TopicInfo, signals: SignalMap) -> bool:
    """Tell whether a topic has our message of that name, or an earlier one, which lacks fields behind the arrays.

    A definition with our very text is not parsed.
    """
    given = (topic.definition_format, topic.definition)
    if topic.type_name not in signals.definitions and given == ("ros2msg", schema_text(topic.type_name)):
        return True
    from drive_id.files.messages.message_types import typestore_for  # noqa: PLC0415  # not needed for bags of our own messages

    constants, fields = typestore_for(topic, signals).fielddefs[topic.type_name]
    ours = message_typestore().fielddefs[topic.type_name]
    arrays = 3 + len(BLOCK_FIELDS[topic.type_name])
    return len(fields) >= arrays and (constants, fields) == (ours[0], ours[1][: len(fields)])


def _block_reader(columns: list[int], count: int, source: TimeSource) -> Reader:
    """Read our own messages by :func:`decode_block`."""
    logged = source.stamp == "log_time"

    def read(message: RawMessage) -> MessageSamples:
        head, values = decode_block(message.data, count)
        stamp = message.log_time if logged else head.stamp
        chosen = tuple(values[k] for k in columns)
        return MessageSamples(stamp, head.first_sample, head.sample_period, chosen, head.frame)

    return read


def _field_reader(decode: Callable[[bytes | memoryview], object], source: TimeSource, paths: tuple[str, ...]) -> Reader:
    """Read any decoded message through the paths of a signals file."""
    values = [parse_field_path(path, "fields") for path in paths]
    period = source.sample_period
    period_path = parse_field_path(period, "sample_period") if isinstance(period, str) else None
    count_path = parse_field_path(source.first_sample, "first_sample") if source.first_sample else None
    stamp_path = parse_field_path("header.stamp" if source.stamp in NAMED_STAMPS else source.stamp, "stamp")
    by_log = source.stamp in ("log_time", "index")

    def read(message: RawMessage) -> MessageSamples:
        if len(message.data) > _LARGEST_MESSAGE:
            raise ValueError(f"it has {counted(len(message.data), 'byte')}")
        decoded = decode(message.data)
        columns = tuple([path.values(decoded) for path in values])
        sizes = {len(column) for column in columns}
        if len(sizes) > 1:
            raise FieldPathError(f"{', '.join(paths)} have {', '.join(str(len(c)) for c in columns)} values")
        stamp = message.log_time if by_log else _time(stamp_path, decoded, source.tick)
        if not isinstance(stamp, int) and len(stamp) != len(columns[0]):
            raise FieldPathError(f"'{source.stamp}' holds {len(stamp)} times for {counted(len(columns[0]), 'sample')}")
        count = None if count_path is None else int(_one(count_path, decoded))
        declared = _one(period_path, decoded) if period_path else period
        return MessageSamples(stamp, count, None if declared is None else float(declared), columns)

    return read


def _one(path: FieldPath, decoded: object) -> float:
    values = path.values(decoded)
    if len(values) != 1 or not np.isfinite(values[0]):
        raise FieldPathError(f"'{path.text}' is not one finite number")
    return float(values[0])


def _time(path: FieldPath, decoded: object, factor: float) -> int | IntArray:
    """Return the time at a path, ns: one for a stamp or number, one per sample for an array of numbers."""
    found = path.find(decoded)
    if isinstance(found, dict):  # a time in JSON
        seconds, nanoseconds = found.get("sec"), found.get("nanosec", found.get("nsec"))
    else:
        seconds, nanoseconds = getattr(found, "sec", None), getattr(found, "nanosec", None)
    if isinstance(seconds, int) and isinstance(nanoseconds, int):
        return seconds * 1_000_000_000 + nanoseconds
    if isinstance(found, int) and float(factor).is_integer():
        return found * int(factor)
    raw = np.asarray(found)
    exact = ticks_to_ns(raw if raw.dtype.kind in "iu" and raw.ndim < 2 else path.values(decoded), factor, path.text)
    return int(exact.reshape(-1)[0]) if raw.ndim == 0 else exact


def ticks_to_ns(raw: NDArray[Any], factor: float, name: str) -> IntArray:
    """Return times (n,) or (), in units of ``factor`` ns, as ns.

    Raises FieldPathError, which names the field, when they are too large, or not finite.
    """
    if raw.dtype.kind in "iu" and float(factor).is_integer():
        limit = STAMP_LIMIT // int(factor)
        if raw.size and (int(raw.max()) > limit or int(raw.min()) < -limit):
            raise FieldPathError(f"'{name}' is not a time")
        return np.asarray(raw.astype(np.int64) * int(factor))
    values = raw.astype(np.longdouble) * np.longdouble(factor)
    if not (np.abs(values) < STAMP_LIMIT).all():
        raise FieldPathError(f"'{name}' is not a time")
    return np.asarray(np.rint(values).astype(np.int64))
