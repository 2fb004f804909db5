"""Copies of recordings, message by message: by another writer, or with changes."""

from __future__ import annotations

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from drive_id.files.messages.messages import message_typestore
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter


def by_rosbags(source, target, storage=StoragePlugin.MCAP, mode=CompressionMode.NONE, version=9):
    """Copy a bag with the writer of rosbags, and return the copy."""
    store = message_typestore()
    writer = Writer(target, version=version, storage_plugin=storage)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with AnyReader([source]) as reader, writer:
        keys = {
            topic: writer.add_connection(topic, info.msgtype, typestore=store) for topic, info in reader.topics.items()
        }
        for connection, time, raw in reader.messages():
            writer.write(keys[connection.topic], time, raw)
    return target


def with_messages(source, target, change, truth=None):
    """Copy the messages of a bag as (number, topic, data, time), changed, in the order of the changed list."""
    with AnyReader([source]) as reader, Rosbag2McapWriter(target, chunk_size=1500) as writer:
        for connection in reader.connections:
            writer.add_topic(connection.topic, connection.msgtype)
        messages = [(k, c.topic, bytes(raw), time) for k, (c, time, raw) in enumerate(reader.messages())]
        for _, topic, data, time in change(messages):
            writer.write(topic, data, time)
        if truth is not None:
            writer.attach("ground_truth.npz", truth, "application/zip")
    return target
