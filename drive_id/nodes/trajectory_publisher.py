"""The node ``trajectory_publisher``: publishes current references ahead of time and ends at zero current."""

from __future__ import annotations

import array
import time
from collections.abc import Iterable

import numpy as np
from drive_id_msgs.msg import CurrentReference, PhaseCurrents, Resolver
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time
from std_srvs.srv import Trigger

from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.state_machine import ReferenceBlock
from drive_id.core.experiment.supervision import SupervisedExperiment
from drive_id.nodes.diagnostics import Diagnostics
from drive_id.nodes.parameters import declare_settings, on_change
from drive_id.nodes.qos import STREAM, STREAM_BEST_EFFORT
from drive_id.nodes.runtime import run

_DELIVERY = Duration(seconds=2)
"""Time for the last blocks to be acknowledged at the end of the process."""


class TrajectoryPublisher(Node):
    """Publishes current references on request, supervises the drive, and always ends at zero current."""

    def __init__(self) -> None:
        super().__init__("trajectory_publisher")
        settings = declare_settings(self, ExperimentSettings, read_only=["publish_rate", "frame_id"])
        watched = (self.resolve_topic_name(name) for name in ("phase_currents", "resolver"))
        self._experiment = SupervisedExperiment(settings, *watched)
        self._frame_id = settings.frame_id
        self._logged = ""
        self._publisher = self.create_publisher(CurrentReference, "current_reference", STREAM)
        self._subscriptions_kept = [  # best effort receives from any publisher; a lost block does no harm here
            self.create_subscription(PhaseCurrents, "phase_currents", self._on_currents, STREAM_BEST_EFFORT),
            self.create_subscription(Resolver, "resolver", self._on_resolver, STREAM_BEST_EFFORT),
        ]
        self._services_kept = [
            self.create_service(Trigger, "~/start", self._on_start),
            self.create_service(Trigger, "~/stop", self._on_stop),
        ]
        on_change(self, ExperimentSettings, lambda _: None, self._on_settings)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(1.0 / settings.publish_rate, self._on_timer, clock=steady)
        self._diagnostics = Diagnostics(self, lambda: self._experiment.health(self._now(), time.monotonic()))
        self.get_logger().info(f"Ready: {self._experiment.plan()}")

    def close(self) -> None:
        """Bring the current to zero before the process ends."""
        blocks = self._experiment.finish(self._now())
        if blocks:
            self._publish(blocks)
            self._publisher.wait_for_all_acked(_DELIVERY)
            self.get_logger().info("Stopped to zero current.")

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_timer(self) -> None:
        self._publish(self._experiment.advance(self._now(), time.monotonic()))
        reason = self._experiment.trip_reason
        if reason and reason != self._logged:
            self.get_logger().error(f"Tripped: {reason}")
        self._logged = reason

    def _on_currents(self, message: PhaseCurrents) -> None:
        i_abc = _arrays(message.a, message.b, message.c)
        if self._experiment.currents(self._now(), time.monotonic(), message.first_sample, i_abc):
            self._on_timer()

    def _on_resolver(self, message: Resolver) -> None:
        signals = _arrays(message.angle, message.speed)
        if self._experiment.resolver(self._now(), time.monotonic(), message.first_sample, signals):
            self._on_timer()

    def _on_settings(self, settings: ExperimentSettings) -> None:
        self._experiment.change(self._now(), settings)
        self._on_timer()

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        publishers = self.count_publishers("current_reference")
        response.success, response.message = self._experiment.start(self._now(), time.monotonic(), publishers)
        return self._answer("start", response)

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._experiment.stop(self._now())
        return self._answer("stop", response)

    def _answer(self, request: str, response: Trigger.Response) -> Trigger.Response:
        self._on_timer()
        self.get_logger().info(f"{request}: {response.message}")
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
