"""Subscriptions that are as reliable as the publishers of their topic allow."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from drive_id.files.storage.metadata import Qos
from drive_id.live.publishers import Publisher, of_type, reliable_wanted
from drive_id.nodes.qos import STREAM, STREAM_BEST_EFFORT


class MatchedSubscription:
    """A subscription that is made anew when the reliability of the publishers changes; call ``match`` now and then.

    Parameters
    ----------
    node : Node
    kind : type
        Of the messages.
    topic : str
        As given to ``create_subscription``.
    callback : callable
        Called with a message, or with its serialized bytes.
    depth : int
        Messages that may wait.
    raw : bool
        Serialized messages.
    """

    def __init__(
        self,
        node: Node,
        kind: type,
        topic: str,
        callback: Callable[[Any], None],
        *,
        depth: int = STREAM.depth,
        raw: bool = False,
    ) -> None:
        self.topic: str = node.resolve_topic_name(topic)
        self.type_name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        self.reliable = True
        self._node, self._kind, self._given, self._callback, self._depth, self._raw = (
            node, kind, topic, callback, depth, raw,
        )  # fmt: skip
        self.publishers: list[Publisher] = []
        self._subscription: Any = None
        self._generation = 0
        self.match()

    def match(self) -> None:
        """Look who publishes, and subscribe, or subscribe anew, accordingly."""
        self.publishers = [_publisher(info) for info in self._node.get_publishers_info_by_topic(self.topic)]
        wanted = reliable_wanted(self.publishers, self.type_name, self.reliable)
        if self._subscription is not None and wanted == self.reliable:
            return
        if self._subscription is not None:
            self.drain()
            self._node.destroy_subscription(self._subscription)
        self.reliable = wanted
        base = STREAM if wanted else STREAM_BEST_EFFORT
        qos = QoSProfile(
            history=base.history, depth=self._depth, reliability=base.reliability, durability=base.durability
        )
        # Without the default event callbacks: they only log what the diagnostics say anyhow, and an events executor
        # dies of an event of a subscription that is destroyed meanwhile.
        self._subscription = self._node.create_subscription(
            self._kind,
            self._given,
            self._receiver(),
            qos,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=self._raw,
        )

    def _receiver(self) -> Callable[[Any], None]:
        """Return the callback of a new subscription, deaf as soon as there is a newer one.

        An events executor keeps a destroyed subscription as long as it has events of it, and that one goes on receiving
        what the new one receives, too.
        """
        self._generation += 1
        generation = self._generation

        def receive(message: Any) -> None:
            if generation == self._generation:
                self._callback(message)

        return receive

    def drain(self) -> None:
        """Call the callback with every message that has arrived by now, instead of when the executor gets to it.

        An executor works off what waits in an order of its own: the single-threaded one serves a request after one
        message of each topic, however many came before it.
        """
        subscription = self._subscription
        for _ in range(self._depth):  # no more can wait; those that come meanwhile are not from before the call
            with subscription.handle:
                taken = subscription.handle.take_message(self._kind, self._raw)
            if taken is None:
                return
            self._callback(taken[0])

    def offered(self) -> Qos | None:
        """Return the quality of service that the topic is offered with; None while nobody publishes it."""
        for publisher in of_type(self.publishers, self.type_name):
            reliability = "reliable" if self.reliable else "best_effort"
            durability = "transient_local" if publisher.transient_local else "volatile"
            return Qos(publisher.depth or STREAM.depth, reliability, durability)
        return None


def _publisher(info: Any) -> Publisher:
    return Publisher(
        f"{info.node_namespace.rstrip('/')}/{info.node_name}",
        info.topic_type,
        info.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT,
        info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        info.qos_profile.depth,
    )
