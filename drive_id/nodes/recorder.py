"""The node ``recorder``: records the topics of a drive, unchanged, in a bag."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from drive_id_msgs.msg import RecorderState
from drive_id_msgs.srv import Command, ListRecordings, StartRecording, StopRecording
from std_msgs.msg import Empty

from drive_id.common.health import Health, Level
from drive_id.common.quantity import counted
from drive_id.errors import DriveIdError
from drive_id.live.data_directory import new_recording
from drive_id.live.recording.clock_watch import ClockWatch
from drive_id.live.recording.recorder_health import recorder_health
from drive_id.live.recording.recording_note import RecordingNote
from drive_id.live.recording.recording_report import RecordingReport
from drive_id.live.recording.recording_session import RecordingSession, free_space, shortage
from drive_id.live.recording.recording_settings import RecordingSettings
from drive_id.live.recording.recordings import find_recordings
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.deferred_service import MOST_LISTED, Lookups
from drive_id.nodes.support.diagnostics import publish_health
from drive_id.nodes.support.managed import ManagedNode
from drive_id.nodes.support.parameters import declare_settings, on_change
from drive_id.nodes.support.qos import LATCHED, STREAM_BEST_EFFORT, overridable
from drive_id.nodes.support.recording_messages import recorder_state_message, recording_info
from drive_id.nodes.support.runtime import run
from drive_id.nodes.support.topics.recorded import RecordedTopics

_STATE_PERIOD = 1.0  # s between messages of the state of a recording
_MATCH_PERIOD = 0.25  # s between checks of who publishes
_PATIENCE = 3.0  # s that ~/stop waits for a slow disk
_LAST_PATIENCE = 30.0  # s, at the end of the process
_NOTHING = "Nothing is being recorded: start a recording first."
_NO_CLOCK = (
    "The time is 0: use_sim_time is set, but nobody publishes /clock. Start whatever publishes it, or set use_sim_time "
    "to false."
)
_COMMANDS = {  # as rosbag2 names them: what is done, and what is replied
    "pause": (RecordingSession.pause, "Paused: what comes until ~/resume is not recorded."),
    "resume": (RecordingSession.resume, "Recording {path}."),
    "split_bagfile": (RecordingSession.split, "{path} goes on in a new file."),
}


class Recorder(ManagedNode):
    """Subscribes when it is configured; a recording holds exactly what arrives between ~/start and ~/stop."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self._settings = declare_settings(self, RecordingSettings, read_only=("queue_depth",))
        self._session: RecordingSession | None = None
        self._stopping = False
        self._told_error = False
        self._clock_watch = ClockWatch()
        self._note = RecordingNote(self._settings.data_directory, self.get_fully_qualified_name())
        self._topics = RecordedTopics(self, self._on_message, self._settings.queue_depth)
        extra = self._topics.extra
        extra.want(self._settings.extra_topics, self._settings.state_topics)
        on_change(
            self, RecordingSettings, lambda new: extra.resolved([*new.extra_topics, *new.state_topics]),
            self._on_settings,
        )  # fmt: skip
        self.paced.create(StartRecording, "~/start", self._on_start)
        self.paced.create(StopRecording, "~/stop", self._on_stop)
        for name, (command, said) in _COMMANDS.items():
            self.paced.create(Command, f"~/{name}", partial(self._on_command, command, said))
        self.create_subscription(Empty, "~/heartbeat", self._on_heartbeat, STREAM_BEST_EFFORT)
        Lookups(self, self.paced).serve(ListRecordings, "~/list_recordings", self._list_recordings)
        self._last: RecordingReport | None = None
        self._told_state: tuple[object, ...] = ()
        self._state_due = 0.0
        self._state_publisher = self.create_publisher(RecorderState, "~/state", **overridable(LATCHED))
        self.create_timer(_MATCH_PERIOD, self._check_topics, clock=STEADY)
        if self._note.left:
            self.get_logger().error(self._note.left)
        publish_health(self, self._health)
        self.bring_up(f"Ready: recordings go to {self._settings.data_directory}.")

    def connect(self) -> None:
        """Subscribe to the topics of the drive."""
        self._topics.open()

    def disconnect(self) -> None:
        """End the subscriptions."""
        self._topics.close()

    def rest(self) -> bool:
        """Complete the bag of a running recording, and tell whether it is complete."""
        return self._end_recording(_PATIENCE)

    def close(self) -> None:
        """Complete the bag of a running recording."""
        self._end_recording(_LAST_PATIENCE)

    def _end_recording(self, patience: float) -> bool:
        session = self._session
        if session is None:
            return True
        ended = self._complete(session, patience)
        outcome = session.report().outcome()
        self.get_logger().info(outcome if ended else f"{outcome} The disk does not answer: the bag breaks off.")
        return ended

    def _complete(self, session: RecordingSession, patience: float) -> bool:
        """Take what has arrived, and complete the bag; return whether the disk was fast enough."""
        if not self._stopping:
            self._topics.drain()
            self._clock_watch.look(self._now(), time.monotonic())
            session.remark = self._clock_watch.remark()
        self._stopping = True
        if not session.stop(patience):
            return False
        self._session, self._stopping, self._last = None, False, session.report()
        self._note.end()
        return True

    def _on_settings(self, settings: RecordingSettings) -> None:
        self._settings = settings  # for the next recording
        self._topics.extra.want(settings.extra_topics, settings.state_topics)

    def _on_message(self, topic: str, data: bytes) -> None:
        if self._session is not None:
            self._session.receive(topic, data, self._now())

    def _on_heartbeat(self, _: Empty) -> None:
        if self._session is not None:
            self._session.heartbeat()

    def _now(self) -> int:
        clock = self.get_clock()
        return int(clock.now().nanoseconds) if clock.ros_time_is_active else time.time_ns()

    def _check_topics(self) -> None:
        self._clock_watch.look(self._now(), time.monotonic())
        for found in self._topics.match():
            if self._session is not None:
                self._session.add_topic(found)
        for topic, publishers in self._topics.publishers().items():
            if self._session is not None:
                self._session.publishers(topic, publishers, self._now())
        if self._session is not None and self._session.error and not self._told_error:
            self._told_error = True
            self._note.end()
            self.get_logger().error(self._session.error)
        self._publish_state()

    def _publish_state(self) -> None:
        """Tell the state where it has changed, and once a second while something is recorded."""
        session, now = self._session, time.monotonic()
        report = self._last if session is None else session.report()
        state = RecorderState.IDLE
        if session is not None:
            ends = RecorderState.FAILED if session.error else RecorderState.COMPLETING if self._stopping else ""
            state = ends or (RecorderState.PAUSED if session.paused else RecorderState.RECORDING)
        told = (state, *(() if report is None else (report.path, report.changes, report.error)))
        if told == self._told_state and (session is None or now < self._state_due):
            return
        self._told_state, self._state_due = told, now + _STATE_PERIOD
        self._state_publisher.publish(recorder_state_message(state, report, max(self._now(), 0)))

    def _list_recordings(self, request: Any, response: Any) -> Any:
        directory = Path(self._settings.data_directory)
        found, response.total = find_recordings(directory, request.name, request.most or MOST_LISTED)
        response.recordings = [recording_info(each) for each in found]
        response.message = f"{len(found)} of {counted(response.total, 'recording')}."
        return response

    def _health(self) -> Health:
        if not self.active:
            return self.inactive_health()
        report = None if self._session is None else self._session.report()
        further = [] if report is None else self._clock_watch.findings()
        further += self._topics.extra.findings()
        if self._session is not None and self._session.paused:
            further.append((Level.OK, "Paused: call ~/resume to go on."))
        if self._note.left:
            further.append((Level.ERROR, self._note.left))
        return recorder_health(report, self._topics.states(), self._settings, further)

    def _on_start(self, request: Any, response: Any) -> Any:
        code, message = self._start(request.name)
        if code == response.CODE_OK and self._session is not None:
            response.uri = str(self._session.path)
        return self.answer("start", response, code, message)

    def _start(self, name: str) -> tuple[str, str]:
        """Begin a recording; return code and sentence of the reply."""
        codes, before = StartRecording.Response, ""
        if not self.active:
            return codes.CODE_INACTIVE, self.inactive()
        if self._now() <= 0:
            return codes.CODE_NO_CLOCK, _NO_CLOCK
        if self._session is not None and self._session.error:
            before = f" The recording before it was cut short: {self._session.error}"
        elif self._session is not None:
            verb = "is being completed" if self._stopping else "is being recorded"
            return codes.CODE_BUSY, f"{self._session.path} {verb}: stop it first."
        try:
            path = new_recording(Path(self._settings.data_directory), name, datetime.now().astimezone())
            if short := shortage(free_space(path), self._settings, path):
                return codes.CODE_OUTPUT, short
            distro = os.environ.get("ROS_DISTRO", "jazzy")
            self._session = RecordingSession(path, self._topics.begin(), self._settings, ros_distro=distro)
            for topic_name, data in self._topics.extra.latched():
                self._session.receive(topic_name, data, self._now())
        except DriveIdError as error:
            return error.code, str(error)
        self._note = RecordingNote(self._settings.data_directory, self.get_fully_qualified_name())
        self._note.begin(path)
        self._told_error = self._stopping = False
        self._publish_state()
        self._clock_watch.begin(time.monotonic())
        return codes.CODE_OK, f"Recording {path}.{before}"

    def _on_command(self, command: Callable[[RecordingSession], None], message: str, _: Any, response: Any) -> Any:
        """Give the recording under way a command at this place among its messages, or say that there is none."""
        session = self._session
        if not self.active:
            return self.answer(command.__name__, response, response.CODE_INACTIVE, self.inactive())
        if session is None or session.error or self._stopping:
            return self.answer(command.__name__, response, response.CODE_NOT_RECORDING, _NOTHING)
        self._topics.drain()
        command(session)
        self._publish_state()
        return self.answer(command.__name__, response, response.CODE_OK, message.format(path=session.path))

    def _on_stop(self, _request: Any, response: Any) -> Any:
        session = self._session
        if session is None:
            return self.answer("stop", response, response.CODE_NOT_RECORDING, self._note.left or _NOTHING)
        response.uri = str(session.path)
        if not self._complete(session, _PATIENCE):
            slow = f"The disk is slow, {response.uri} is still being completed: call stop again."
            return self.answer("stop", response, response.CODE_BUSY, slow)
        report = session.report()
        self._publish_state()
        response.samples, response.dropped, response.duration = report.samples, report.dropped, report.duration
        code, message = response.CODE_OK, report.outcome()
        if report.error:
            code = response.CODE_OUTPUT
        elif not report.messages:
            code = response.CODE_NO_MESSAGE
            message = f"Nothing was recorded: {message} Check the drive and the topics."
        return self.answer("stop", response, code, message)


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    run(Recorder)


if __name__ == "__main__":
    main()
