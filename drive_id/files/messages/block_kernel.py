"""Our block messages straight from the records of MCAP chunks into arrays, without a Python object for any of them.

The layout is that of :mod:`~.block_codec`, little-endian. Whatever is not exactly so is left to it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray, IntArray

ByteArray = NDArray[np.uint8]

STAMP, FIRST, SAMPLES, POSITION, LOGGED, SECTION = range(6)
"""Columns of the table of blocks: ns, running count, number of samples, where the arrays begin, ns, section."""
DONE, DAMAGED, UNUSUAL = range(3)
"""How :func:`read_blocks` ended: at the end, at a record that is damaged, at a message that is no such block."""

_MESSAGE = 5
_NANOSECONDS = 1_000_000_000


@compiled
def read_blocks(
    data: ByteArray,
    start: int,
    stop: int,
    sections: IntArray,
    fields: IntArray,
    table: IntArray,
    periods: FloatArray,
    found: IntArray,
) -> tuple[int, int, int]:
    """List the blocks among the records of a chunk.

    Parameters
    ----------
    data : (B,) uint8
    start, stop : int
        Where its records begin and end.
    sections : (65536,) int64
        Of each channel, the section that its blocks are of; -1 for those to be passed over.
    fields : (S,) int64
        Number of arrays in the blocks of each section.
    table : (M, 6) int64
        Filled, see the constants above; M must be at least ``(stop - start) / 31``.
    periods : (M,) float
        Filled with their sample periods, s.
    found : (65536,) int64
        Messages of each channel; increased.

    Returns
    -------
    end : int
        ``DONE``, ``DAMAGED`` or ``UNUSUAL``.
    count : int
        Blocks listed.
    position : int
        Where the record begins that is damaged or unusual.
    """
    count, position = 0, start
    while position < stop:
        if position + 9 > stop:
            return DAMAGED, count, position
        length = _uint64(data, position + 1)
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
                table[count, LOGGED], table[count, SECTION] = _uint64(data, body + 6), section
                found[channel] += 1
                count += 1
        position = body + length
    return DONE, count, position


@compiled
def _read_block(
    data: ByteArray, start: int, stop: int, fields: int, row: IntArray, periods: FloatArray, at: int
) -> bool:
    """Fill the row with one block, and tell whether it is one without any fault."""
    body = start + 4
    if stop < body + 12 or data[start] != 0 or data[start + 1] != 1:
        return False
    nanoseconds, name = _uint32(data, body + 4), _uint32(data, body + 8)
    position = body + (12 + name + 7) // 8 * 8
    if nanoseconds >= _NANOSECONDS or position + 16 > stop:
        return False
    first = _uint64(data, position)
    periods[at] = data[position + 8 : position + 16].view(np.float64)[0]
    position += 16
    begin, samples = position, 0
    for field in range(fields):
        if position + 4 > stop:
            return False
        number = _uint32(data, position)
        if (field > 0 and number != samples) or 4 * number > stop - position - 4:
            return False
        samples = number
        position += 4 + 4 * number
    if stop - position > 3 or first < 0:
        return False
    seconds = _uint32(data, body)
    row[STAMP] = (seconds - (1 << 32) * (seconds >> 31)) * _NANOSECONDS + nanoseconds
    row[FIRST], row[SAMPLES], row[POSITION] = first, samples, begin
    return True


@compiled
def copy_blocks(
    data: ByteArray, table: IntArray, columns: IntArray, periods: FloatArray, logged: bool, stamp: IntArray,
    values: FloatArray,
) -> None:  # fmt: skip
    """Write the samples of blocks of one section behind each other.

    Parameters
    ----------
    data : (B,) uint8
    table : (M, 6) int64
    columns : (K,) int64
        Which of the arrays to take.
    periods : (M,) float
        s.
    logged : bool
        Count time from when the blocks were logged, not from their stamps.
    stamp : (N,) int64
        N being the number of their samples; ns.
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


@compiled
def _uint32(data: ByteArray, at: int) -> int:
    number: int = np.int64(data[at : at + 4].view(np.uint32)[0])
    return number


@compiled
def _uint64(data: ByteArray, at: int) -> int:
    """Return eight bytes as a number; what does not fit is negative."""
    number: int = np.int64(data[at : at + 8].view(np.int64)[0])
    return number
