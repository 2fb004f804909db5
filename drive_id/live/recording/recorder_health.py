"""Diagnostics of the recorder and its topics: level, sentences and figures, without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drive_id.common.health import Health, Level, Observation
from drive_id.common.quantity import counted
from drive_id.live.publishers import Publisher, of_type, publisher_findings, uncounted
from drive_id.live.recording.recording_report import RecordingReport, TopicReport
from drive_id.live.recording.recording_settings import RecordingSettings

_SCARCE = 10.0
"""Multiple of least_free_space below which to warn of the disk."""


@dataclass(frozen=True)
class TopicState:
    """Publishers and activity of a topic."""

    topic: str
    type_name: str
    publishers: Sequence[Publisher]  # all of the topic, of any type
    silent_for: float | None  # time since the last message, s; None when there was none yet
    optional: bool = False  # it may be absent, slow or silent


def recorder_health(
    report: RecordingReport | None,
    topics: Sequence[TopicState],
    settings: RecordingSettings,
    further: Sequence[Observation] = (),
) -> Health:
    """Return the diagnostics of the recorder.

    Parameters
    ----------
    report : RecordingReport or None
        Of the current recording, which may have ended by an error; None when there is none.
    topics : sequence of TopicState
        Those of the report; optional ones may be missing there.
    further : sequence of Observation
        Of the node.
    """
    findings = [] if report is not None and report.error else list(further)
    values: dict[str, str] = {}
    if report is not None:
        findings += _recording_findings(report, settings.queue_size)
        values |= _recording_values(report)
        if report.free is not None and not report.error and report.free < _SCARCE * 1e6 * settings.least_free_space:
            findings.append((Level.WARN, f"The disk of {report.path} has only {report.free / 1e6:.0f} MB left."))
    reports = {} if report is None else {topic.topic: topic for topic in report.topics}
    for state in topics:
        if state.optional and not state.publishers and state.topic not in reports:
            continue
        found = publisher_findings(state.topic, state.type_name, state.publishers)
        findings += [(min(level, Level.WARN), said) for level, said in found] if state.optional else found
        if report is not None and not report.error and state.topic in reports:
            findings += _sample_findings(state, reports[state.topic], settings.silence)
        values |= _topic_values(state, reports.get(state.topic))
    doing = "Not recording." if report is None else f"Recording {report.path}."
    return Health.of("" if report is not None and report.error else doing, findings, values)


def _recording_findings(report: RecordingReport, queue_size: float) -> list[Observation]:
    if report.error:
        return [(Level.ERROR, report.error)]
    findings = [(Level.WARN, report.division())] if report.changes else []
    if report.waiting > 0.5e6 * queue_size:
        samples, megabytes = sum(topic.queued for topic in report.topics), report.waiting / 1e6
        findings.append(
            (Level.WARN, f"The disk is too slow: {counted(samples, 'sample')}, {megabytes:.1f} MB, wait for it.")
        )
    if report.overflowed:
        findings.append(
            (Level.ERROR, f"The disk is too slow: the queue had no room for {counted(report.overflowed, 'sample')}.")
        )
    return findings


def _sample_findings(state: TopicState, report: TopicReport, longest_silence: float) -> list[Observation]:
    said = []
    if report.lost:
        said.append(f"Lost {counted(report.lost, 'sample')} of {state.topic} in {counted(report.losses, 'place')}.")
    if report.uncounted:
        said.append(uncounted(state.topic))
    if report.unreadable:
        messages = counted(report.unreadable, "message")
        said.append(f"Received {messages} on {state.topic} without a block of samples.")
    if state.optional:
        pass  # it may be absent, slow or silent
    elif not of_type(state.publishers, state.type_name):
        said.append(f"Nobody publishes {state.topic}.")
    elif state.silent_for is None:
        said.append(f"No message has come on {state.topic} yet.")
    elif 0 < longest_silence < state.silent_for:
        said.append(f"No message has come on {state.topic} for {state.silent_for:.1f} s.")
    return [(Level.WARN, sentence) for sentence in said]


def _recording_values(report: RecordingReport) -> dict[str, str]:
    return {
        "bag": str(report.path),
        "files": str(report.files),
        "size [byte]": str(report.size),
        "queue [byte]": str(report.waiting),
        "samples": str(report.samples),
        "samples dropped": str(report.dropped),
        "duration [s]": f"{report.duration:.6f}",
        "free [byte]": "" if report.free is None else str(report.free),
    }


def _topic_values(state: TopicState, report: TopicReport | None) -> dict[str, str]:
    values = {f"{state.topic}: publishers": ", ".join(publisher.node for publisher in state.publishers)}
    if report is None:
        return values
    figures = {
        "messages written": report.messages,
        "samples received": report.received,
        "samples written": report.written,
        "samples lost": report.dropped,
        "restarts of the count": report.restarts,
    }
    return values | {f"{state.topic}: {name}": str(value) for name, value in figures.items()}
