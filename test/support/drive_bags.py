"""Recordings that are wrong in one way each, made from a good one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from drive_id.core.experiment.trajectories import Lissajous
from drive_id.files.messages.block_codec import encode_block
from drive_id.files.messages.messages import PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter
from drive_id.types import Samples

TOPICS = {"/phase_currents": PHASE_CURRENTS, "/phase_voltages": PHASE_VOLTAGES, "/resolver": RESOLVER}
BLOCK = 100
TRAJECTORY = Lissajous(frequency_d=7.3, frequency_q=2.3)
"""Fills the disc within a second or two."""

Blocks = dict[str, list[dict]]


def blocks_of(samples: Samples) -> Blocks:
    """Return what is to be recorded: topic to the parts of its messages, which a test may change."""
    values = {
        "/phase_currents": samples.i_abc,
        "/phase_voltages": samples.u_abc,
        "/resolver": np.column_stack([samples.angle, samples.speed]),
    }
    return {
        topic: [
            {
                "stamp": int(samples.stamp[start]),
                "first": start,
                "period": samples.sample_period,
                "values": array[start : start + BLOCK].astype(np.float32),
            }
            for start in range(0, len(samples), BLOCK)
        ]
        for topic, array in values.items()
    }


def write_blocks(path: Path, blocks: Blocks, types: Mapping[str, str] = TOPICS) -> Path:
    """Record messages in the order in which their samples were taken, each on a topic of the given type."""
    queue = [(block["first"], topic, block) for topic, parts in blocks.items() for block in parts]
    with Rosbag2McapWriter(path) as writer:
        for topic in blocks:
            writer.add_topic(topic, types[topic])
        for first, topic, block in sorted(queue, key=lambda entry: entry[:2]):
            columns = [np.ascontiguousarray(column) for column in block["values"].T]
            data = encode_block(block["stamp"], block["first"], block["period"], columns, "drive")
            writer.write(topic, data, (first + BLOCK) * 100_000)
    return path


def renamed(source: Path, target: Path, namespace: str = "", **names: str) -> Path:
    """Copy a bag of ours, without its truth, with its topics in a namespace and some of them with other names."""

    def name(topic: str) -> str:
        own = topic.removeprefix("/")
        return f"{namespace and '/'}{namespace}/{names.get(own, own)}"

    with open_bag(source) as bag, Rosbag2McapWriter(target) as writer:
        for topic in bag.topics.values():
            writer.add_topic(name(topic.name), topic.type_name)
        for message in bag.messages(frozenset(bag.topics)):
            writer.write(name(message.topic), bytes(message.data), message.log_time)
    return target


def changed(path: Path, samples: Samples, change: Callable[[Blocks], object]) -> Path:
    """Record samples after a change of their messages."""
    blocks = blocks_of(samples)
    change(blocks)
    return write_blocks(path, blocks)


def with_arrays(samples: Samples, **arrays: np.ndarray) -> Samples:
    """Replace signals and forget the references, as a stranger's recording has none."""
    return replace(samples, i_dq_reference=None, **arrays)
