"""Further topics of the recorder, of whatever type their publishers have."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial

from rclpy.node import Node
from rclpy.validate_topic_name import validate_topic_name

from drive_id.common.health import Level, Observation
from drive_id.errors import ConfigurationError
from drive_id.live.recording.recording_session import RecordedTopic
from drive_id.nodes.support.topics.matched import MatchedSubscription
from drive_id.nodes.support.topics.types import definition, message_class

_MOST_LATCHED = 100
"""Messages of a transient local topic that are kept for the beginning of a recording."""


class ExtraTopics:
    """Subscribes to further topics as soon as somebody publishes them; ``depth`` messages of each may wait.

    Parameters
    ----------
    own : collection of str
        Absolute names of the topics that are recorded anyway.
    receive : callable
        Called with topic and serialized message.
    """

    def __init__(self, node: Node, own: Sequence[str], receive: Callable[[str, bytes], None], depth: int) -> None:
        self._node = node
        self._own = frozenset(own)
        self._receive = receive
        self._depth = depth
        self._wanted: list[str] = []
        self._needed: list[str] = []
        self._subscriptions: dict[str, MatchedSubscription] = {}
        self._recorded: dict[str, RecordedTopic] = {}
        self._latched: dict[str, deque[bytes]] = {}
        self._troubles: dict[str, str] = {}

    def want(self, names: Sequence[str], perhaps: Sequence[str] = ()) -> None:
        """Take other topics, relative or absolute; subscriptions stay until the process ends.

        That nobody publishes one of ``perhaps`` is no trouble. Raises ConfigurationError when a name is none.
        """
        self._needed = self.resolved(names)
        wanted = dict.fromkeys([*self._needed, *self.resolved(perhaps)])
        self._wanted = [name for name in wanted if name not in self._own]
        self._troubles = {}

    def resolved(self, names: Sequence[str]) -> list[str]:
        """Return the absolute names of topics, see :meth:`want`."""
        try:
            for name in names:
                validate_topic_name(name)
            return [self._node.resolve_topic_name(name) for name in names]
        except Exception as error:  # also RCLError, which is in a private module
            first = str(error).partition(":\n")[0]
            raise ConfigurationError(f"extra_topics holds what is not the name of a topic ({first}).") from error

    def match(self) -> list[RecordedTopic]:
        """Look up the publishers, and return the topics that have come up."""
        found = []
        for name in self._wanted:
            if name in self._subscriptions:
                self._subscriptions[name].match()
            elif (topic := self._subscribe(name)) is not None:
                found.append(topic)
        return found

    def recorded(self) -> list[RecordedTopic]:
        """Return the topics that are subscribed to."""
        return [self._recorded[name] for name in self._wanted if name in self._recorded]

    def latched(self) -> list[tuple[str, bytes]]:
        """Return the messages of transient local topics, with which a recording begins."""
        return [(name, data) for name in self._wanted for data in self._latched.get(name, ())]

    def drain(self) -> None:
        """Take all messages that have arrived before now."""
        for subscription in self._subscriptions.values():
            subscription.drain()

    def close(self) -> None:
        """End the subscriptions; :meth:`match` subscribes again."""
        for subscription in self._subscriptions.values():
            subscription.close()
        self._subscriptions, self._recorded, self._latched = {}, {}, {}

    def findings(self) -> list[Observation]:
        """Return the topics that nobody publishes, or whose type is not installed."""
        missing = [name for name in self._wanted if name in self._needed and name not in self._subscriptions]
        missing = [name for name in missing if name not in self._troubles]
        said = [f"Nobody publishes the extra topic {name}." for name in missing]
        return [(Level.WARN, sentence) for sentence in (*self._troubles.values(), *said)]

    def _subscribe(self, name: str) -> RecordedTopic | None:
        infos = self._node.get_publishers_info_by_topic(name)
        if not infos:
            return None
        info = infos[0]
        try:
            kind = message_class(info.topic_type)
        except ConfigurationError as error:
            self._troubles[name] = f"The extra topic {name} is not recorded: {error}"
            return None
        self._troubles.pop(name, None)
        subscription = MatchedSubscription(
            self._node, kind, name, partial(self._on_message, name), depth=self._depth, latched=True
        )
        self._subscriptions[name] = subscription
        topic = RecordedTopic(
            name, info.topic_type, subscription.offered(), optional=True, blocks=False,
            definition=definition(info.topic_type), hash_=str(getattr(info, "topic_type_hash", "")),
        )  # fmt: skip
        self._recorded[name] = topic
        return topic

    def _on_message(self, name: str, data: bytes) -> None:
        if self._subscriptions[name].latched:
            self._latched.setdefault(name, deque(maxlen=_MOST_LATCHED)).append(data)
        self._receive(name, data)
