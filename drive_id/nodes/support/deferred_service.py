"""Services that reply later without blocking the node."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from drive_id.nodes.support.qos import SERVICE


def in_executor(node: Node, call: Callable[[], None]) -> None:
    """Have the node's executor make a call; call this from any thread."""

    def guarded() -> None:
        try:
            call()
        except Exception:  # noqa: BLE001  # kills the events executor of rclpy up to 9.1
            node.get_logger().error(f"A mistake of drive_id, please report it: {traceback.format_exc()}")

    executor = node.executor
    if executor is not None:
        executor.create_task(guarded)


class Reply:
    """Sends the response of one request to its client."""

    def __init__(self, send: Callable[[Any, Any], None]) -> None:
        self._send = send
        self._header: Any = None
        self._response: Any = None

    def __call__(self, response: Any) -> None:
        """Send the response, once; call it in the executor's thread."""
        if self._header is None:  # the service callback has not returned yet
            self._response = response
        else:
            self._send(response, self._header)

    def attach(self, header: Any) -> None:
        """Set the request's header when the service callback has returned."""
        self._header = header
        if self._response is not None:
            self._send(self._response, header)


class DeferredService:
    """A service whose callback gets a :class:`Reply` to call at once or later.

    Not an ``async`` callback: the events executor of rclpy 7.1 does not support these, and the others keep a core busy
    while one awaits. Instead, the callback returns the reply itself, and ``send_response`` is replaced to wait for it.

    Parameters
    ----------
    node : Node
    kind : type
        Service type.
    name : str
    callback : callable
        Called with the request and its :class:`Reply`.
    """

    def __init__(self, node: Node, kind: Any, name: str, callback: Callable[[Any, Reply], None]) -> None:
        self._callback = callback
        self.service = node.create_service(kind, name, self._on_request, qos_profile=SERVICE)
        self._send_now = self.service.send_response
        self.service.send_response = self._send

    def _on_request(self, request: Any, _: Any) -> Reply:
        reply = Reply(self._send_now)
        self._callback(request, reply)
        return reply

    @staticmethod
    def _send(reply: Reply, header: Any) -> None:
        reply.attach(header)
