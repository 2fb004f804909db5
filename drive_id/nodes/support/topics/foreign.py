"""Subscriptions to a bench's own topics, whose messages a signals file translates."""

from __future__ import annotations

from functools import partial

from rclpy.node import Node

from drive_id.common.health import Level, Observation
from drive_id.errors import ConfigurationError, DriveIdError
from drive_id.files.storage.container import TopicInfo
from drive_id.live.translator import Translator
from drive_id.nodes.support.topics.matched import MatchedSubscription
from drive_id.nodes.support.topics.types import definition, message_class


class ForeignTopics:
    """Subscribes to a translator's topics as soon as somebody publishes them; ``depth`` messages of each may wait."""

    def __init__(self, node: Node, translator: Translator, depth: int) -> None:
        self._node, self._translator, self._depth = node, translator, depth
        self._subscriptions: dict[str, MatchedSubscription] = {}
        self._troubles: dict[str, str] = {}

    def match(self) -> None:
        """Look up the publishers; call it periodically."""
        for given in self._translator.topics:
            if given in self._subscriptions:
                self._subscriptions[given].match()
            else:
                self._subscribe(given)

    def close(self) -> None:
        """End the subscriptions; :meth:`match` subscribes again."""
        for subscription in self._subscriptions.values():
            subscription.close()
        self._subscriptions = {}

    def findings(self) -> list[Observation]:
        """Return the topics that nobody publishes, what cannot be read, and clocks that differ."""
        missing = [
            f"Nobody publishes {self._node.resolve_topic_name(given)}."
            for given in self._translator.topics
            if given not in self._subscriptions and given not in self._troubles
        ]
        said = filter(None, (self._translator.last_error, self._translator.clock_finding()))
        return [(Level.WARN, sentence) for sentence in (*self._troubles.values(), *missing, *said)]

    def _subscribe(self, given: str) -> None:
        name = self._node.resolve_topic_name(given)
        infos = self._node.get_publishers_info_by_topic(name)
        if not infos:
            return
        type_name = infos[0].topic_type
        try:
            kind = message_class(type_name)
            text = definition(type_name)
            if not text:
                raise ConfigurationError(f"the definition of {type_name} is not installed beside its Python package.")
            self._translator.found(given, TopicInfo(name, type_name, None, "cdr", "ros2msg", text))
        except DriveIdError as error:
            self._troubles[given] = f"{name} cannot be read: {error}"
            return
        self._troubles.pop(given, None)
        self._subscriptions[given] = MatchedSubscription(
            self._node, kind, given, partial(self._on_message, given), depth=self._depth
        )

    def _on_message(self, given: str, data: bytes) -> None:
        self._translator.receive(given, data, int(self._node.get_clock().now().nanoseconds))
