"""The node ``live_feed``: prints what the topics of a drive tell, one JSON object a line, for ``drive-id serve``.

It only listens, and uses no shared memory: killed or held up, it keeps no other process waiting.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from drive_id_msgs.msg import DriveStatus, FluxMap, OperatingPoint, PublisherState
from rclpy.node import Node

from drive_id.live.live_view import LiveView
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.qos import LATCHED, STREAM_BEST_EFFORT
from drive_id.nodes.support.runtime import run

_PERIOD = 0.2  # s between lines
_HEARTBEAT = 2.0  # s after which a line comes although nothing is new
_STATES = {
    "publisher": ("state", "reason", "dry_run", "elapsed", "duration", "coverage", "completed"),
    "drive": ("enabled", "fault", "speed", "dc_link_voltage", "winding_temperature"),
}


class LiveFeed(Node):
    """Subscribes, and prints while somebody reads."""

    def __init__(self) -> None:
        super().__init__("live_feed")
        self._view = LiveView()
        self._said = time.monotonic()
        topics: dict[str, tuple[type, Any, Any]] = {
            "operating_point": (OperatingPoint, lambda m: self._view.point(m.i_d, m.i_q, m.speed), STREAM_BEST_EFFORT),
            "flux_map": (FluxMap, self._view.flux_map, LATCHED),
            "trajectory_publisher/state": (PublisherState, partial(self._on_state, "publisher"), LATCHED),
            "drive_status": (DriveStatus, partial(self._on_state, "drive"), STREAM_BEST_EFFORT),
            "/diagnostics": (DiagnosticArray, self._on_diagnostics, STREAM_BEST_EFFORT),
        }
        self._kept = [self.create_subscription(kind, name, act, qos) for name, (kind, act, qos) in topics.items()]
        self.create_timer(_PERIOD, self._print, clock=STEADY)

    def _on_state(self, name: str, message: Any) -> None:
        again = time.monotonic() if name == "drive" else None  # the publisher is heard by its diagnostics
        self._view.state(name, {field: getattr(message, field) for field in _STATES[name]}, again)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        own = self.get_namespace().rstrip("/") + "/"
        for status in message.status:
            if status.name.startswith(own) and status.hardware_id == self.get_namespace():
                values = {entry.key: entry.value for entry in status.values}
                self._view.health(status.name, ord(status.level), status.message, values, time.monotonic())

    def _print(self) -> None:
        now = time.monotonic()
        found = self._view.take(now)
        if not found and now < self._said + _HEARTBEAT:
            return
        self._said = now
        try:
            sys.stdout.write(json.dumps(found, allow_nan=False) + "\n")
            sys.stdout.flush()
        except BrokenPipeError:  # nobody reads any more
            os.kill(os.getpid(), signal.SIGTERM)


def main() -> None:
    """Run the node ``live_feed``."""
    run(LiveFeed, shared_memory=False)


if __name__ == "__main__":
    main()
