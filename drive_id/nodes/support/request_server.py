"""Requests that take long, by an action and by a service: goals have progress, and can be cancelled."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionServer, CancelResponse
from rclpy.node import Node

from drive_id.live.identification.identifier import CANCELLED, VANISHED, Job, Reply
from drive_id.live.identification.requests import Request, Requests, Stage
from drive_id.nodes.support.deferred_service import LaterResponse, PacedServices, deferred_service, in_executor
from drive_id.nodes.support.qos import SERVICE

_KEPT = 60  # s for which a result can be asked for
_GONE = 2.0  # s without a client after which it is gone


class _HoldingServer(ActionServer):
    """An action server whose goals execute until :meth:`conclude`, without a callback that waits.

    A callback that awaits keeps a core busy in the executors of rclpy 7.1; one that blocks holds the node up.
    """

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Do nothing when a goal begins."""

    def conclude(self, goal_handle: Any, callback: Callable[[Any], Any]) -> None:
        """Have the callback set the goal's last state and return its result."""
        super().notify_execute(goal_handle, callback)


class RequestServer:
    """Serves requests by an action and, if given, by a service of the same name.

    Parameters
    ----------
    make : callable
        Returns the job of a request, of either kind.
    fill : callable
        Fills a response or result with a reply, and returns it.
    feedback : callable, optional
        Makes the feedback of the action; without it, that has ``stage``, ``progress`` and ``message``.
    may_wait : bool
        A goal may wait for the request under way.
    """

    def __init__(
        self,
        node: Node,
        services: PacedServices,
        service: Any | None,
        action: Any,
        name: str,
        requests: Requests,
        make: Callable[[Any], Job],
        fill: Callable[[Any, Reply], Any],
        *,
        feedback: Callable[[Stage], Any] | None = None,
        may_wait: bool = True,
    ) -> None:
        self._node = node
        self._service, self._action = service, action
        self._requests = requests
        self._make = make
        self._fill = fill
        self._feedback, self._may_wait = feedback or self._plain, may_wait
        self._goals: dict[bytes, Request] = {}
        self._listened = f"{node.resolve_service_name(name)}/_action/feedback"  # every action client subscribes to it
        self._last_seen: float | None = None  # when a client was last seen, s
        if service is not None:
            deferred_service(services, service, name, self._on_request)
        self._server = _HoldingServer(
            node,
            action,
            name,
            lambda _: None,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
            result_timeout=_KEPT,
            goal_service_qos_profile=SERVICE,
            result_service_qos_profile=SERVICE,
            cancel_service_qos_profile=SERVICE,
        )

    def look(self) -> None:
        """Look after the requests, and cancel goals whose clients are gone; call it ten times a second."""
        self._requests.look()
        now = time.monotonic()
        if not self._goals or self._node.count_subscribers(self._listened):
            self._last_seen = now if self._goals else None
        elif self._last_seen is not None and now - self._last_seen > _GONE:
            for request in list(self._goals.values()):
                self._requests.cancel(request, VANISHED)

    def _on_request(self, request: Any, answer: LaterResponse) -> None:
        def finish(reply: Reply) -> None:
            assert self._service is not None
            answer(self._fill(self._service.Response(), reply))

        self._requests.submit(Request(partial(self._make, request), finish), may_wait=False)

    def _on_accepted(self, goal: Any) -> None:
        in_executor(self._node, lambda: self._accept(goal))  # an error here would end the process

    def _accept(self, goal: Any) -> None:
        def make() -> Job:
            goal.execute()
            return self._make(goal.request)

        request = Request(make, partial(self._finish, goal), partial(self._tell, goal))
        self._goals[_key(goal)] = request
        self._requests.submit(request, may_wait=self._may_wait)

    def _on_cancel(self, goal: Any) -> CancelResponse:
        in_executor(self._node, lambda: self._cancel(goal))  # the goal is being cancelled only after this
        return CancelResponse.ACCEPT

    def _cancel(self, goal: Any) -> None:
        request = self._goals.get(_key(goal))
        if request is not None:
            self._requests.cancel(request, CANCELLED)

    def _tell(self, goal: Any, stage: Stage) -> None:
        goal.publish_feedback(self._feedback(stage))

    def _plain(self, stage: Stage) -> Any:
        return self._action.Feedback(stage=stage.name, progress=stage.share, message=stage.sentence)

    def _finish(self, goal: Any, reply: Reply) -> None:
        del self._goals[_key(goal)]
        if goal.status == GoalStatus.STATUS_ACCEPTED and not goal.is_cancel_requested:
            goal.execute()  # a goal that has not begun cannot be aborted
        self._server.conclude(goal, partial(self._conclude, reply))

    def _conclude(self, reply: Reply, goal: Any) -> Any:
        result = self._fill(self._action.Result(), reply)
        if reply.success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result


def _key(goal: Any) -> bytes:
    return bytes(goal.goal_id.uuid)
