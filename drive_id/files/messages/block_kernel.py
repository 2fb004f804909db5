"""Compiled reader of our sample messages: from the records of MCAP chunks into arrays, without Python objects.

It reads the layout of :mod:`~.block_codec`, little-endian, and leaves all other messages to that module. A file of its
own, because nodes that only record must not load numba.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drive_id.core.numerics.compiled import compiled
from drive_id.files.messages.block_codec import LONGEST_REST
from drive_id.types import FloatArray, IntArray

ByteArray = NDArray[np.uint8]

STAMP, FIRST, SAMPLES, POSITION, LOGGED, SECTION = range(6)
"""Columns of the table of blocks: stamp (ns), running count, samples, offset of the arrays, log time (ns), section."""
DONE, DAMAGED, UNUSUAL = range(3)
"""Results of :func:`read_blocks`: end reached, damaged record, message in another layout."""

_MESSAGE = 5
_NANOSECONDS = 1_000_000_000


@compiled("const u1[::1], i8, i8, i8[::1], i8[::1], i8[:, ::1], i8[::1], i8[::1]")
def read_blocks(
    data: ByteArray,
    start: int,
    stop: int,
    sections: IntArray,
    fields: IntArray,
    table: IntArray,
    periods: IntArray,
    found: IntArray,
) -> tuple[int, int, int]:
    """List the blocks among the records of a chunk.

    Parameters
    ----------
    data : (B,) uint8
    start, stop : int
        Begin and end of its records.
    sections : (65536,) int64
        Section of each channel; -1 to skip the channel.
    fields : (S,) int64
        Number of arrays in the blocks of each section.
    table : (M, 6) int64
        Output, see the constants above; M must be at least ``(stop - start) / 31``.
    periods : (M,) int64
        Output: bits of the sample periods, float64, s.
    found : (65536,) int64
        Number of messages of each channel; incremented.

    Returns
    -------
    end : int
        ``DONE``, ``DAMAGED`` or ``UNUSUAL``.
    count : int
        Blocks listed.
    position : int
        Begin of the record that is damaged or has another layout.
    """
    count, position = 0, start
    while position < stop:
        if position + 9 > stop:
            return DAMAGED, count, position
        length = _number(data, position + 1, 8)
        body = position + 9
        if length < 0 or length > stop - body:
            return DAMAGED, count, position
        if data[position] == _MESSAGE:
            if length < 22:
                return DAMAGED, count, position
            channel = np.int64(data[body]) + 256 * np.int64(data[body + 1])
            section = sections[channel]
            if section >= 0:
                if not _read_block(data, body + 22, body + length, fields[section], table[count], periods, count):
                    return UNUSUAL, count, position
                table[count, LOGGED], table[count, SECTION] = _number(data, body + 6, 8), section
                found[channel] += 1
                count += 1
        position = body + length
    return DONE, count, position


@compiled("const u1[::1], i8, i8, i8, i8[::1], i8[::1], i8")
def _read_block(data: ByteArray, start: int, stop: int, fields: int, row: IntArray, periods: IntArray, at: int) -> bool:
    """Fill the row with one block; return False if the message has another layout or a fault."""
    body = start + 4
    if stop < body + 12 or data[start] != 0 or data[start + 1] != 1:
        return False
    nanoseconds, name = _number(data, body + 4, 4), _number(data, body + 8, 4)
    position = body + (12 + name + 7) // 8 * 8
    if nanoseconds >= _NANOSECONDS or position + 16 > stop:
        return False
    first = _number(data, position, 8)
    periods[at] = _number(data, position + 8, 8)
    position += 16
    begin, samples = position, 0
    for field in range(fields):
        if position + 4 > stop:
            return False
        number = _number(data, position, 4)
        if (field > 0 and number != samples) or 4 * number > stop - position - 4:
            return False
        samples = number
        position += 4 + 4 * number
    if stop - position > LONGEST_REST[fields] or first < 0:
        return False
    seconds = _number(data, body, 4)
    row[STAMP] = (seconds - (1 << 32) * (seconds >> 31)) * _NANOSECONDS + nanoseconds
    row[FIRST], row[SAMPLES], row[POSITION] = first, samples, begin
    return True


@compiled("const u1[::1], const i8[:, ::1], const i8[::1], const f8[::1], b1, i8[::1], f8[:, ::1]")
def copy_blocks(
    data: ByteArray, table: IntArray, columns: IntArray, periods: FloatArray, logged: bool, stamp: IntArray,
    values: FloatArray,
) -> None:  # fmt: skip
    """Concatenate the samples of the blocks of one section.

    Parameters
    ----------
    data : (B,) uint8
    table : (M, 6) int64
    columns : (K,) int64
        Indices of the arrays to copy.
    periods : (M,) float
        s.
    logged : bool
        Take the time from the log times instead of the stamps.
    stamp : (N,) int64
        Output: time of each sample, ns.
    values : (N, K) float
    """
    row = 0
    for block in range(len(table)):
        samples, position = table[block, SAMPLES], table[block, POSITION]
        begin = table[block, LOGGED] if logged else table[block, STAMP]
        step = periods[block] * 1e9
        for k in range(samples):
            stamp[row + k] = begin + np.int64(np.rint(k * step))
        for column in range(len(columns)):
            start = position + 4 + columns[column] * (4 + 4 * samples)
            numbers = data[start : start + 4 * samples].view(np.float32)
            for k in range(samples):
                values[row + k, column] = numbers[k]
        row += samples


@compiled("const u1[::1], i8, i8")
def _number(data: ByteArray, at: int, size: int) -> int:
    """Return four or eight bytes as a number; eight are negative from 2**63 on."""
    number: int = np.int64(0)
    for k in range(size):
        number |= np.int64(data[at + k]) << np.int64(8 * k)
    return number
