"""What the recorder says of itself, for each thing that can be wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from drive_id.common.health import Level
from drive_id.live.publishers import Publisher, reliable_wanted
from drive_id.live.recording.recorder_health import TopicState, recorder_health
from drive_id.live.recording.recording_report import RecordingReport, TopicReport
from drive_id.live.recording.recording_settings import RecordingSettings

KIND = "drive_id_msgs/msg/Resolver"
BENCH = Publisher("/bench", KIND)
SETTINGS = RecordingSettings(silence=1.0, queue_size=64.0)


def report(**fields):
    error, waiting = fields.pop("error", ""), fields.pop("waiting", 0)
    return RecordingReport(Path("/data/bag"), (TopicReport("/resolver", **fields),), 1, 10, waiting, error)


def health(found, publishers=(BENCH,), silent_for=0.1):
    return recorder_health(found, [TopicState("/resolver", KIND, publishers, silent_for)], SETTINGS)


def test_nothing_is_wrong():
    idle = health(None)
    assert (idle.level, idle.message) == (Level.OK, "Not recording.")
    assert idle.values["/resolver: publishers"] == "/bench"
    running = health(report(messages=2, received=20, written=20))
    assert (running.level, running.message) == (Level.OK, "Recording /data/bag.")
    assert running.values["samples"] == running.values["/resolver: samples written"] == "20"


def test_samples_in_the_queue_are_not_dropped():
    found = health(report(received=50, written=20, lost=4, losses=1, overflowed=3, waiting=1000))
    assert found.values["samples dropped"] == found.values["/resolver: samples lost"] == "7"


@pytest.mark.parametrize(
    ("fields", "level", "said"),
    [
        (
            {"received": 20, "written": 20, "lost": 3, "losses": 2},
            Level.WARN,
            "3 samples of /resolver in 2",
        ),
        ({"unreadable": 4}, Level.WARN, "4 messages on /resolver without"),
        ({"received": 20, "overflowed": 20}, Level.ERROR, "no room for 20 samples"),
        ({"received": 20, "waiting": 40_000_000}, Level.WARN, "20 samples, 40.0 MB, wait for it"),
    ],
)
def test_samples_are_missing(fields, level, said):
    found = health(report(**fields))
    assert found.level == level
    assert said in found.message


def test_an_error_comes_alone_and_first():
    found = health(report(error="The disk is full."), silent_for=9.0)
    assert (found.level, found.message) == (Level.ERROR, "The disk is full.")


@pytest.mark.parametrize(
    ("publishers", "silent_for", "level", "said"),
    [
        ((), 0.1, Level.WARN, "Nobody publishes /resolver."),
        ((BENCH,), None, Level.WARN, "No message has come on /resolver yet."),
        ((BENCH,), 1.5, Level.WARN, "No message has come on /resolver for 1.5 s."),
        ((BENCH, Publisher("/other", KIND)), 0.1, Level.WARN, "/bench and /other both publish /resolver"),
        ((Publisher("/bench", KIND, reliable=False),), 0.1, Level.WARN, "as best effort only"),
        ((BENCH, Publisher("/x", "a/msg/B")), 0.1, Level.ERROR, f"/x publishes a/msg/B on /resolver instead of {KIND}"),
    ],
)
def test_publishers_that_do_not_fit(publishers, silent_for, level, said):
    found = health(report(), publishers, silent_for)
    assert found.level == level
    assert said in found.message


def test_reliability_follows_the_publishers():
    unreliable, stranger = Publisher("/a", KIND, reliable=False), Publisher("/b", "a/msg/B", reliable=False)
    for publishers, now, wanted in (
        ([], True, True), ([], False, False), ([stranger], True, True), ([BENCH, stranger], False, True),
        ([unreliable], True, False), ([BENCH, unreliable], True, False),
    ):  # fmt: skip
        assert reliable_wanted(publishers, KIND, now) is wanted


def test_optional_topics_may_be_absent_or_silent():
    running = report(messages=2, received=20, written=20)
    torque = Publisher("/meter", "drive_id_msgs/msg/ScalarSamples")
    states = [TopicState("/resolver", KIND, (BENCH,), 0.1)]
    absent = TopicState("/shaft_torque", torque.type_name, (), None, optional=True)
    found = recorder_health(running, [*states, absent], SETTINGS)
    assert (found.level, found.message) == (Level.OK, "Recording /data/bag.")
    assert not any("shaft_torque" in name for name in found.values)
    silent = TopicState("/shaft_torque", torque.type_name, (torque,), 60.0, optional=True)
    assert recorder_health(running, [*states, silent], SETTINGS).level == Level.OK
    other = TopicState(
        "/shaft_torque", torque.type_name, (Publisher("/x", "std_msgs/msg/Float64"),), None, optional=True
    )
    assert recorder_health(running, [*states, other], SETTINGS).level == Level.WARN
    late = RecordingReport(
        running.path, (*running.topics, TopicReport("/shaft_torque", lost=3, losses=1)), 1, 10, 0, ""
    )
    assert "Lost 3 samples of /shaft_torque" in recorder_health(late, [*states, silent], SETTINGS).message


def test_a_publisher_that_does_not_count_is_told():
    found = health(report(received=50, written=50, uncounted=True))
    assert found.level == Level.WARN
    assert "first_sample of /resolver is always 0" in found.message


def test_two_sentences_at_most_the_most_severe_first():
    figures = {"received": 50, "written": 20, "lost": 4, "losses": 1, "overflowed": 3, "unreadable": 2}
    further = [(Level.ERROR, "The clock stands."), (Level.WARN, "It is late.")]
    topics = [TopicState("/resolver", KIND, (), None)]
    found = recorder_health(report(**figures), topics, SETTINGS, further)
    assert found.level == Level.ERROR
    assert found.message == "Recording /data/bag. The clock stands."
    rest = [found.values[f"also {number}"] for number in range(1, 6)]
    assert "queue had no room" in rest[0]  # the other error
    assert {"It is late.", "Nobody publishes /resolver."} <= set(rest)
    assert "also 6" not in found.values
