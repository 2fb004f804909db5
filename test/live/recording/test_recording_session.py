"""The engine of the recorder: untouched messages, exact counts, whole files, and what a full disk leaves."""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import threading
import time
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from recorder_blocks import PERIOD, START, TOPICS, FullDisk, block, feed, metadata, stock_messages
from rosbags.rosbag2 import Reader

from drive_id.errors import ConfigurationError, OutputError
from drive_id.files.messages.block_codec import decode_block, encode_block, read_head
from drive_id.files.messages.messages import SCALAR_SAMPLES, type_hash
from drive_id.files.read.info import bag_info
from drive_id.files.read.several import read_recording
from drive_id.files.write.recover import recover_bag
from drive_id.live.data_directory import new_recording
from drive_id.live.recording import recording_session
from drive_id.live.recording.recording_session import RecordedTopic, RecordingSession
from drive_id.live.recording.recording_settings import RecordingSettings
from drive_id.types import SCALARS

NO_DISK = os.strerror(errno.ENOSPC)


def record(path, settings=None, **options):
    return RecordingSession(path, TOPICS, settings or RecordingSettings(), **options)


def wait_for(condition, timeout=30.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


OPTIONAL = tuple(RecordedTopic(f"/{name}", SCALAR_SAMPLES, optional=True) for name in SCALARS)


def test_optional_topics_are_in_the_bag_from_their_first_message_on(tmp_path):
    """Absent ones are in neither bag nor report, and are no loss; a late one is whole."""
    session = RecordingSession(tmp_path / "bag", (*TOPICS, *OPTIONAL), RecordingSettings())
    feed(session, 30)
    temperature = [
        encode_block(START + 10**9 + k * 10**8, k, 0.1, [np.full(1, 20.0 + k, np.float32)], "drive") for k in range(5)
    ]
    for k, data in enumerate(temperature):
        session.receive("/winding_temperature", data, START + 10**9 + k * 10**8)
    feed(session, 30, first=30)
    assert session.stop()
    report = session.report()
    assert [topic.topic for topic in report.topics] == [*(topic.name for topic in TOPICS), "/winding_temperature"]
    assert report.topics[-1].written == report.topics[-1].received == 5
    assert "no sample was lost." in report.outcome()
    found = stock_messages(tmp_path / "bag")
    assert [data for topic, _, data in found if topic == "/winding_temperature"] == temperature
    with Reader(tmp_path / "bag") as reader:
        kinds = {connection.topic: (connection.msgtype, connection.digest) for connection in reader.connections}
    assert set(kinds) == {*(topic.name for topic in TOPICS), "/winding_temperature"}
    assert kinds["/winding_temperature"] == (SCALAR_SAMPLES, type_hash(SCALAR_SAMPLES))


def test_an_optional_topic_may_begin_in_a_later_file(tmp_path):
    session = RecordingSession(tmp_path / "bag", (*TOPICS, *OPTIONAL), RecordingSettings(max_file_duration=0.1))
    feed(session, 30)
    wait_for(lambda: session.report().files > 1)
    session.receive("/shaft_torque", block(SCALAR_SAMPLES, 0), START + 10**9)
    feed(session, 5, first=30)
    assert session.stop()
    assert bag_info(tmp_path / "bag").complete
    counts = {topic.name: topic.count for topic in bag_info(tmp_path / "bag").topics}
    assert counts["/shaft_torque"] == 1
    assert counts["/phase_currents"] == 35


# -- messages and counts -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 7, 100])
@pytest.mark.parametrize("name", ["", "a", "drive", "drive_12"])
def test_the_head_of_a_block_is_that_of_the_whole_block(name, size):
    data = bytearray(encode_block(START + 5, 2**40, PERIOD, [np.arange(size, dtype=np.float32)] * 3, name))
    assert read_head(data) == decode_block(data, 3).head
    for length in range(40):
        with pytest.raises(ValueError, match=r"too early|like a CDR"):
            read_head(data[: min(length, 24 + len(name))])
    with pytest.raises(ValueError, match="like a CDR"):
        read_head(b"\x00\x09" + bytes(60))


def test_messages_are_written_untouched(tmp_path):
    session = record(tmp_path / "bag")
    feed(session, 50)
    assert session.stop()
    report = session.report()
    assert (report.samples, report.dropped, report.error) == (5000, 0, "")
    assert report.duration == pytest.approx(0.4999)
    assert "no sample was lost" in report.outcome()
    expected = [
        (topic.name, START + round((number + 1) * 1e7), block(topic.type_name, number * 100))
        for number in range(50)
        for topic in TOPICS
    ]
    assert stock_messages(tmp_path / "bag") == sorted(expected)
    recording = read_recording(tmp_path / "bag")
    assert (len(recording.samples), recording.warnings) == (5000, ())
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def test_losses_are_counted_to_the_sample(tmp_path):
    session = record(tmp_path / "bag")
    lose = {(3, "/resolver"), (4, "/resolver"), (9, "/resolver"), (5, "/phase_currents")}
    feed(session, 20, lose=lose)
    session.receive("/resolver", b"no block", START)
    session.stop()
    report = session.report()
    currents, voltages, resolver, _ = report.topics
    assert (currents.received, currents.written, currents.lost, currents.losses) == (1900, 1900, 100, 1)
    assert (resolver.received, resolver.lost, resolver.losses, resolver.unreadable) == (1700, 300, 2, 1)
    assert (voltages.lost, report.dropped) == (0, 400)
    assert "these samples were lost: 100 of /phase_currents, 300 of /resolver" in report.outcome()
    custom = metadata(tmp_path / "bag")["custom_data"]
    assert custom["samples_lost:/resolver"] == "300"
    assert custom["samples_received:/resolver"] == custom["samples_written:/resolver"] == "1700"


def test_a_queue_that_is_full_loses_and_counts(tmp_path):
    class SlowDisk(io.FileIO):
        def write(self, data):
            time.sleep(0.3)
            return super().write(data)

    settings = RecordingSettings(queue_size=0.05)
    session = record(tmp_path / "bag", settings, opener=lambda path: SlowDisk(path, "xb"))
    feed(session, 300)
    session.stop()
    report = session.report()
    assert report.error == ""
    assert report.topics[0].received == 30000
    assert 0 < report.topics[0].written < 30000
    assert report.overflowed == report.dropped == sum(30000 - topic.written for topic in report.topics)
    assert len(stock_messages(tmp_path / "bag")) == sum(topic.messages for topic in report.topics)


def test_a_recording_ends_complete_before_the_disk_is_full(tmp_path, monkeypatch):
    free = [3e9]
    monkeypatch.setattr(recording_session, "free_space", lambda _: int(free[-1]))
    session = record(tmp_path / "bag", RecordingSettings(flush_period=0.05))
    feed(session, 20)
    free.append(150e6)  # between two blocks, not between two topics of one
    wait_for(lambda: session.error)
    feed(session, 1, first=20)
    number = 21
    assert session.stop(10.0)
    report = session.report()
    assert "has 150 MB left, less than least_free_space (200 MB): free some space, or lower it. The" in report.outcome()
    assert 0 < report.samples <= 100 * number
    assert report.dropped == 0
    recording = read_recording(tmp_path / "bag")
    assert (len(recording.samples), recording.warnings) == (report.samples, ())
    assert "least_free_space" in metadata(tmp_path / "bag")["custom_data"]["error"]


def test_a_recording_whose_client_is_gone_ends_complete(tmp_path):
    by_hand = record(tmp_path / "by_hand", RecordingSettings(lease_time=0.1))
    session = record(tmp_path / "bag", RecordingSettings(lease_time=0.1, flush_period=60.0))
    session.heartbeat()
    feed(session, 20)
    wait_for(lambda: session.error)
    assert session.stop(10.0)
    report = session.report()
    assert (report.samples, report.dropped) == (2000, 0)
    assert re.match(r"The client that records has sent no heartbeat for 0\.\d s, longer than lease_time", report.error)
    assert "longer than lease_time" in metadata(tmp_path / "bag")["custom_data"]["error"]
    assert len(read_recording(tmp_path / "bag").samples) == 2000
    assert not by_hand.error
    assert by_hand.stop()


def test_waiting_for_the_disk_is_not_a_loss_and_the_count_of_losses_only_grows(tmp_path):
    class SlowDisk(io.FileIO):
        def write(self, data):
            time.sleep(0.02)
            return super().write(data)

    settings = RecordingSettings(flush_period=0.05, compression="none", chunk_size=8192)
    session = record(tmp_path / "bag", settings, opener=lambda path: SlowDisk(path, "xb"))
    dropped, waiting = [], []

    def observe():
        report = session.report()
        dropped.append(report.dropped)
        waiting.append(sum(topic.queued for topic in report.topics))

    for number in range(60):
        feed(session, 1, first=number, lose={(30, "/resolver")})
        observe()
        time.sleep(0.002)
    stopping = threading.Thread(target=session.stop)
    stopping.start()
    while stopping.is_alive():
        observe()
        time.sleep(0.002)
    observe()
    assert max(waiting) > 400
    assert waiting[-1] == 0
    assert dropped == sorted(dropped)
    assert set(dropped) == {0, 100}
    information = metadata(tmp_path / "bag")["custom_data"]
    assert information["samples_lost:/resolver"] == "100"


def test_samples_that_the_disk_refused_are_dropped_and_none_is_counted_twice(tmp_path):
    settings = RecordingSettings(compression="none", chunk_size=8192)
    session = record(tmp_path / "bag", settings, opener=lambda path: FullDisk(path, 200_000))
    dropped = []
    number = 0
    while not session.error:
        feed(session, 1, first=number, lose={(3, "/resolver")})
        dropped.append(session.report().dropped)
        time.sleep(0.0005)
        number += 1
    session.stop()
    report = session.report()
    assert dropped == sorted(dropped)
    for topic in report.topics:
        assert topic.queued == 0
        assert topic.dropped == topic.lost + topic.received - topic.written
    assert report.dropped > 100


# -- files ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings", [RecordingSettings(max_file_duration=0.1), RecordingSettings(max_file_size=0.05, chunk_size=4096)]
)
def test_splitting(tmp_path, settings):
    session = record(tmp_path / "bag", settings)
    feed(session, 60)
    session.stop()
    report = session.report()
    information = metadata(tmp_path / "bag")
    names = information["relative_file_paths"]
    assert names == [f"bag_{number}.mcap" for number in range(len(names))]
    assert len(names) >= 3
    assert report.files == len(names)
    assert report.size == sum(path.stat().st_size for path in (tmp_path / "bag").glob("*.mcap"))
    assert sum(file["message_count"] for file in information["files"]) == information["message_count"] == 240
    assert len(stock_messages(tmp_path / "bag")) == 240
    for file in information["files"]:
        assert bag_info(tmp_path / "bag" / file["path"]).messages == file["message_count"]
    assert len(read_recording(tmp_path / "bag").samples) == 6000


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_compressions(tmp_path, compression):
    session = record(tmp_path / "bag", RecordingSettings(compression=compression))
    feed(session, 3)
    session.stop()
    assert bag_info(tmp_path / "bag").compression == compression.replace("none", "")
    assert len(stock_messages(tmp_path / "bag")) == 12


