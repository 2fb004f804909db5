"""ROS 1 bags, and JSON messages in MCAP files, by the same signals file."""

from __future__ import annotations

import json

import numpy as np
import pytest
from bag_samples import START, STEP, assert_equal_samples, make_samples
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drive_id.core.signals.join import joined
from drive_id.errors import TruncatedBagError
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read.info import bag_info
from drive_id.files.read.reader import bag_pieces
from drive_id.files.read.several import read_recording
from drive_id.inspection.contents import read_contents

N = 300
SIGNALS = parse_signals(
    """
defaults: {topic: /log, sample_period: 1e-4}
currents: {fields: ["i[0]", "i[1]", "i[2]"]}
voltages: {fields: ["u[0]", "u[1]", "u[2]"]}
resolver: {angle: rotor.angle, speed: rotor.speed}
""",
    "test",
)


@pytest.fixture(scope="module")
def samples():
    return make_samples(N, reference=False)


def write_ros1(path, samples):
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("float64 angle\nfloat64 speed\n", "bench_msgs/msg/Rotor"))
    text = "std_msgs/Header header\nfloat64[3] i\nfloat64[] u\nbench_msgs/Rotor rotor\n"
    store.register(get_types_from_msg(text, "bench_msgs/msg/Row"))
    kinds = store.types
    time, header = kinds["builtin_interfaces/msg/Time"], kinds["std_msgs/msg/Header"]
    with Writer1(path) as writer:
        connection = writer.add_connection("/log", "bench_msgs/msg/Row", typestore=store)
        for k in range(N):
            stamp = START + k * STEP
            rotor = kinds["bench_msgs/msg/Rotor"](samples.angle[k], samples.speed[k])
            head = header(k, time(*divmod(stamp, 10**9)), "")
            row = kinds["bench_msgs/msg/Row"](head, samples.i_abc[k], samples.u_abc[k], rotor)
            writer.write(connection, stamp + 9, store.serialize_ros1(row, "bench_msgs/msg/Row"))
    return path


def write_json(path, samples):
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("")
        schema = writer.register_schema("Row", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/log", "json", schema)
        for k in range(N):
            stamp = START + k * STEP
            seconds, rest = divmod(stamp, 10**9)
            row = {
                "header": {"stamp": {"sec": seconds, "nanosec": rest}},
                "i": samples.i_abc[k].tolist(),
                "u": samples.u_abc[k].tolist(),
                "rotor": {"angle": samples.angle[k], "speed": samples.speed[k]},
            }
            writer.add_message(channel, stamp + 9, json.dumps(row).encode(), stamp)
        writer.finish()
    return path


@pytest.mark.parametrize(("name", "write"), [("log.bag", write_ros1), ("log.mcap", write_json)])
def test_the_numbers_are_those_of_the_recording(tmp_path, samples, name, write):
    path = write(tmp_path / name, samples)
    found = read_recording(path, SIGNALS).samples
    assert_equal_samples(found, samples)
    assert_equal_samples(joined(list(bag_pieces(path, SIGNALS))), found)
    (topic,) = bag_info(path).topics
    assert (topic.name, topic.count) == ("/log", N)
    (table,) = read_contents(path).tables
    assert set(table.columns) == {f"{x}[{k}]" for x in "iu" for k in range(3)} | {"rotor.angle", "rotor.speed"}
    np.testing.assert_array_equal(table.columns["u[1]"], samples.u_abc[:, 1])


def test_a_ros_1_bag_that_was_cut_off(tmp_path, samples):
    path = write_ros1(tmp_path / "log.bag", samples)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(TruncatedBagError, match="is no readable ROS 1 bag"):
        read_recording(path, SIGNALS)
