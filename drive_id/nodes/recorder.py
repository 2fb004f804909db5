"""The node ``recorder``: records the topics of a drive, unchanged, in a bag."""

from __future__ import annotations

import os
import time
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from drive_id_msgs.msg import CurrentReference, PhaseCurrents, PhaseVoltages, Resolver, ScalarSamples
from drive_id_msgs.srv import StartRecording, StopRecording
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import Trigger

from drive_id.errors import DriveIdError
from drive_id.files.messages.messages import type_hash
from drive_id.health import Health, Level
from drive_id.live.data_directory import new_recording
from drive_id.live.recording.clock_watch import ClockWatch
from drive_id.live.recording.recorder_health import TopicState, recorder_health
from drive_id.live.recording.recording_session import RecordedTopic, RecordingSession
from drive_id.live.recording.recording_settings import RecordingSettings
from drive_id.nodes.support.diagnostics import Diagnostics
from drive_id.nodes.support.extra_topics import ExtraTopics
from drive_id.nodes.support.matched_subscription import MatchedSubscription
from drive_id.nodes.support.parameters import declare_settings, on_change
from drive_id.nodes.support.runtime import run
from drive_id.types import SCALARS

TOPICS = {
    "phase_currents": PhaseCurrents,
    "phase_voltages": PhaseVoltages,
    "resolver": Resolver,
    "current_reference": CurrentReference,
} | dict.fromkeys(SCALARS, ScalarSamples)
_MATCH_PERIOD = 0.25  # s between checks of who publishes
_PATIENCE = 3.0  # s that ~/stop waits for a slow disk
_LAST_PATIENCE = 30.0  # s, at the end of the process