def test_what_was_flushed_is_there_before_the_end(tmp_path):
    session = record(tmp_path / "bag", RecordingSettings(flush_period=0.1))
    feed(session, 40)
    wait_for(lambda: bag_info(tmp_path / "bag").messages == 160)
    recording = read_recording(tmp_path / "bag")
    assert "was not completed" in recording.warnings[0]
    assert len(recording.samples) == 4000
    session.stop()
    assert read_recording(tmp_path / "bag").warnings == ()


# -- disks ---------------------------------------------------------------------------------------------------------


def feed_until_error(session):
    number = 0
    while not session.error:
        assert number < 100_000
        feed(session, 1, first=number)
        time.sleep(0.0005)
        number += 1
    feed(session, 5, first=number)  # arrives too late, and does no harm


@pytest.mark.parametrize("room", [200_000, 333_333])
@pytest.mark.parametrize("duration", [0.0, 0.2])
def test_a_disk_that_is_full_leaves_a_whole_bag(tmp_path, room, duration):
    left = [room]

    def opener(path):
        """The files share the disk; those but the last are about 90 kB."""
        left.append(max(left[-1] - 90_000, 0) if duration else room)
        return FullDisk(path, left[-2])

    settings = RecordingSettings(max_file_duration=duration, compression="none", chunk_size=8192)
    session = record(tmp_path / "bag", settings, opener=opener)
    feed_until_error(session)
    session.stop()
    report = session.report()
    assert NO_DISK in report.error
    assert "has ended; what was written until then is complete and readable" in report.error
    messages = stock_messages(tmp_path / "bag")
    assert len(messages) == sum(topic.messages for topic in report.topics) > 30
    for topic in report.topics:
        heads = [read_head(data) for name, _, data in messages if name == topic.topic]
        assert sum(head.samples for head in heads) == topic.written
        assert topic.received > topic.written
    information = metadata(tmp_path / "bag")
    assert information["custom_data"]["error"]
    assert information["custom_data"]["samples_written:/resolver"] == str(report.topics[2].written)
    assert read_recording(tmp_path / "bag").samples.i_abc.shape[0] >= 0.9 * report.samples


