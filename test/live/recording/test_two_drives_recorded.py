"""Where another drive begins, the recorder begins another recording in the bag, and says so."""

from __future__ import annotations

import numpy as np
from recorder_blocks import PERIOD, START, TOPICS, block, feed, metadata

from drive_id.common.health import Level
from drive_id.files.messages.block_codec import decode_block, encode_block
from drive_id.files.messages.messages import BLOCK_FIELDS, CURRENT_REFERENCE
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.drive_parts import drive_parts
from drive_id.live.publishers import Publisher
from drive_id.live.recording.recorder_health import recorder_health
from drive_id.live.recording.recording_session import RecordingSession
from drive_id.live.recording.recording_settings import RecordingSettings

SIGNALS = TOPICS[:3]


def play(session, numbers, *, count=0, later=0.0, frame="drive"):
    """Give a session blocks of a drive that counts from ``count`` on, ``later`` s behind the first one."""
    for number in numbers:
        for topic in TOPICS:
            values = decode_block(block(topic.type_name, 100 * number), len(BLOCK_FIELDS[topic.type_name])).values
            stamp = START + round((100 * number * PERIOD + later) * 1e9)
            own = (1, 0, False, False) if topic.type_name == CURRENT_REFERENCE else None
            values = [np.array(each) for each in values]
            session.receive(topic.name, encode_block(stamp, count + 100 * number, PERIOD, values, frame, own), stamp)


def test_another_drive_begins_another_recording(tmp_path):
    session = RecordingSession(tmp_path / "bag", TOPICS, RecordingSettings())
    play(session, range(30))
    play(session, range(30), later=0.3, count=3000, frame="b")
    assert session.stop()
    report = session.report()
    assert report.outcome().endswith(f"the second from 0.300 s on: {report.changes[0].reason}")
    assert "'drive' to 'b'" in report.changes[0].reason
    assert "no sample was lost; " not in report.sentence()
    assert report.dropped == 0
    information = metadata(tmp_path / "bag")
    custom = information["custom_data"]
    assert custom["recordings"] == "2"
    assert "'drive' to 'b'" in custom["recording_2:because"]
    assert len(information["files"]) == 2
    begins = information["files"][1]["starting_time"]["nanoseconds_since_epoch"]
    assert str(begins) == custom["recording_2:begins"]
    health = recorder_health(report, [], RecordingSettings())
    assert health.level is Level.WARN
    assert "The bag holds 2 recordings" in health.message
    parts = drive_parts(tmp_path / "bag", SignalMap())
    assert [part.samples for part in parts] == [3000, 3000]
    assert "'drive' to 'b'" in parts[1].reason


def test_a_second_publisher_begins_another_recording(tmp_path):
    session = RecordingSession(tmp_path / "bag", TOPICS, RecordingSettings())

    def heard(*names):
        for topic in SIGNALS:
            found = [Publisher(f"/{name}", topic.type_name, identity=f"{name}{topic.name}") for name in names]
            session.publishers(topic.name, found, START + 10**9)

    heard("drive")
    play(session, range(30))
    heard("drive", "rival")
    play(session, range(30), later=1.0, count=10_000)
    assert session.stop()
    assert len(session.report().changes) == 1
    assert "/rival publishes /phase_currents besides /drive" in session.report().outcome()
    assert [part.samples for part in drive_parts(tmp_path / "bag", SignalMap())] == [3000, 3000]


def test_two_drives_at_once_are_told_of_once_a_second(tmp_path):
    session = RecordingSession(tmp_path / "bag", TOPICS, RecordingSettings())
    for number in range(250):
        play(session, [number])
        play(session, [number], count=70_000)
    assert session.stop()
    assert 2 <= len(session.report().changes) <= 3
    assert len(metadata(tmp_path / "bag")["files"]) <= 4


def test_a_pause_and_a_restarted_publisher_of_references_are_none(tmp_path):
    session = RecordingSession(tmp_path / "bag", TOPICS, RecordingSettings())
    feed(session, 20)
    session.pause()
    feed(session, 20, first=20)
    session.resume()
    feed(session, 20, first=40)
    session.receive(TOPICS[3].name, block(CURRENT_REFERENCE, 0), START + 10**9)
    assert session.stop()
    assert session.report().changes == ()
    assert "recordings" not in metadata(tmp_path / "bag")["custom_data"]
