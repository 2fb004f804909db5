"""Publishes a node's health on ``/diagnostics`` once a second."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from drive_id.health import Health

_PERIOD = 1.0  # s


class HealthPublisher:
    """Publishes a node's health every second of the steady clock.

    Parameters
    ----------
    read : callable
        Returns the present health.
    """

    def __init__(self, node: Node, read: Callable[[], Health]) -> None:
        self._node = node
        self._read = read
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.publish()  # what the first message loads takes a millisecond, which no callback shall
        self._timer = node.create_timer(_PERIOD, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish the present health."""
        health = self._read()
        status = DiagnosticStatus(
            level=bytes([health.level]),
            name=self._node.get_fully_qualified_name(),
            hardware_id=self._node.get_namespace(),
            message=health.message,
            values=[KeyValue(key=key, value=value) for key, value in health.values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
