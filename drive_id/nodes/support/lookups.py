"""Services that read folders: in a thread, one after the other, so that no callback waits for a disk."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node

from drive_id.errors import DriveIdError
from drive_id.live.worker import Worker
from drive_id.nodes.support.deferred_service import LaterResponse, PacedServices, deferred_service, in_executor
from drive_id.types import Progress

MOST_LISTED = 100
"""Entries of a list for which no number was asked."""


class Lookups:
    """Serves requests with ``success``, ``code`` and ``message``; while one is under way, others are ``busy``."""

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
