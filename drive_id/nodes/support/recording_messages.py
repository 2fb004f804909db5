"""Messages on what a recorder does, and on what it has recorded."""

from __future__ import annotations

from drive_id_msgs.msg import RecorderState, RecordingInfo

from drive_id.live.recording.recording_report import RecordingReport
from drive_id.live.recording.recordings import FoundRecording
from drive_id.nodes.support.signal_messages import headed, time_of
from drive_id.types import NANOSECONDS


def recorder_state_message(state: str, report: RecordingReport | None, now: int) -> RecorderState:
    """Return the message of a state; the report is that of the recording under way, or of the last one."""
    message = RecorderState(state=state)
    if report is not None:
        message.uri, message.bytes, message.duration = str(report.path), report.size, report.duration
        message.samples, message.dropped = report.samples, report.dropped
        message.restarts, message.free_space = len(report.changes), report.free or 0
        message.error = report.error
    return headed(message, now, "")


def recording_info(found: FoundRecording) -> RecordingInfo:
    """Return the message of a recording in a list."""
    return RecordingInfo(
        name=found.path.name, uri=str(found.path), begin=time_of(found.begin), duration=found.duration / NANOSECONDS,
        bytes=found.size, messages=found.messages, error=found.error,
    )  # fmt: skip
