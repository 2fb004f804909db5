"""What a recorder listens to: the signals of a drive, and further topics."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from drive_id_msgs.msg import CurrentReference, ScalarSamples
from rclpy.node import Node

from drive_id.files.messages.messages import type_hash
from drive_id.live.publishers import Publisher, of_type
from drive_id.live.recording.recorder_health import TopicState
from drive_id.live.recording.recording_session import RecordedTopic
from drive_id.nodes.support.signal_messages import KINDS
from drive_id.nodes.support.topics.extra import ExtraTopics
from drive_id.nodes.support.topics.matched import MatchedSubscription
from drive_id.types import SCALARS

TOPICS = KINDS | {"current_reference": CurrentReference} | dict.fromkeys(SCALARS, ScalarSamples)


class RecordedTopics:
    """Subscribes between :meth:`open` and :meth:`close`; hands topic and serialized message to ``receive``."""

    def __init__(self, node: Node, receive: Callable[[str, bytes], None], depth: int) -> None:
        self._node, self._receive, self._depth = node, receive, depth
        self._optional = {node.resolve_topic_name(name) for name in SCALARS}
        self._last: dict[str, float] = {}
        self._topics: list[MatchedSubscription] = []
        self.extra = ExtraTopics(node, [node.resolve_topic_name(name) for name in TOPICS], self._on_message, depth)

    def open(self) -> None:
        """Subscribe to the signals of the drive."""
        self._topics = [
            MatchedSubscription(
                self._node, kind, name, partial(self._on_message, self._node.resolve_topic_name(name)),
                depth=self._depth,
            )
            for name, kind in TOPICS.items()
        ]  # fmt: skip
        for topic in self._topics:
            type_hash(topic.type_name)  # kept for the start of a recording; the first one loads a parser

    def close(self) -> None:
        """End all subscriptions."""
        for topic in self._topics:
            topic.close()
        self._topics = []
        self.extra.close()

    def match(self) -> list[RecordedTopic]:
        """Look up the publishers, and return the further topics that have come up."""
        for topic in self._topics:
            topic.match()
        return self.extra.match() if self._topics else []

    def publishers(self) -> dict[str, list[Publisher]]:
        """Return who publishes each of the drive's topics as it should be."""
        return {topic.topic: of_type(topic.publishers, topic.type_name) for topic in self._topics}

    def drain(self) -> None:
        """Take all messages that have arrived before now."""
        for topic in self._topics:
            topic.drain()
        self.extra.drain()

    def begin(self) -> list[RecordedTopic]:
        """Take what has arrived, and return the topics of a recording that begins here."""
        self.match()
        self.drain()
        self._last.clear()
        recorded = [
            RecordedTopic(topic.topic, topic.type_name, topic.offered(), topic.topic in self._optional)
            for topic in self._topics
        ]
        return [*recorded, *self.extra.recorded()]

    def states(self) -> list[TopicState]:
        """Return publishers and activity of the signals of the drive."""
        now = time.monotonic()
        return [
            TopicState(
                topic.topic,
                topic.type_name,
                topic.publishers,
                now - self._last[topic.topic] if topic.topic in self._last else None,
                topic.topic in self._optional,
            )
            for topic in self._topics
        ]

    def _on_message(self, topic: str, data: bytes) -> None:
        self._last[topic] = time.monotonic()
        self._receive(topic, data)
