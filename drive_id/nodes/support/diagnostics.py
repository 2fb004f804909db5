"""Publishes a node's health on ``/diagnostics`` once a second."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from drive_id.common.health import Health
from drive_id.nodes.support.clocks import STEADY

_PERIOD = 1.0  # s
_NAMED_TWICE = (
    "Another node is named {name} as well, and what both keep on their topics overwrites each other: end one, or give "
    "it a namespace; one that was killed is seen for some 20 s."
)


def _twins(node: Node) -> int:
    """Return the number of nodes in the graph with the full name of a node, itself included."""
    own = (node.get_name(), node.get_namespace())
    return sum(each == own for each in node.get_node_names_and_namespaces())


def publish_health(node: Node, read: Callable[[], Health]) -> None:
    """Publish what ``read`` returns as a node's health, now and every second."""
    publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def publish() -> None:
        health = read()
        if _twins(node) > 1:
            health = health.with_warning(_NAMED_TWICE.format(name=node.get_fully_qualified_name()))
        status = DiagnosticStatus(
            level=bytes([health.level]),
            name=node.get_fully_qualified_name(),
            hardware_id=node.get_namespace(),
            message=health.message,
            values=[KeyValue(key=key, value=value) for key, value in health.values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)

    publish()  # what the first message loads takes a millisecond, which no callback shall
    node.create_timer(_PERIOD, publish, clock=STEADY)
