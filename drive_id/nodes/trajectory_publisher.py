"""The node ``trajectory_publisher``: publishes current references ahead of time and ends at zero current."""

from __future__ import annotations

import array
import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from drive_id_msgs.msg import CurrentReference, PhaseCurrents, Resolver
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.time import Time
from std_srvs.srv import Trigger

from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.state_machine import ExperimentState, ReferenceBlock
from drive_id.core.experiment.supervision import SupervisedExperiment
from drive_id.health import Health, Level
from drive_id.live.managed_settings import ManagedSettings
from drive_id.nodes.support.diagnostics import Diagnostics
from drive_id.nodes.support.managed import guard_transitions
from drive_id.nodes.support.parameters import declare_settings, on_change, read_settings
from drive_id.nodes.support.qos import STREAM, STREAM_BEST_EFFORT, incompatible_subscriptions
from drive_id.nodes.support.runtime import run

_DELIVERY = Duration(seconds=2)
"""Time for the last blocks to be acknowledged before the publisher is gone."""
_NO_EVENTS = {"use_default_callbacks": False}
"""An event of a destroyed publisher or subscription kills the events executor of rclpy up to 9.1."""


class TrajectoryPublisher(LifecycleNode):
    """Publishes current references on request, supervises the drive, and always ends at zero current.

    A managed node: it publishes only while it is active. With ``autostart`` it configures and activates itself.
    """

    def __init__(self) -> None:
        super().__init__("trajectory_publisher")
        guard_transitions(self)
        settings = declare_settings(self, ExperimentSettings, read_only=["publish_rate", "frame_id"])
        autostart = declare_settings(self, ManagedSettings, read_only=["autostart"]).autostart
        self._experiment = self._new_experiment(settings)
        self._frame_id = settings.frame_id
        self._logged = ""
        self._incompatible: list[str] = []
        self._active = False
        self._publisher: Any = None
        self._subscriptions_kept: list[Any] = []
        self._services_kept = [
            self.create_service(Trigger, "~/start", self._on_start),
            self.create_service(Trigger, "~/stop", self._on_stop),
        ]
        on_change(self, ExperimentSettings, lambda _: None, self._on_settings)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(1.0 / settings.publish_rate, self._on_timer, clock=steady)
        self._diagnostics = Diagnostics(self, self._health)
        if autostart:
            self.trigger_configure()
            self.trigger_activate()
            self.get_logger().info(f"Ready: {self._experiment.plan()}")
        else:
            self.get_logger().info(f"Waiting to be configured and activated: {self._experiment.plan()}")

    def _new_experiment(self, settings: ExperimentSettings) -> SupervisedExperiment:
        watched = (self.resolve_topic_name(name) for name in ("phase_currents", "resolver"))
        return SupervisedExperiment(settings, *watched)

    # Transitions

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Connect to the drive, without energising it."""
        self._publisher = self.create_lifecycle_publisher(
            CurrentReference, "current_reference", STREAM, event_callbacks=PublisherEventCallbacks(**_NO_EVENTS)
        )
        options: Any = {"event_callbacks": SubscriptionEventCallbacks(**_NO_EVENTS)}
        self._subscriptions_kept = [  # best effort receives from any publisher; a lost block does no harm here
            self.create_subscription(PhaseCurrents, "phase_currents", self._on_currents, STREAM_BEST_EFFORT, **options),
            self.create_subscription(Resolver, "resolver", self._on_resolver, STREAM_BEST_EFFORT, **options),
        ]
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Permit starts."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the current to zero."""
        self._end_at_zero("Stopped, because the node was deactivated.")
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Disconnect from the drive."""
        self._disconnect()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the current to zero and disconnect from the drive."""
        self._end_at_zero("Stopped, because the node was shut down.")
        self._disconnect()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the current to zero and begin anew: unconfigured."""
        self._end_at_zero("Stopped, because a transition failed.")
        self._disconnect()
        super().on_error(state)
        return TransitionCallbackReturn.SUCCESS

    def _end_at_zero(self, reason: str) -> None:
        """Publish the references down to zero, while they can be."""
        blocks = self._experiment.finish(self._now(), reason) if self._active else []
        if blocks:
            self._publish(blocks)
            self.get_logger().info("Stopped to zero current.")
        self._active = False

    def _disconnect(self) -> None:
        if self._publisher is not None:
            self._publisher.wait_for_all_acked(_DELIVERY)
            self.destroy_lifecycle_publisher(self._publisher)
            self._publisher = None
        for subscription in self._subscriptions_kept:
            self.destroy_subscription(subscription)
        self._subscriptions_kept = []
        self._experiment = self._new_experiment(read_settings(self, ExperimentSettings))

    def close(self) -> None:
        """Bring the current to zero before the process ends."""
        self._end_at_zero("Stopped, because the node ends.")
        if self._publisher is not None:
            self._publisher.wait_for_all_acked(_DELIVERY)

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _health(self) -> Health:
        health = self._experiment.health(self._now(), time.monotonic())
        if self._active:
            waits = health.level is Level.OK and health.values["state"] == ExperimentState.IDLE.value
            return self._with_subscriptions(health) if waits else health  # no graph queries while current flows
        return Health(Level.OK, self._inactive(), {**health.values, "lifecycle": self._stage()})

    def _with_subscriptions(self, health: Health) -> Health:
        """Add the subscriptions that cannot receive the references; a start is not refused: one may be a display."""
        found = incompatible_subscriptions(self, "current_reference")
        for sentence in found:
            if sentence not in self._incompatible:
                self.get_logger().warning(sentence)
        self._incompatible = found
        return Health.of(health.message, [(Level.OK, sentence) for sentence in found], health.values)

    def _stage(self) -> str:
        return "unconfigured" if self._publisher is None else "inactive"

    def _inactive(self) -> str:
        """Return a sentence on how to permit starts."""
        steps = "activate it" if self._publisher is not None else "configure and activate it"
        return f"The node is {self._stage()}: {steps} (ros2 lifecycle set {self.get_fully_qualified_name()} ...)."

    def _on_timer(self) -> None:
        if not self._active:
            return
        self._publish(self._experiment.advance(self._now(), time.monotonic()))
        reason = self._experiment.trip_reason
        if reason and reason != self._logged:
            self.get_logger().error(f"Tripped: {reason}")
        self._logged = reason

    def _on_currents(self, message: PhaseCurrents) -> None:
        if self._publisher is None:
            return  # a message that arrived before the cleanup
        i_abc = _arrays(message.a, message.b, message.c)
        if self._experiment.currents(self._now(), time.monotonic(), message.first_sample, i_abc):
            self._on_timer()

    def _on_resolver(self, message: Resolver) -> None:
        if self._publisher is None:
            return
        signals = _arrays(message.angle, message.speed)
        if self._experiment.resolver(self._now(), time.monotonic(), message.first_sample, signals):
            self._on_timer()

    def _on_settings(self, settings: ExperimentSettings) -> None:
        self._experiment.change(self._now(), settings)
        self._on_timer()

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._active:
            response.message = f"Not started. {self._inactive()}"
            return response
        publishers = self.count_publishers("current_reference")
        response.success, response.message = self._experiment.start(self._now(), time.monotonic(), publishers)
        return self._answer("start", response)

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._experiment.stop(self._now())  # inactive: nothing is running
        return self._answer("stop", response)

    def _answer(self, request: str, response: Trigger.Response) -> Trigger.Response:
        self._on_timer()
        if response.success:  # rclpy permits only one severity per call site
            self.get_logger().info(f"{request}: {response.message}")
        else:
            self.get_logger().warning(f"{request}: {response.message}")
        return response

    def _publish(self, blocks: Iterable[ReferenceBlock]) -> None:
        for block in blocks:
            message = CurrentReference(first_sample=block.first_sample, sample_period=block.sample_period)
            message.header.stamp = Time(nanoseconds=block.stamp).to_msg()
            message.header.frame_id = self._frame_id
            message.d, message.q = (array.array("f", column.tobytes()) for column in block.i_dq.T)
            self._publisher.publish(message)


def _arrays(*fields: array.array[float]) -> list[NDArray[np.float32]]:
    return [np.frombuffer(field, np.float32) for field in fields]


def main() -> None:
    """Run the node ``trajectory_publisher``."""
    run(TrajectoryPublisher)


if __name__ == "__main__":
    main()
