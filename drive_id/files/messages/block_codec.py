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
from drive_id.core.numerics.compiled import compiled
from drive_id.types import NANOSECONDS, IntArray

LONGEST_PERIOD = 1e4
"""Sample period, s, from which one is no measurement but an error of its unit."""
_STAMP_MAX = 2**31 * NANOSECONDS
_TIME_AND_NAME = (struct.Struct(">iII"), struct.Struct("<iII"))
LONGEST_REST = (3, 3, 24, 3)
"""Most bytes behind one, two or three arrays: padding, and behind two the rest of a ``CurrentReference``."""
_COUNTS = (struct.Struct(">QdI"), struct.Struct("<QdI"))
_NUMBER = (struct.Struct(">I"), struct.Struct("<I"))
_FLOATS = (np.dtype(">f4"), np.dtype("<f4"))
_LARGEST_COUNT = 2**61
"""Running count up to which that of the last sample is an int64, too."""


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


class Blocks(NamedTuple):
    """B blocks of one publisher, of N samples in all: the same period and frame_id, at least one sample in each."""

    stamp: IntArray  # (B,), of the first sample, ns
    first_sample: IntArray  # (B,), running count of the first sample
    samples: IntArray  # (B,)
    sample_period: float  # s
    frame: str
    values: NDArray[np.float32]  # (arrays, N), in order of definition


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


def decode_blocks(messages: Sequence[bytes | memoryview], fields: int) -> Blocks | None:
    """Deserialize blocks, at least one, with ``fields`` float32 arrays each, in one pass.

    None where one of them is no such block, is big-endian, or differs from the first in period or frame_id:
    :func:`decode_block` reads each, or says what is wrong.
    """
    try:
        head = read_head(messages[0])
    except ValueError:
        return None
    data = np.frombuffer(b"".join(messages), np.uint8)
    ends, heads = np.cumsum([len(message) for message in messages]), np.empty((3, len(messages)), np.int64)
    values = np.empty((fields, len(data) // (4 * fields)), np.float32)  # room for all bytes
    count = _decode(data, ends, head.end - 16, LONGEST_REST[fields], heads, values.view(np.uint32))
    if count < 0 or not 0.0 < head.sample_period < LONGEST_PERIOD:
        return None
    stamp, first_sample, samples = heads
    return Blocks(stamp, first_sample, samples, head.sample_period, head.frame, values[:, :count])


@compiled("const u1[::1], const i8[::1], i8, i8, i8[:, ::1], u4[:, ::1]")
def _decode(
    data: NDArray[np.uint8], ends: IntArray, counts: int, longest_rest: int, heads: IntArray, bits: NDArray[np.uint32]
) -> int:
    """Decode little-endian blocks, see :func:`decode_blocks`; return the number of their samples, -1 for others.

    Parameters
    ----------
    data : (D,) uint8
        The messages, one behind the other.
    ends : (B,) int64
        Where each ends.
    counts : int
        Position of the counts within the first message.
    longest_rest : int
        Most bytes behind the arrays.
    heads : (3, B) int64
        Output: stamp, ns, running count of the first sample, number of samples.
    bits : (fields, S) uint32
        Output: the float32 values, of which there are up to S.
    """
    begin, total = 0, 0
    name = 16 + _number(data, 12, 4)
    for k in range(len(ends)):
        end, at = ends[k], begin + counts
        if end < at + 20 or data[begin] != 0 or data[begin + 1] != 1:
            return -1
        nanoseconds, first, count = _number(data, begin + 8, 4), _number(data, at, 8), _number(data, at + 16, 4)
        same = _same(data, begin, 12, name) and _same(data, begin, counts + 8, counts + 16)  # frame_id, period
        if not same or nanoseconds >= NANOSECONDS or not 0 <= first < _LARGEST_COUNT or not count:
            return -1
        seconds = _number(data, begin + 4, 4)
        heads[0, k] = (seconds - 2**32 * (seconds >> 31)) * NANOSECONDS + nanoseconds
        heads[1, k], heads[2, k] = first, count
        at += 16
        for field in range(len(bits)):
            if end < at + 4 + 4 * count or _number(data, at, 4) != count:
                return -1
            at += 4
            for j in range(count):
                bits[field, total + j] = _number(data, at + 4 * j, 4)
            at += 4 * count
        if end - at > longest_rest:
            return -1
        begin, total = end, total + count
    return total


@compiled("const u1[::1], i8, i8, i8")
def _same(data: NDArray[np.uint8], begin: int, start: int, stop: int) -> bool:
    for k in range(start, stop):  # noqa: SIM110  # numba compiles loops, not generators
        if data[begin + k] != data[k]:
            return False
    return True


@compiled("const u1[::1], i8, i8")
def _number(data: NDArray[np.uint8], at: int, size: int) -> int:
    number = 0
    for k in range(size):
        number |= np.int64(data[at + k]) << (8 * k)
    return number