def test_a_disk_that_fails_altogether_leaves_what_was_flushed(tmp_path):
    class BrokenDisk(FullDisk):
        def truncate(self, *_):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    settings = RecordingSettings(compression="none", chunk_size=8192)
    session = record(tmp_path / "bag", settings, opener=lambda path: BrokenDisk(path, 100_000))
    feed_until_error(session)
    session.stop()
    assert "complete it with 'drive-id recover'" in session.error
    recording = read_recording(tmp_path / "bag")
    assert "was not completed" in recording.warnings[0]
    assert session.report().samples >= len(recording.samples) > 1000


def test_an_error_of_the_index_loses_nothing(tmp_path):
    """The disk is full when the bag is being completed: a file without index remains, with all messages."""
    sizes = []
    for room in (10**9, None):
        path = tmp_path / str(room)
        settings = RecordingSettings(compression="none")
        limit = room or sizes[0] - 300
        session = record(path, settings, opener=lambda path, limit=limit: FullDisk(path, limit))
        feed(session, 20)
        session.stop()
        sizes.append(session.report().size)
        assert bool(session.error) == (room is None)
        assert len(stock_messages(path)) == 80
    assert bag_info(path).messages == 80


def test_a_bag_that_cannot_be_begun(tmp_path):
    with pytest.raises(OutputError, match=f"bag cannot be written .{NO_DISK}"):
        record(tmp_path / "bag", opener=lambda path: FullDisk(path, 10))
    assert list(tmp_path.iterdir()) == []
    record(tmp_path / "bag").stop()
    with pytest.raises(OutputError, match="exists already"):
        record(tmp_path / "bag")


