"""The node ``trajectory_publisher``: publishes current references ahead of time and ends at zero current."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any

from drive_id_msgs.msg import CurrentReference, DriveStatus, PhaseCurrents, PublisherState, Resolver
from drive_id_msgs.srv import Command, StartExperiment
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool, Empty
from std_srvs.srv import Trigger

from drive_id.common.health import Health, Level
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.state_machine import ExperimentState, ReferenceBlock
from drive_id.core.experiment.supervision import Answer, SupervisedExperiment
from drive_id.core.experiment.watchdog import CURRENTS, SIGNALS
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.diagnostics import publish_health
from drive_id.nodes.support.experiment_messages import (
    drive_status,
    reference_message,
    run_of,
    sample_block,
    state_message,
)
from drive_id.nodes.support.managed import ManagedNode
from drive_id.nodes.support.parameters import declare_settings, on_change, read_settings
from drive_id.nodes.support.qos import LATCHED, STREAM, STREAM_BEST_EFFORT, incompatible_subscriptions, known_nodes
from drive_id.nodes.support.runtime import run

_DELIVERY = Duration(seconds=2)
"""Time for the last blocks to be acknowledged before the publisher is gone."""
_REFERENCES = "current_reference"
_FIGURE = re.compile(r"[-+.\de]*\d")  # that grows while the reason stays the same
_STATE_PERIOD = 0.1
"""Time between messages of the state of a running experiment, s."""
_READ_ONLY = ("publish_rate", "frame_id", "watch", "require_status", "current_ceiling", "emergency_stops")
"""Parameters that are fixed at the start of the process: nobody loosens them while current flows."""
_NO_EVENTS = {"use_default_callbacks": False}
"""An event of a destroyed publisher or subscription kills the events executor of rclpy up to 9.1."""


class TrajectoryPublisher(ManagedNode):
    """Publishes current references on request, supervises the drive, and always ends at zero current.

    It publishes only while it is active.
    """

    def __init__(self) -> None:
        super().__init__("trajectory_publisher")
        settings = declare_settings(self, ExperimentSettings, read_only=_READ_ONLY)
        self._buttons = settings.emergency_stops
        self._experiment = self._new_experiment(settings)
        self._frame_id = settings.frame_id
        self._logged = ""
        self._incompatible: list[str] = []
        self._published_state: tuple[Any, ...] = ()
        self._state_due = 0.0
        self._drives: list[str] = []
        self._button_counts: dict[str, int] = {}
        self._heard_buttons: dict[str, list[QoSProfile]] = {}
        self._publisher: Any = None
        self._subscriptions_kept: list[Any] = []
        for kind, name, handle in (
            (Trigger, "~/start", self._on_start),  # the plain door, for whatever knows only std_srvs
            (Trigger, "~/stop", self._on_stop),
            (StartExperiment, "~/start_experiment", self._on_start_experiment),
            (Command, "~/stop_experiment", self._on_stop),
            (Command, "~/clear_fault", self._on_clear_fault),
        ):
            self.paced.create(kind, name, handle)
        self._state_publisher = self.create_publisher(PublisherState, "~/state", LATCHED)
        self._heartbeats = self.create_subscription(Empty, "~/heartbeat", self._on_heartbeat, STREAM_BEST_EFFORT)
        on_change(self, ExperimentSettings, lambda _: None, self._on_settings)
        self.create_timer(1.0 / settings.publish_rate, self._on_timer, clock=STEADY)
        publish_health(self, self._health)
        self.bring_up(f"Ready: {self._experiment.plan()}")
        if not settings.watch:
            self.get_logger().warning("watch is false: current will flow whatever the drive does.")

    def _new_experiment(self, settings: ExperimentSettings) -> SupervisedExperiment:
        names = {name: self.resolve_topic_name(name) for name in (*SIGNALS, *self._buttons)}
        return SupervisedExperiment(settings, names)

    def connect(self) -> None:
        """Connect to the drive, without energising it."""
        self._publisher = self.create_lifecycle_publisher(
            CurrentReference, _REFERENCES, STREAM, event_callbacks=PublisherEventCallbacks(**_NO_EVENTS)
        )
        currents, resolver, status = SIGNALS
        self._subscriptions_kept = [  # best effort receives from any publisher; a lost block does no harm here
            self.create_subscription(
                kind, name, handle, profile, event_callbacks=SubscriptionEventCallbacks(**_NO_EVENTS)
            )
            for kind, name, handle, profile in (
                (PhaseCurrents, currents, self._on_currents, STREAM_BEST_EFFORT),
                (Resolver, resolver, self._on_resolver, STREAM_BEST_EFFORT),
                (DriveStatus, status, self._on_status, STREAM_BEST_EFFORT),
            )
        ]
        self._heard_buttons, self._button_counts = {}, {}
        for button in self._buttons:
            self._hear_button(button, STREAM_BEST_EFFORT)

    def _hear_button(self, button: str, profile: QoSProfile) -> None:
        """Subscribe to an emergency stop by a quality of service, unless that is done already."""
        heard = self._heard_buttons.setdefault(button, [])
        if profile in heard:
            return
        heard.append(profile)
        handle = partial(self._on_emergency_stop, button)
        events = SubscriptionEventCallbacks(**_NO_EVENTS)
        self._subscriptions_kept.append(self.create_subscription(Bool, button, handle, profile, event_callbacks=events))

    def _match_buttons(self) -> None:
        """Hear emergency stops reliably, and those pressed before, where a publisher offers it: others would warn."""
        counts = {button: self.count_publishers(button) for button in self._buttons}
        for button, count in counts.items():
            if count == self._button_counts.get(button, 0):
                continue
            for info in self.get_publishers_info_by_topic(self.resolve_topic_name(button)):
                offered = info.qos_profile
                if offered.reliability != ReliabilityPolicy.BEST_EFFORT:
                    self._hear_button(button, STREAM)
                    if offered.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                        self._hear_button(button, LATCHED)
        self._button_counts = counts
        self._experiment.count_buttons(counts)

    def disconnect(self) -> None:
        """Disconnect from the drive, once it has acknowledged the last references; this forgets a trip as well."""
        self._publisher.wait_for_all_acked(_DELIVERY)
        self.destroy_lifecycle_publisher(self._publisher)
        self._publisher = None
        for subscription in self._subscriptions_kept:
            self.destroy_subscription(subscription)
        self._subscriptions_kept = []
        self._experiment = self._new_experiment(read_settings(self, ExperimentSettings))

    def rest(self) -> bool:
        """Publish the references down to zero."""
        blocks = self._experiment.finish(self._now(), "Stopped, because the node was deactivated.")
        if self.active and blocks:
            self._publish(blocks)
            self.get_logger().info("Stopped to zero current.")
        return True

    def close(self) -> None:
        """Bring the current to zero before the process ends."""
        self.rest()
        if self._publisher is not None:
            self._publisher.wait_for_all_acked(_DELIVERY)

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _health(self) -> Health:
        health = self._experiment.health(self._now(), time.monotonic())
        if len(self._drives) > 1:
            topic = self.resolve_topic_name(CURRENTS)
            health = health.with_warning(f"{' and '.join(self._drives)} both publish {topic}: stop one.")
        if self.active:
            waits = health.level is Level.OK and health.values["state"] == ExperimentState.IDLE.value
            return self._with_subscriptions(health) if waits else health  # no graph queries while current flows
        inactive = self.inactive_health()
        return replace(inactive, values={**health.values, **inactive.values})

    def _with_subscriptions(self, health: Health) -> Health:
        """Add the subscriptions that cannot receive the references; a start is not refused: one may be a display."""
        found = incompatible_subscriptions(self, _REFERENCES)
        for sentence in found:
            if sentence not in self._incompatible:
                self.get_logger().warning(sentence)
        self._incompatible = found
        return Health.of(health.message, [(Level.OK, sentence) for sentence in found], health.values)

    def _on_timer(self) -> None:
        if self._publisher is not None:
            self._match_buttons()
        if self.active:
            now, steady = self._now(), time.monotonic()
            self._count_drives()
            self._publish(self._experiment.advance(now, steady, self.count_publishers(_REFERENCES)))
            reason = self._experiment.trip_reason
            if reason and reason != self._logged:
                self.get_logger().error(f"Tripped: {reason}")
            self._logged = reason
        self._publish_state()

    def _count_drives(self) -> None:
        """Note who publishes the phase currents, if that has changed, or not all their names are known."""
        if self.count_publishers(CURRENTS) != len(self._drives):
            self._drives = known_nodes(self.get_publishers_info_by_topic(self.resolve_topic_name(CURRENTS)))
            self._experiment.count_drives(self._drives)

    def _publish_state(self) -> None:
        now, steady = self._now(), time.monotonic()
        report = self._experiment.report(now, steady)
        reason = report.reason if self.active else self.inactive()
        shown = (report.state, _FIGURE.sub("", reason), report.dry_run, report.session, report.completed, self.active)
        runs = report.state not in {ExperimentState.IDLE, ExperimentState.TRIPPED}
        if shown == self._published_state and not (runs and steady >= self._state_due):
            return
        self._published_state, self._state_due = shown, steady + _STATE_PERIOD
        self._state_publisher.publish(state_message(report, reason, now, self._frame_id))

    def _on_currents(self, message: PhaseCurrents) -> None:
        self._judge(self._experiment.currents, sample_block(message, "a", "b", "c"))

    def _on_resolver(self, message: Resolver) -> None:
        self._judge(self._experiment.resolver, sample_block(message, "angle", "speed"))

    def _on_status(self, message: DriveStatus) -> None:
        self._judge(self._experiment.status, drive_status(message))

    def _on_emergency_stop(self, button: str, message: Bool) -> None:
        self._experiment.count_buttons({button: self.count_publishers(button)})
        self._judge(partial(self._experiment.emergency_stop, button=button), message.data)

    def _judge(self, check: Callable[[int, float, Any], bool], heard: Any) -> None:
        """Have a message checked; what trips the experiment is answered at once, not at the next tick."""
        if self._publisher is not None and check(self._now(), time.monotonic(), heard):
            self._on_timer()

    def _on_heartbeat(self, _: Empty) -> None:
        self._experiment.heartbeat(time.monotonic())

    def _on_settings(self, settings: ExperimentSettings) -> None:
        self._experiment.change(self._now(), settings)
        self._on_timer()

    # Requests

    def _on_start(self, _: Any, response: Any) -> Any:
        return self._replied("start", response, self._start())

    def _on_start_experiment(self, request: Any, response: Any) -> Any:
        answer = self._start(dry_run=request.dry_run, require_lease=request.require_lease, run=run_of(request))
        response.session = self._experiment.session if answer.success else 0
        return self._replied("start", response, answer)

    def _start(self, **options: Any) -> Answer:
        if not self.active:
            return Answer("inactive", f"Not started. {self.inactive()}")
        publishers = self.count_publishers(_REFERENCES)
        return self._experiment.start(self._now(), time.monotonic(), publishers, **options)

    def _on_stop(self, _: Any, response: Any) -> Any:
        return self._replied("stop", response, self._experiment.stop(self._now()))  # inactive: nothing is running

    def _on_clear_fault(self, _: Any, response: Any) -> Any:
        answer = Answer("inactive", f"Not cleared. {self.inactive()}")
        if self.active:
            answer = self._experiment.clear_fault(self._now(), time.monotonic())
        return self._replied("clear_fault", response, answer)

    def _replied(self, request: str, response: Any, answer: Answer) -> Any:
        """Act on a request at once, and answer it."""
        self._on_timer()
        return self.answer(request, response, answer.code, answer.message)

    def _publish(self, blocks: Iterable[ReferenceBlock]) -> None:
        for block in blocks:
            message = reference_message(block, self._frame_id)
            now = self._now()
            if self._experiment.withhold(now, block):  # and all that follow, but for the way to zero
                self._publish(self._experiment.advance(now, time.monotonic(), self.count_publishers(_REFERENCES)))
                return
            self._publisher.publish(message)


def main() -> None:
    """Run the node ``trajectory_publisher``."""
    run(TrajectoryPublisher, shared_memory=False)


if __name__ == "__main__":
    main()
