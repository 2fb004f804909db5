"""Managed nodes: requests that make no sense are refused, and do not end the process."""

from __future__ import annotations

from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode


def guard_transitions(node: LifecycleNode) -> None:
    """Answer requests for impossible transitions by ``success: false``.

    rclpy raises an error in the callback instead, which ends the process: with the events executor by SIGSEGV.

    Parameters
    ----------
    node : LifecycleNode
    """
    (service,) = (service for service in node.services if service.srv_type is ChangeState)
    change = service.callback

    def guarded(request: Any, response: Any) -> Any:
        try:
            return change(request, response)
        except Exception as error:  # noqa: BLE001  # RCLError, which is in a private module
            wanted = request.transition.label or request.transition.id
            node.get_logger().warning(f"Transition {wanted} is not possible now ({error}).")
            response.success = False
            return response

    service.callback = guarded
