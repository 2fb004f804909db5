"""Managed nodes: what all of them share, and requests for transitions that make no sense."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from drive_id.common.health import Health, Level
from drive_id.common.settings import Checked, setting
from drive_id.nodes.support.deferred_service import PacedServices
from drive_id.nodes.support.parameters import declare_settings


@dataclass(frozen=True)
class ManagedSettings(Checked):
    """Who brings a managed node up."""

    autostart: bool = setting(True, "Configure the node at its start, without a lifecycle manager")
    activate: bool = setting(True, "Activate it as well; false: it subscribes and waits to be activated")


def guard_transitions(node: LifecycleNode) -> None:
    """Answer requests for impossible transitions by ``success: false``.

    rclpy raises an error in the callback instead, which ends the process: with the events executor by SIGSEGV.
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


class ManagedNode(LifecycleNode):
    """A managed node that configures itself unless ``autostart`` is false, and activates itself unless ``activate`` is.

    Subclasses call :meth:`bring_up` at the end of their constructor, and define :meth:`connect`, :meth:`disconnect` and
    :meth:`rest`. Services and diagnostics are there in every state.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        guard_transitions(self)
        self.paced = PacedServices(self)
        self.active = self._connected = self._finalized = False
        self._managed = declare_settings(self, ManagedSettings, read_only=ManagedSettings.__dataclass_fields__)

    def bring_up(self, ready: str) -> None:
        """Configure and activate the node as far as it does so by itself; log ``ready`` or what it waits for."""
        configured = self._managed.autostart and self.trigger_configure() is TransitionCallbackReturn.SUCCESS
        if configured and self._managed.activate:
            self.trigger_activate()
        self.get_logger().info(ready if self.active else self.inactive())

    def connect(self) -> None:
        """Subscribe."""
        raise NotImplementedError

    def disconnect(self) -> None:
        """End all subscriptions, and forget what has arrived."""
        raise NotImplementedError

    def rest(self) -> bool:
        """End what is under way; return whether it has ended."""
        return True

    def answer(self, request: str, response: Any, code: str, message: str) -> Any:
        """Fill the response of a service and return it; log what it says, too: a calling script may ignore it."""
        response.success, response.message = code == "ok", message
        if hasattr(response, "code"):  # std_srvs/Trigger has none
            response.code = code
        if response.success:  # rclpy permits only one severity per call site
            self.get_logger().info(f"{request}: {message}")
        else:
            self.get_logger().warning(f"{request}: {message}")
        return response

    def inactive(self) -> str:
        """Return a sentence on how to activate the node."""
        if self._finalized:
            return "The node was shut down and stays so: start its process again."
        steps = "activate" if self._connected else "configure and activate"
        return f"The node is {self._stage()}: {steps} it (ros2 lifecycle set {self.get_fully_qualified_name()} ...)."

    def inactive_health(self) -> Health:
        """Return the diagnostics of a node that is not active."""
        return Health(Level.OK, self.inactive(), {"lifecycle": self._stage()})

    def _stage(self) -> str:
        return "finalized" if self._finalized else "inactive" if self._connected else "unconfigured"

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe."""
        self.connect()
        self._connected = True
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take messages and requests."""
        self.active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End what is under way, or stay active if it does not end."""
        if not self.rest():
            return TransitionCallbackReturn.FAILURE
        self.active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End all subscriptions."""
        self._end()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End what is under way, and all subscriptions."""
        self.rest()
        self._end()
        self._finalized = True
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End what is under way, and begin anew: unconfigured."""
        self.rest()
        self._end()
        super().on_error(state)
        return TransitionCallbackReturn.SUCCESS

    def _end(self) -> None:
        self.active = False
        if self._connected:
            self.disconnect()
        self._connected = False