class Recorder(Node):
    """Subscribes at its start; a recording holds exactly what arrives between ~/start and ~/stop."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self._settings = declare_settings(self, RecordingSettings, read_only=("queue_depth",))
        self._session: RecordingSession | None = None
        self._stopping = False
        self._told_error = False
        self._last: dict[str, float] = {}
        self._clock_watch = ClockWatch()
        self._topics = [
            MatchedSubscription(
                self, kind, name, partial(self._on_message, self.resolve_topic_name(name)),
                depth=self._settings.queue_depth, raw=True,
            )
            for name, kind in TOPICS.items()
        ]  # fmt: skip
        self._extra = ExtraTopics(
            self, [topic.topic for topic in self._topics], self._on_message, self._settings.queue_depth
        )
        self._extra.want(self._settings.extra_topics)
        on_change(self, RecordingSettings, self._check_settings, self._on_settings)
        self._optional = {self.resolve_topic_name(name) for name in SCALARS}
        self._services_kept = [
            self.create_service(StartRecording, "~/start", self._on_start),
            self.create_service(StopRecording, "~/stop", self._on_stop),
            self.create_service(Trigger, "~/pause", self._on_pause),  # as rosbag2 names them
            self.create_service(Trigger, "~/resume", self._on_resume),
            self.create_service(Trigger, "~/split_bagfile", self._on_split),
        ]
        self._timer = self.create_timer(
            _MATCH_PERIOD, self._check_topics, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        for topic in self._topics:
            type_hash(topic.type_name)  # kept for ~/start; the first one loads a parser
        self._diagnostics = Diagnostics(self, self._health)
        self.get_logger().info(f"Ready: recordings go to {self._settings.data_directory}.")

    def close(self) -> None:
        """Complete the bag of a running recording."""
        if self._session is not None:
            self._drain()
            self._session.remark = self._clock_watch.remark()
            ended = self._session.stop(_LAST_PATIENCE)
            outcome = self._session.report().outcome()
            self.get_logger().info(outcome if ended else f"{outcome} The disk does not answer: the bag breaks off.")

    def _check_settings(self, settings: RecordingSettings) -> None:
        self._extra.resolved(settings.extra_topics)

    def _on_settings(self, settings: RecordingSettings) -> None:
        self._settings = settings  # for the next recording
        self._extra.want(settings.extra_topics)

    def _on_message(self, topic: str, data: bytes) -> None:
        self._last[topic] = time.monotonic()
        if self._session is not None:
            self._session.receive(topic, data, self._now())

    def _drain(self) -> None:
        """Take all messages that have arrived before now."""
        for topic in self._topics:
            topic.drain()
        self._extra.drain()

    def _now(self) -> int:
        clock = self.get_clock()
        return int(clock.now().nanoseconds) if clock.ros_time_is_active else time.time_ns()

    def _check_topics(self) -> None:
        self._clock_watch.look(self._now(), time.monotonic())
        for topic in self._topics:
            topic.match()
        for found in self._extra.match():
            if self._session is not None:
                self._session.add_topic(found)
        if self._session is not None and self._session.error and not self._told_error:
            self._told_error = True
            self.get_logger().error(self._session.error)

    def _health(self) -> Health:
        now = time.monotonic()
        states = []
        for topic in self._topics:
            last = self._last.get(topic.topic)
            silent_for = None if last is None else now - last
            optional = topic.topic in self._optional
            states.append(TopicState(topic.topic, topic.type_name, topic.publishers, silent_for, optional))
        report = None if self._session is None else self._session.report()
        further = [] if report is None else self._clock_watch.findings()
        further += self._extra.findings()
        if self._session is not None and self._session.paused:
            further.append((Level.OK, "Paused: call ~/resume to go on."))
        return recorder_health(report, states, self._settings.silence, self._settings.queue_size, further)

    def _on_start(self, request: Any, response: Any) -> Any:
        before = ""
        if self._now() <= 0:
            return self._refused(
                response,
                "The time is 0: use_sim_time is set, but nobody publishes /clock. Start whatever publishes it, or set "
                "use_sim_time to false.",
            )
        if self._session is not None and self._session.error:
            before = f" The recording before it was cut short: {self._session.error}"
        elif self._session is not None:
            verb = "is being completed" if self._stopping else "is being recorded"
            return self._refused(response, f"{self._session.path} {verb}: stop it first.")
        try:
            path = new_recording(Path(self._settings.data_directory), request.name, datetime.now().astimezone())
            for topic in self._topics:
                topic.match()
            self._drain()
            recorded = [
                RecordedTopic(topic.topic, topic.type_name, topic.offered(), topic.topic in self._optional)
                for topic in self._topics
            ]
            distro = os.environ.get("ROS_DISTRO", "jazzy")
            self._extra.match()
            self._session = RecordingSession(
                path, [*recorded, *self._extra.recorded()], self._settings, ros_distro=distro
            )
            for name, data in self._extra.latched():
                self._session.receive(name, data, self._now())
        except DriveIdError as error:
            return self._refused(response, str(error))
        self._told_error = self._stopping = False
        self._last.clear()
        self._clock_watch.begin(time.monotonic())
        response.success, response.uri, response.message = True, str(path), f"Recording {path}.{before}"
        self.get_logger().info(response.message)
        return response

    def _refused(self, response: Any, message: str) -> Any:
        """Refuse a start, and log why: a calling script may ignore the response."""
        response.message = message
        self.get_logger().warning(f"start: {message}")
        return response

    def _on_pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        session = self._running(response)
        if session is not None:
            self._drain()
            session.pause()
            response.success, response.message = True, "Paused: what comes until ~/resume is not recorded."
        return response

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        session = self._running(response)
        if session is not None:
            self._drain()
            session.resume()
            response.success, response.message = True, f"Recording {session.path}."
        return response

    def _on_split(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        session = self._running(response)
        if session is not None:
            self._drain()
            session.split()
            response.success, response.message = True, f"{session.path} goes on in a new file."
        return response

    def _running(self, response: Trigger.Response) -> RecordingSession | None:
        """Return the recording under way; if there is none, say so in the response."""
        if self._session is None or self._session.error or self._stopping:
            response.message = "Nothing is being recorded: start a recording first."
            return None
        return self._session

    def _on_stop(self, _request: Any, response: Any) -> Any:
        if self._session is None:
            response.message = "Nothing is being recorded: start a recording first."
            return response
        if not self._stopping:
            self._drain()
            self._clock_watch.look(self._now(), time.monotonic())
            self._session.remark = self._clock_watch.remark()
        self._stopping = True
        if not self._session.stop(_PATIENCE):
            response.uri = str(self._session.path)
            response.message = f"The disk is slow, {response.uri} is still being completed: call stop again."
            return response
        report = self._session.report()
        self._session, self._stopping = None, False
        response.success, response.message, response.uri = not report.error, report.outcome(), str(report.path)
        response.samples, response.dropped, response.duration = report.samples, report.dropped, report.duration
        self.get_logger().info(response.message)
        return response


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    run(Recorder)


if __name__ == "__main__":
    main()
