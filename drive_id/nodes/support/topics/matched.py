"""Subscriptions with the reliability that the publishers of their topic offer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from drive_id.files.storage.metadata import Qos
from drive_id.live.publishers import Publisher, of_type, reliable_wanted
from drive_id.nodes.support.qos import STREAM, STREAM_BEST_EFFORT, full_name


class MatchedSubscription:
    """A subscription that is replaced when the reliability of the publishers changes; call ``match`` periodically.

    Parameters
    ----------
    kind : type
        Message type.
    topic : str
        As given to ``create_subscription``.
    callback : callable
        Called with the bytes of each serialized message.
    depth : int
        Queue depth, messages.
    latched : bool
        Ask for the messages of before where all publishers keep them (transient local).
    """

    def __init__(
        self,
        node: Node,
        kind: type,
        topic: str,
        callback: Callable[[bytes], None],
        *,
        depth: int = STREAM.depth,
        latched: bool = False,
    ) -> None:
        self.topic: str = node.resolve_topic_name(topic)
        self.type_name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        self.reliable = True
        self.latched = False
        """Whether the messages of before come, too."""
        self._may_be_latched = latched
        self._node, self._kind, self._given, self._callback, self._depth = node, kind, topic, callback, depth
        self.publishers: list[Publisher] = []
        self._subscription: Any = None
        self._generation = 0
        self.match()

    def match(self) -> None:
        """Look up the publishers, and subscribe with a reliability that matches them."""
        self.publishers = [_publisher(info) for info in self._node.get_publishers_info_by_topic(self.topic)]
        wanted = reliable_wanted(self.publishers, self.type_name, self.reliable)
        right = of_type(self.publishers, self.type_name)
        kept = all(publisher.transient_local for publisher in right) if right else self.latched
        latched = self._may_be_latched and kept
        if self._subscription is not None and (wanted, latched) == (self.reliable, self.latched):
            return
        if self._subscription is not None:
            self.drain()
            self._node.destroy_subscription(self._subscription)
        self.reliable, self.latched = wanted, latched
        base = STREAM if wanted else STREAM_BEST_EFFORT
        qos = QoSProfile(
            history=base.history, depth=self._depth, reliability=base.reliability,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else base.durability,
        )  # fmt: skip
        # Without the default event callbacks: they log what the diagnostics say anyway, and an event of a destroyed
        # subscription kills the events executor.
        self._subscription = self._node.create_subscription(
            self._kind,
            self._given,
            self._receiver(),
            qos,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )

    def close(self) -> None:
        """End the subscription; :meth:`match` subscribes again."""
        self._generation += 1
        self._node.destroy_subscription(self._subscription)
        self._subscription = None

    def _receiver(self) -> Callable[[bytes], None]:
        """Return a callback that ignores messages as soon as there is a newer subscription.

        An events executor keeps a destroyed subscription while it has events of it, and both then receive the same
        messages.
        """
        self._generation += 1
        generation = self._generation

        def receive(data: bytes) -> None:
            if generation == self._generation:
                self._callback(data)

        return receive

    def drain(self) -> None:
        """Call the callback now with every message that has arrived.

        Executors do not keep the order of arrival: the single-threaded one serves a request after one message of each
        topic, however many arrived before it.
        """
        subscription = self._subscription
        for _ in range(self._depth):  # more cannot wait; what arrives meanwhile is none of ours
            with subscription.handle:
                taken = subscription.handle.take_message(self._kind, True)
            if taken is None:
                return
            self._callback(taken[0])

    def offered(self) -> Qos | None:
        """Return the quality of service that the publishers offer; None while nobody publishes."""
        for publisher in of_type(self.publishers, self.type_name):
            reliability = "reliable" if self.reliable else "best_effort"
            durability = "transient_local" if publisher.transient_local else "volatile"
            return Qos(publisher.depth or STREAM.depth, reliability, durability)
        return None


def _publisher(info: Any) -> Publisher:
    return Publisher(
        full_name(info),
        info.topic_type,
        info.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT,
        info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        info.qos_profile.depth,
        bytes(info.endpoint_gid).hex(),
    )
