"""Definitions in IDL decode what the same definitions in the language of .msg files encode."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drive_id.errors import MessageTypeError
from drive_id.files.messages.message_types import typestore_for
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.storage.container import TopicInfo

TEXT = "odd_msgs/Stamp stamp\nfloat32[] a\nfloat64 period\nuint64 count\n"
STAMP = "int32 sec\nuint32 nanosec\n"
SEPARATOR = "=" * 80 + "\n"
IDL = """module odd_msgs { module msg {
  struct Odd { odd_msgs::msg::Stamp stamp; sequence<float> a; double period; uint64 count; };
}; };
"""
STAMP_IDL = "module odd_msgs { module msg { struct Stamp { int32 sec; uint32 nanosec; }; }; };\n"
MARKED = f"{SEPARATOR}IDL: odd_msgs/msg/Odd\n{IDL}{SEPARATOR}IDL: odd_msgs/msg/Stamp\n{STAMP_IDL}"


def topic(form, text):
    return TopicInfo("/odd", "odd_msgs/msg/Odd", 1, "cdr", form, text)


@pytest.mark.parametrize("form", ["ros2idl", "omgidl"])
@pytest.mark.parametrize("text", [MARKED, IDL + SEPARATOR + STAMP_IDL], ids=["marked", "plain"])
def test_a_message_defined_in_idl_is_read(form, text):
    writing = get_typestore(Stores.EMPTY)
    writing.register(get_types_from_msg(TEXT, "odd_msgs/msg/Odd"))
    writing.register(get_types_from_msg(STAMP, "odd_msgs/msg/Stamp"))
    odd, stamp = writing.types["odd_msgs/msg/Odd"], writing.types["odd_msgs/msg/Stamp"]
    a = np.array([0.5, -1.25, 3.0], np.float32)
    raw = writing.serialize_cdr(odd(stamp(7, 8), a, 1e-4, 2**40), "odd_msgs/msg/Odd")
    read = typestore_for(topic(form, text), SignalMap()).deserialize_cdr(raw, "odd_msgs/msg/Odd")
    np.testing.assert_array_equal(read.a, a)
    assert (read.stamp.sec, read.stamp.nanosec, read.period, read.count) == (7, 8, 1e-4, 2**40)


@pytest.mark.parametrize(
    ("form", "text", "said"),
    [
        ("ros2idl", IDL.replace("struct", "structure"), "cannot be understood"),
        ("ros2idl", STAMP_IDL, "holds no definition of odd_msgs/msg/Odd"),
        ("flatbuffer", TEXT, "it is written in 'flatbuffer'"),
    ],
)
def test_a_definition_that_helps_nobody_is_refused(form, text, said):
    with pytest.raises(MessageTypeError, match=said):
        typestore_for(topic(form, text), SignalMap())
