"""ROS 1 bags and JSON messages in MCAP files, written by others' writers, and the signals file for both."""

from __future__ import annotations

import json

from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SIGNALS = """
defaults: {topic: /log, sample_period: 1e-4}
currents: {fields: ["i[0]", "i[1]", "i[2]"]}
voltages: {fields: ["u[0]", "u[1]", "u[2]"]}
resolver: {angle: rotor.angle, speed: rotor.speed}
"""


def write_ros1(path, samples):
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("float64 angle\nfloat64 speed\n", "bench_msgs/msg/Rotor"))
    text = "std_msgs/Header header\nfloat64[3] i\nfloat64[] u\nbench_msgs/Rotor rotor\n"
    store.register(get_types_from_msg(text, "bench_msgs/msg/Row"))
    kinds = store.types
    time, header = kinds["builtin_interfaces/msg/Time"], kinds["std_msgs/msg/Header"]
    with Writer1(path) as writer:
        connection = writer.add_connection("/log", "bench_msgs/msg/Row", typestore=store)
        for k, stamp in enumerate(map(int, samples.stamp)):
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
        for k, stamp in enumerate(map(int, samples.stamp)):
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