# -- names ---------------------------------------------------------------------------------------------------------

NOW = datetime(2026, 3, 4, 5, 6, 7, tzinfo=timezone.utc)


def test_names(tmp_path):
    assert new_recording(tmp_path, "run_1.b", NOW) == tmp_path / "run_1.b"
    assert new_recording(tmp_path, "", NOW) == tmp_path / "recording_2026-03-04_05-06-07"
    (tmp_path / "recording_2026-03-04_05-06-07").mkdir()
    assert new_recording(tmp_path, "", NOW) == tmp_path / "recording_2026-03-04_05-06-07_2"
    assert new_recording(Path("data"), "x", NOW) == Path.cwd() / "data" / "x"


@pytest.mark.parametrize(
    "name", ["/tmp/x", "..", ".", "../x", "a/b", "a/../../b", ".hidden", "-x", "a\nb", "a\0b", "x" * 201, " ", "ä"]
)
def test_names_that_are_none(tmp_path, name):
    with pytest.raises(ConfigurationError, match="is not a name for a recording"):
        new_recording(tmp_path, name, NOW)


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").symlink_to(tmp_path / "nowhere")
    for name in ("a", "b"):
        with pytest.raises(OutputError, match="exists already"):
            new_recording(tmp_path, name, NOW)


# -- a bag that goes away -------------------------------------------------------------------------------------------


