"""Codec of our sample messages, which share one CDR layout: a header and one to three float32 arrays.

``CurrentReference`` goes on with session, count and two flags, which bags of earlier versions lack and no reader needs.

The tests compare it with the general deserializer of rosbags.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drive_id.common.quantity import counted
from drive_id.types import NANOSECONDS

LONGEST_PERIOD = 1e4
"""Sample period, s, from which one is no measurement but an error of its unit."""
_STAMP_MAX = 2**31 * NANOSECONDS
_TIME_AND_NAME = (struct.Struct(">iII"), struct.Struct("<iII"))
LONGEST_REST = (3, 3, 24, 3)
"""Most bytes behind one, two or three arrays: padding, and behind two the rest of a ``CurrentReference``."""
_COUNTS = (struct.Struct(">QdI"), struct.Struct("<QdI"))
_NUMBER = (struct.Struct(">I"), struct.Struct("<I"))
_FLOATS = (np.dtype(">f4"), np.dtype("<f4"))


class BlockHead(NamedTuple):
    """Head of a block: stamp (ns) and running count of the first sample, declared period (s), number of samples.

    ``end`` is the position of the first array in the message, ``frame`` its frame_id.
    """

    stamp: int
    first_sample: int
    sample_period: float
    samples: int
    end: int = 0
    frame: str = ""


class Block(NamedTuple):
    """One sample message: its head, and its arrays (n,) in order of definition."""

    head: BlockHead
    values: tuple[NDArray[np.float32], ...]


def encode_block(
    stamp: int,
    first_sample: int,
    sample_period: float,
    values: Sequence[NDArray[np.float32]],
    frame_id: str,
    session: tuple[int, int, bool, bool] | None = None,
) -> bytes:
    """Serialize one block as little-endian CDR.

    Parameters
    ----------
    stamp : int
        Time of the first sample, ns, in [0, 2**31 s), as fits into ``builtin_interfaces/Time``; else ValueError.
    sample_period : float
        s.
    values : sequence of (n,) float32
        The arrays in order of definition.
    session : (int, int, bool, bool), optional
        Session, count, ``safe`` and ``stator_frame`` of a ``CurrentReference``.
    """
    if not 0 <= stamp < _STAMP_MAX:
        raise ValueError(f"stamp {stamp} ns does not fit into builtin_interfaces/Time")
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    name = frame_id.encode() + b"\0"
    head = struct.pack("<iII", seconds, nanoseconds, len(name)) + name
    head += bytes(-len(head) % 8) + struct.pack("<Qd", first_sample, sample_period)
    body = head + b"".join(struct.pack("<I", len(v)) + v.astype("<f4").tobytes() for v in values)
    if session is not None:
        body += bytes(-len(body) % 8) + struct.pack("<QQ??", *session)
    return b"\x00\x01\x00\x00" + body


def read_head(data: bytes | memoryview) -> BlockHead:
    """Read the head of a block of any of our types, without its arrays.

    Raises ValueError when the message does not begin like a block.
    """
    try:
        order = data[1]
        if data[0] or order > 1:
            raise ValueError("it does not begin like a CDR message")
        seconds, nanoseconds, length = _TIME_AND_NAME[order].unpack_from(data, 4)
        position = (16 + length + 3) // 8 * 8 + 4
        first_sample, sample_period, samples = _COUNTS[order].unpack_from(data, position)
    except (struct.error, IndexError):
        raise ValueError("it ends too early") from None
    if nanoseconds >= NANOSECONDS:
        raise ValueError("its stamp has more than a second of nanoseconds")
    frame = bytes(data[16 : 15 + length]).decode(errors="replace")
    return BlockHead(seconds * NANOSECONDS + nanoseconds, first_sample, sample_period, samples, position + 16, frame)


def decode_block(data: bytes | memoryview, fields: int) -> Block:
    """Deserialize one block with ``fields`` float32 arrays, of either byte order.

    Raises ValueError when the message is not such a block; says why.
    """
    head = read_head(data)
    position = head.end
    number, floats = _NUMBER[data[1]], _FLOATS[data[1]]
    values = []
    for _ in range(fields):
        try:
            (count,) = number.unpack_from(data, position)
        except struct.error:
            raise ValueError("it ends too early") from None
        position += 4
        if count * 4 > len(data) - position:
            raise ValueError(f"it declares {counted(count, 'sample')}, more than it holds")
        if count != head.samples:
            raise ValueError(f"its arrays have different lengths, {head.samples} and {count}")
        values.append(np.frombuffer(data, floats, count, position))
        position += 4 * count
    if len(data) - position > LONGEST_REST[fields]:
        raise ValueError("it is longer than its type allows")
    return Block(head, tuple(values if floats == np.float32 else [value.astype(np.float32) for value in values]))
