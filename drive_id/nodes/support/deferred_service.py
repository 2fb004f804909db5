"""Services that reply later without blocking the node, and not faster than clients take the replies."""

from __future__ import annotations

import time
import traceback
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.service import Service

from drive_id.errors import DriveIdError
from drive_id.live.worker import Worker
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.qos import SERVICE
from drive_id.types import Progress

_BURST = 5
"""Replies sent at once: the queue of a client keeps ten, those to other clients of the service included."""
_PAUSE = 0.02
"""Time between two bursts, s: more than a client that waits takes for one."""
_PATIENCE = 0.3
"""Time before a further reply is sent, s: so long a client may go on sending requests before it listens."""
MOST_LISTED = 100
"""Entries of a list for which no number was asked."""


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


class PacedServices:
    """Creates services whose replies are all received, also those to a thousand requests at once.

    With the default quality of service, a client loses the replies that arrive while ten others wait. So the first few
    replies are sent at once, and what else is to be sent in the same moment waits for its turn.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._waiting: deque[tuple[float, Callable[[], None]]] = deque()
        self._free = _BURST
        node.create_timer(_PAUSE, self._on_timer, clock=STEADY)

    def create(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> Service:
        """Create a service."""
        service = self._node.create_service(kind, name, callback, qos_profile=SERVICE)
        service.send_response = partial(self._offer, service.send_response)
        return service

    def _offer(self, send: Callable[[Any, Any], None], response: Any, header: Any) -> None:
        if self._free and not self._waiting:
            self._free -= 1
            send(response, header)
        else:
            self._waiting.append((time.monotonic() + _PATIENCE, partial(send, response, header)))

    def _on_timer(self) -> None:
        self._free = _BURST
        while self._free and self._waiting and self._waiting[0][0] <= time.monotonic():
            self._free -= 1
            self._waiting.popleft()[1]()


class LaterResponse:
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


def deferred_service(
    services: PacedServices, kind: Any, name: str, callback: Callable[[Any, LaterResponse], None]
) -> None:
    """Create a service whose callback gets a :class:`LaterResponse` to call at once or later.

    Not an ``async`` callback: the events executor of rclpy 7.1 does not support these, and the others keep a core busy
    while one awaits. Instead, the callback returns the reply itself, and ``send_response`` is replaced to wait for it.

    Parameters
    ----------
    kind : type
        Service type.
    callback : callable
        Called with the request and its :class:`LaterResponse`.
    """

    def on_request(request: Any, _: Any) -> LaterResponse:
        reply = LaterResponse(send)
        callback(request, reply)
        return reply

    service = services.create(kind, name, on_request)
    send, service.send_response = service.send_response, LaterResponse.attach


class Lookups:
    """Services that read folders in a thread, so that no callback waits for a disk; while one does, others are busy.

    Their requests are answered with ``success``, ``code`` and ``message``.
    """

    def __init__(self, node: Node, services: PacedServices) -> None:
        self._node, self._services = node, services
        self._worker: Worker[Any] = Worker()

    def serve(self, kind: Any, name: str, look: Callable[[Any, Any], Any]) -> None:
        """Create a service; ``look`` fills the response and returns it, in the thread, or raises DriveIdError."""

        def on_request(request: Any, answer: LaterResponse) -> None:
            if self._worker.busy:
                answer(kind.Response(code="busy", message="Folders are being read for another request: ask again."))
                return
            job = partial(self._looked, kind, look, request)
            self._worker.start(job, lambda response: in_executor(self._node, lambda: answer(response)))

        deferred_service(self._services, kind, name, on_request)

    def _looked(self, kind: Any, look: Callable[[Any, Any], Any], request: Any, _: Progress) -> Any:
        try:
            return look(request, kind.Response(success=True, code="ok"))
        except DriveIdError as error:
            return kind.Response(code=error.code, message=str(error))
        except Exception:  # noqa: BLE001  # whoever asked waits for an answer
            self._node.get_logger().error(f"A mistake of drive_id, please report it: {traceback.format_exc()}")
            return kind.Response(code="internal", message="The folders could not be read: report this as a bug.")