def assert_given_up(session, path):
    wait_for(lambda: session.error)
    feed(session, 5, first=30)  # nobody takes them any more
    assert session.stop()
    report = session.report()
    assert f"{path} was removed or renamed" in report.outcome()
    assert "no sample was lost" not in report.outcome()
    assert session.error.count(".") == str(path).count(".") + 1  # one sentence
    assert (report.samples, report.dropped) == (0, 4 * 3000)


def remove(folder):
    """Remove a folder like ``rm -r``, which goes on where the recorder removes a file of its own meanwhile."""
    while folder.exists():
        shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.parametrize("settings", [{}, {"max_file_size": 0.05}])
def test_a_folder_that_is_removed_ends_the_recording_at_the_next_flush(tmp_path, settings):
    session = record(tmp_path / "bag", RecordingSettings(flush_period=0.1, **settings))
    feed(session, 30)
    wait_for(lambda: session.report().samples == 3000)
    remove(tmp_path / "bag")
    assert_given_up(session, tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_a_folder_that_is_renamed_ends_the_recording_and_can_be_completed(tmp_path):
    session = record(tmp_path / "bag", RecordingSettings(flush_period=0.1))
    feed(session, 30)
    wait_for(lambda: session.report().samples == 3000)
    (tmp_path / "bag").rename(tmp_path / "other")
    (tmp_path / "bag").mkdir()  # somebody else's
    assert_given_up(session, tmp_path / "bag")
    assert list((tmp_path / "bag").iterdir()) == []
    recovery = recover_bag(tmp_path / "other")
    assert sum(recovery.topics.values()) == 4 * 30


def test_a_folder_that_is_removed_just_before_the_stop(tmp_path):
    session = record(tmp_path / "bag", RecordingSettings(flush_period=60.0))
    feed(session, 30)
    wait_for(lambda: session.report().samples == 3000)
    remove(tmp_path / "bag")
    assert session.stop()
    assert "was removed or renamed" in session.report().outcome()
    assert "no sample was lost" not in session.report().outcome()


# -- what the figures cannot say -------------------------------------------------------------------------------------


def test_a_publisher_that_does_not_count_its_samples(tmp_path):
    session = record(tmp_path / "bag")
    currents, resolver = TOPICS[0], TOPICS[2]
    for number in range(10):
        session.receive(currents.name, block(currents.type_name, 0), START + number)
        session.receive(resolver.name, block(resolver.type_name, number * 100), START + number)
    assert session.stop()
    said = session.report().outcome()
    assert "losses on /phase_currents do not show, for first_sample is always 0 there" in said
    assert "no sample was lost" not in said
    assert "/resolver do not show" not in said


def test_a_remark_is_said_and_kept(tmp_path):
    session = record(tmp_path / "bag")
    feed(session, 1)
    session.remark = "The clock stood still."
    assert session.stop()
    assert session.report().outcome().endswith(" The clock stood still.")
    assert metadata(tmp_path / "bag")["custom_data"]["remark"] == "The clock stood still."
