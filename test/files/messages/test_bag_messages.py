"""Definitions, hashes and the CDR codec against independent readers of the same."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drive_id.files.messages.block_codec import decode_block, decode_blocks, encode_block
from drive_id.files.messages.messages import (
    BLOCK_FIELDS,
    CURRENT_REFERENCE,
    DEFINITIONS,
    message_typestore,
    schema_text,
    type_hash,
)

MSG_DEFS = Path(__file__).parents[3] / "msg_defs" / "msg"
FLOATS = st.floats(width=32, allow_nan=False)


def tokens(text: str) -> list[str]:
    return re.sub(r"#.*", "", text).split()


@pytest.mark.parametrize("name", sorted(DEFINITIONS))
def test_definitions_are_those_of_the_interface_package(name):
    text = (MSG_DEFS / f"{name.rsplit('/', 1)[1]}.msg").read_text(encoding="utf-8")
    assert tokens(DEFINITIONS[name]) == tokens(text)


@pytest.mark.parametrize("name", sorted(DEFINITIONS))
def test_hashes_agree_with_the_definitions_of_the_distribution(name):
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(DEFINITIONS[name], name))
    assert type_hash(name) == store.hash_rihs01(name)
    embedded = get_typestore(Stores.EMPTY)
    embedded.register(get_types_from_msg(schema_text(name), name))
    assert embedded.hash_rihs01("std_msgs/msg/Header") == store.hash_rihs01("std_msgs/msg/Header")


@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from(sorted(BLOCK_FIELDS)),
    st.integers(0, 2**31 * 10**9 - 1),
    st.integers(0, 2**64 - 1),
    st.floats(1e-7, 1.0),
    st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9),
    st.data(),
)
def test_blocks_are_cdr(name, stamp, first, period, frame, data):
    n = data.draw(st.integers(0, 5))
    columns = [np.array(data.draw(st.lists(FLOATS, min_size=n, max_size=n)), np.float32) for _ in BLOCK_FIELDS[name]]
    session = (first, n, bool(n % 2), bool(n % 3)) if name == CURRENT_REFERENCE else None
    raw = encode_block(stamp, first, period, columns, frame, session)
    store = message_typestore()
    message = store.deserialize_cdr(raw, name)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
    assert (message.header.frame_id, message.first_sample, message.sample_period) == (frame, first, period)
    for field, column in zip(BLOCK_FIELDS[name], columns, strict=True):
        np.testing.assert_array_equal(getattr(message, field), column)
    if session is not None:
        assert (message.session, message.count, message.safe, message.stator_frame) == session
        former = decode_block(encode_block(stamp, first, period, columns, frame), len(columns))
        assert (former.head.stamp, former.head.samples) == (stamp, n)
    for little in (True, False):
        block = decode_block(store.serialize_cdr(message, name, little_endian=little), len(columns))
        assert block.head[:4] == (stamp, first, period, n)
        for found, column in zip(block.values, columns, strict=True):
            np.testing.assert_array_equal(found, column)


@settings(max_examples=50, deadline=None)
@given(
    st.sampled_from(sorted(BLOCK_FIELDS)),
    st.lists(st.tuples(st.integers(0, 2**31 * 10**9 - 1), st.integers(0, 2**61 - 1), st.integers(1, 5)), min_size=1),
    st.floats(1e-7, 1.0),
    st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9),
)
def test_blocks_decoded_together_are_those_decoded_one_by_one(name, heads, period, frame):
    session = (2**64 - 1, 7, True, False) if name == CURRENT_REFERENCE else None
    rng, fields = np.random.default_rng(len(heads)), len(BLOCK_FIELDS[name])
    messages = [
        encode_block(stamp, first, period, rng.normal(size=(fields, n)).astype(np.float32), frame, session)
        for stamp, first, n in heads
    ]
    found, single = decode_blocks(messages, fields), [decode_block(message, fields) for message in messages]
    assert found is not None
    assert (found.sample_period, found.frame) == (period, frame)
    assert list(zip(found.stamp, found.first_sample, found.samples, strict=True)) == heads
    np.testing.assert_array_equal(found.values, np.hstack([np.stack(block.values) for block in single]))


_ONES = np.ones((3, 4), np.float32)


def _block(stamp=0, first=7, period=1e-4, values=_ONES, frame="drive"):
    return encode_block(stamp, first, period, values, frame)


@pytest.mark.parametrize(
    "other",
    [
        _block(period=2e-4), _block(frame="other"), _block(frame="drives"), _block(first=2**61),
        _block(values=np.ones((3, 0), np.float32)), _block(values=[np.ones(n, np.float32) for n in (4, 3, 4)]),
        b"\0\0" + _block()[2:], _block() + bytes(4),
        _block()[:8] + struct.pack("<I", 10**9) + _block()[12:],
        _block()[:-20] + struct.pack("<I", 2**32 - 1) + _block()[-16:],
        *(_block()[:length] for length in range(len(_block()))),
    ],
)  # fmt: skip
def test_blocks_that_differ_are_not_decoded_together(other):
    assert decode_blocks([_block(), _block()], 3) is not None
    assert decode_blocks([_block(), other], 3) is None
    assert decode_blocks([_block(), other, _block()], 3) is None


def test_stamps_before_the_epoch_and_absurd_periods():
    before = _block()[:4] + struct.pack("<iI", -2, 5) + _block()[12:]
    found = decode_blocks([before], 3)
    assert found is not None
    assert found.stamp.tolist() == [decode_block(before, 3).head.stamp] == [5 - 2 * 10**9]
    for period in (0.0, -1e-4, 1e4, float("nan")):
        assert decode_blocks([_block(period=period)], 3) is None


def test_every_broken_block_is_refused():
    raw = encode_block(10**18, 7, 1e-4, [np.ones(4, np.float32)] * 3, "drive")
    for length in range(len(raw)):
        with pytest.raises(ValueError, match=r"too early|begin like|more than it holds|different lengths"):
            decode_block(raw[:length], 3)
    with pytest.raises(ValueError, match="longer than its type"):
        decode_block(raw + bytes(4), 3)
    with pytest.raises(ValueError, match="more than it holds"):
        decode_block(raw[:-20] + struct.pack("<I", 2**32 - 1) + raw[-16:], 3)
    unequal = encode_block(0, 0, 1e-4, [np.ones(4, np.float32), np.ones(3, np.float32)], "")
    with pytest.raises(ValueError, match="different lengths, 4 and 3"):
        decode_block(unequal, 2)


@pytest.mark.parametrize("stamp", [-1, 2**31 * 10**9])
def test_stamps_that_do_not_fit(stamp):
    with pytest.raises(ValueError, match="does not fit"):
        encode_block(stamp, 0, 1e-4, [np.ones(1, np.float32)], "")
