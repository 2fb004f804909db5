"""The signals of a drive as messages: their types and fields, their headers, and who publishes them in blocks."""

from __future__ import annotations

import array
from collections.abc import Iterable
from typing import Any, TypeVar

import numpy as np
from drive_id_msgs.msg import PhaseCurrents, PhaseVoltages, Resolver, ScalarSamples
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.time import Time

from drive_id.nodes.support.qos import STREAM

KINDS = {"phase_currents": PhaseCurrents, "phase_voltages": PhaseVoltages, "resolver": Resolver}
_FIELDS = {"phase_currents": ("a", "b", "c"), "phase_voltages": ("a", "b", "c"), "resolver": ("angle", "speed")}
Headed = TypeVar("Headed")


def time_of(stamp: int) -> Any:
    """Return the message of a time, ns."""
    return Time(nanoseconds=stamp).to_msg()


def headed(message: Headed, stamp: int, frame_id: str) -> Headed:
    """Return a message whose header has been set; the stamp in ns."""
    header: Any = message.header  # type: ignore[attr-defined]  # any message with a header
    header.stamp, header.frame_id = time_of(stamp), frame_id
    return message


class SignalPublishers:
    """Publishers of a drive's signals, those of the optional signals named and of others from their first block on."""

    def __init__(self, node: Node, frame_id: str, scalars: Iterable[str] = ()) -> None:
        self._node, self._frame_id = node, frame_id
        self._publishers: dict[str, Any] = {}
        for name in (*KINDS, *scalars):
            self._open(name)

    def listeners(self) -> dict[str, int]:
        """Return the number of subscribers to each of the three signals that every drive has, by topic."""
        publishers = (self._publishers[name] for name in KINDS)
        return {publisher.topic_name: publisher.get_subscription_count() for publisher in publishers}

    def publish(self, name: str, block: Any, columns: Iterable[NDArray[np.float32]]) -> None:
        """Publish the columns of a signal; of the block, stamp, count and sample period are taken."""
        if name not in self._publishers:
            self._open(name)
        message = KINDS.get(name, ScalarSamples)(first_sample=block.first_sample, sample_period=block.sample_period)
        for field, column in zip(_FIELDS.get(name, ("value",)), columns, strict=True):
            setattr(message, field, array.array("f", column.tobytes()))
        self._publishers[name].publish(headed(message, block.stamp, self._frame_id))

    def _open(self, name: str) -> None:
        self._publishers[name] = self._node.create_publisher(KINDS.get(name, ScalarSamples), name, STREAM)
