"""Quality of service of the topics."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo

# What is not given is as in rclpy: the last messages are kept, reliable, and volatile.
STREAM = QoSProfile(depth=1000)
"""Blocks of samples, none of which may be lost; a depth of 10 silently loses samples at 1 kHz."""
STREAM_BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For subscriptions to best-effort publishers, from which a reliable subscription receives nothing."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The flux map: late subscribers get the last one."""
SERVICE = QoSProfile(depth=10_000)
"""Of services: the default keeps the last 10 requests, and whoever sent one before waits in vain."""

_UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""Name that the middleware gives to the node of an endpoint before it knows better, and after the node is gone."""


def overridable(profile: QoSProfile) -> dict[str, Any]:
    """Return arguments for a publisher whose history, depth and reliability are parameters, read at the start.

    (``qos_overrides./flux_map.publisher.reliability``.) For topics that displays and bridges subscribe to; references,
    feedback and what stops a drive have none. rclpy changes the profile that it is given, so it gets one of its own.
    """
    return {
        "qos_profile": copy.copy(profile),
        "qos_overriding_options": QoSOverridingOptions.with_default_policies(),
    }


def incompatible_subscriptions(node: Node, topic: str) -> list[str]:
    """Return a sentence for each subscription whose type or QoS does not match the node's own publisher of a topic.

    Parameters
    ----------
    topic : str
        As given to ``create_publisher``.
    """
    name = node.resolve_topic_name(topic)
    own = [
        info for info in node.get_publishers_info_by_topic(name) if full_name(info) == node.get_fully_qualified_name()
    ]
    if not own:
        return []  # not yet in the graph
    kind, offered = own[0].topic_type, own[0].qos_profile  # from the graph: STREAM has 0 for infinite durations
    sentences = []
    for info in node.get_subscriptions_info_by_topic(name):
        if info.node_name == _UNKNOWN:
            continue
        compatibility, reason = qos_check_compatible(offered, info.qos_profile)
        if info.topic_type != kind:
            why = f"it expects {info.topic_type} instead of {kind}."
        elif compatibility == QoSCompatibility.ERROR:
            why = f"its quality of service is incompatible ({reason.removeprefix('ERROR: ').strip(' ;')})."
        else:
            continue
        sentences.append(f"{full_name(info)} receives nothing on {name}: {why}")
    return sentences


def known_nodes(endpoints: Iterable[TopicEndpointInfo]) -> list[str]:
    """Return the full names of the nodes of endpoints, without those that have not arrived or are gone."""
    return [full_name(info) for info in endpoints if info.node_name != _UNKNOWN]


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node of an endpoint."""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"
