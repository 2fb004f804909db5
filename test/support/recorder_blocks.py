"""Messages as a bench publishes them, and disks that fill up, for the tests of the recorder."""

from __future__ import annotations

import errno
import io
import itertools
import os

import numpy as np
import yaml
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from drive_id.files.messages.block_codec import encode_block
from drive_id.files.messages.messages import BLOCK_FIELDS, CURRENT_REFERENCE, PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER
from drive_id.live.recording.recording_session import RecordedTopic

START = 1_700_000_000_000_000_000
PERIOD = 1e-4
TOPICS = (
    RecordedTopic("/phase_currents", PHASE_CURRENTS),
    RecordedTopic("/phase_voltages", PHASE_VOLTAGES),
    RecordedTopic("/resolver", RESOLVER),
    RecordedTopic("/current_reference", CURRENT_REFERENCE),
)
SPEED = 200.0


def block(type_name, first, size=100, seed=0):
    """Return one block of a machine that turns, with noise for currents and voltages, padded to 4 bytes as by DDS."""
    rng = np.random.default_rng([seed, first])
    values = [rng.normal(0, 10, size).astype(np.float32) for _ in BLOCK_FIELDS[type_name]]
    if type_name == RESOLVER:
        angle = SPEED * PERIOD * (first + np.arange(size))
        values = [((angle + np.pi) % (2 * np.pi) - np.pi).astype(np.float32), np.full(size, SPEED, np.float32)]
    session = (1, first, False, False) if type_name == CURRENT_REFERENCE else None
    data = encode_block(START + round(first * PERIOD * 1e9), first, PERIOD, values, "drive", session)
    return data + bytes(-len(data) % 4)


def feed(session, count, *, size=100, first=0, topics=TOPICS, lose=()):
    """Give a session ``count`` blocks per topic, without those whose number and topic are in ``lose``."""
    for number, topic in itertools.product(range(first, first + count), topics):
        if (number, topic.name) not in lose:
            data = block(topic.type_name, number * size, size)
            session.receive(topic.name, data, START + round((number + 1) * size * PERIOD * 1e9))


class FullDisk(io.FileIO):
    """A file on a disk with room for so many bytes, like a real one writing what fits before it refuses."""

    def __init__(self, path, room):
        super().__init__(path, "xb")
        self.room = room

    def write(self, data):
        fits = bytes(data)[: max(self.room - self.tell(), 0)]
        if not fits and data:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(fits)


def metadata(path):
    """Return what a bag says of itself."""
    return yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


def stock_messages(path):
    """Return topic, stamp and content of the messages that rosbags and mcap find, which must be the same, sorted."""
    with Reader(path) as reader:
        found = sorted((connection.topic, stamp, bytes(data)) for connection, stamp, data in reader.messages())
        assert reader.message_count == len(found)
    other = []
    for file in sorted(path.glob("*.mcap")):
        with file.open("rb") as stream:
            other += [(c.topic, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages()]
    assert sorted(other) == found
    return found
