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

from drive_id.files.messages.block_codec import decode_block, encode_block
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
