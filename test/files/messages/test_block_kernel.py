"""Blocks read straight from chunks against the codec, message by message."""

from __future__ import annotations

import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drive_id.files.messages.block_codec import decode_block, encode_block
from drive_id.files.messages.block_kernel import (
    DAMAGED,
    DONE,
    FIRST,
    LOGGED,
    SAMPLES,
    SECTION,
    STAMP,
    UNUSUAL,
    copy_blocks,
    read_blocks,
)

START = 1_700_000_000_123_456_789


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def message(channel, data, log_time=5):
    return record(5, struct.pack("<HIQQ", channel, 0, log_time, 0) + data)


def read(data, fields=3):
    sections = np.full(65536, -1, np.int64)
    sections[7] = 0
    table, periods = np.zeros((len(data) // 31 + 1, 6), np.int64), np.zeros(len(data) // 31 + 1)
    found = np.zeros(65536, np.int64)
    array = np.frombuffer(data, np.uint8)
    end, count, position = read_blocks(
        array, 0, len(data), sections, np.array([fields]), table, periods.view(np.int64), found
    )  # fmt: skip
    return end, table[:count], periods[:count], position, found, array


@given(data=st.data())
def test_blocks_are_those_of_the_codec(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    blocks, stream = [], b""
    for number in range(data.draw(st.integers(0, 5))):
        size = data.draw(st.sampled_from([0, 1, 3, 100]))
        name = data.draw(st.sampled_from(["", "drive", "a longer name"]))
        values = [rng.normal(size=size).astype(np.float32) for _ in range(3)]
        encoded = encode_block(START + 10**7 * number, 2**40 + 100 * number, 1e-4, values, name)
        stream += record(8, b"other") + message(9, b"another topic") + message(7, encoded, 77 + number)
        blocks.append(decode_block(encoded, 3))
    end, table, periods, _, found, array = read(stream)
    assert end == DONE
    assert (found[7], found[9]) == (len(blocks), 0)
    assert [tuple(row) for row in table[:, [STAMP, FIRST, SAMPLES]]] == [
        (block.stamp, block.first_sample, len(block)) for block in blocks
    ]
    assert table[:, LOGGED].tolist() == [77 + k for k in range(len(blocks))]
    assert not table[:, SECTION].any()
    assert periods.tolist() == [block.sample_period for block in blocks]
    count = int(table[:, SAMPLES].sum())
    for logged in (False, True):
        stamp, values = np.empty(count, np.int64), np.empty((count, 2))
        copy_blocks(array, table, np.array([2, 0]), periods, logged, stamp, values)
        expected = [(b.stamp if not logged else 77 + k) + 100_000 * np.arange(len(b)) for k, b in enumerate(blocks)]
        np.testing.assert_array_equal(stamp, np.concatenate([*expected, []]))
        columns = [np.column_stack([b.values[2], b.values[0]]) for b in blocks]
        np.testing.assert_array_equal(values, np.concatenate([*columns, np.zeros((0, 2))]))


GOOD = encode_block(START, 0, 1e-4, [np.ones(5, np.float32)] * 3, "drive")


def test_what_is_not_exactly_so_is_left_to_the_codec():
    before = message(7, GOOD)
    nanoseconds = GOOD[:8] + struct.pack("<I", 2_000_000_000) + GOOD[12:]
    cases = [GOOD[:k] for k in range(len(GOOD))]
    cases += [GOOD + b"1234", b"\0\0" + GOOD[2:], b"\1" + GOOD[1:], b"\x28\xb5\x2f\xfd" + GOOD[4:], nanoseconds]
    cases += [encode_block(START, 0, 1e-4, [np.ones(5, np.float32), *[np.ones(4, np.float32)] * 2], "drive")]
    cases += [encode_block(START, 2**63, 1e-4, [np.ones(5, np.float32)] * 3, "drive")]
    for case in cases:
        end, table, _, position, *_ = read(before + message(7, case))
        assert (end, len(table), position) == (UNUSUAL, 1, len(before))
    assert read(before + message(7, GOOD + b"123"))[0] == DONE


def test_records_that_are_cut_off_are_damage():
    stream = message(7, GOOD) + message(7, GOOD)
    for length in range(len(stream) // 2 + 1, len(stream)):
        end, table, _, position, *_ = read(stream[:length])
        assert (end, len(table), position) == (DAMAGED, 1, len(stream) // 2)
    assert read(record(5, b"short"))[0] == DAMAGED
    assert read(struct.pack("<BQ", 1, 2**63 + 5) + b"xy")[0] == DAMAGED


def test_times_before_1970_and_late_ones():
    seconds = struct.pack("<i", -7)
    end, table, *_ = read(message(7, GOOD[:4] + seconds + GOOD[8:]))
    assert end == DONE
    assert table[0, STAMP] == decode_block(GOOD[:4] + seconds + GOOD[8:], 3).stamp
