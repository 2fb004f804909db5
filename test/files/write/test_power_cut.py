"""What a power cut leaves of a recording: all that was synced, whatever else the disk forgets."""

from __future__ import annotations

import random
import shutil

import pytest
from bag_samples import make_samples
from forgetful_disk import logged
from recorder_blocks import START, TOPICS, block, feed
from rosbags.rosbag2 import Reader

from drive_id.errors import EmptyTopicError
from drive_id.files.storage import durable
from drive_id.files.write.recover import recover_bag
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter
from drive_id.files.write.writer import write_recording
from drive_id.live.recording.recording_session import RecordingSession
from drive_id.live.recording.recording_settings import RecordingSettings


def tree(folder):
    return {str(each.relative_to(folder)): each.read_bytes() for each in folder.rglob("*") if each.is_file()}


def states(log, folder, count, number):
    """Yield ``number`` folders that a power cut behind ``count`` operations may leave."""
    for seed in range(number):
        log.crash_state(count, random.Random(seed), folder / "state")
        yield folder / "state"
        shutil.rmtree(folder / "state")


def recorded(folder):
    session = RecordingSession(folder / "new" / "bag", TOPICS, RecordingSettings(max_file_duration=0.2))
    feed(session, 50)
    session.stop()


def recovered(folder):
    live = folder.parent / "live"
    with Rosbag2McapWriter(live / "bag", live=True) as writer:
        add_blocks(writer, 0, 5)
    (live / "bag" / "metadata.yaml").unlink()
    recover_bag(live / "bag", folder / "bag")


def add_blocks(writer, first, count):
    for topic in TOPICS if first == 0 else ():
        writer.add_topic(topic.name, topic.type_name)
    for number in range(first, first + count):
        for topic in TOPICS:
            writer.write(topic.name, block(topic.type_name, 100 * number), START + number * 10_000_000)


@pytest.mark.parametrize(
    "write", [recorded, recovered, lambda folder: write_recording(folder / "bag", make_samples(2000))]
)
def test_nothing_of_a_complete_recording_is_lost(tmp_path, write):
    (tmp_path / "disk").mkdir()
    with logged(tmp_path / "disk") as log:
        write(tmp_path / "disk")
    there = tree(tmp_path / "disk")
    assert any(name.endswith("metadata.yaml") for name in there)
    log.final_state(tmp_path / "replayed")
    assert tree(tmp_path / "replayed") == there, "an operation escaped the log"
    for state in states(log, tmp_path, len(log.operations), 30):
        assert {name: data for name, data in tree(state).items() if ".partial" not in name} == there


@pytest.mark.cases
@pytest.mark.parametrize("split", [False, True])
def test_what_was_flushed_to_the_disk_can_be_recovered(tmp_path, split):
    (tmp_path / "disk").mkdir()
    with logged(tmp_path / "disk") as log:
        writer = Rosbag2McapWriter(tmp_path / "disk" / "new" / "bag", live=True, chunk_size=4096)
        add_blocks(writer, 0, 10)
        if split:
            writer.split()
            add_blocks(writer, 10, 10)
        writer.flush(sync=True)
        synced = len(log.operations)
        promised = sum(file.entry.count for file in writer._files)
        add_blocks(writer, 20, 10)
        writer.split()  # leaves a file whose name, but not its beginning, may be on the disk
        writer.flush()
        count = len(log.operations)
        writer.abandon()
    for number in range(synced, count, 5):
        for state in states(log, tmp_path, number, 2):
            recovery = recover_bag(state / "new" / "bag")
            with Reader(recovery.output) as reader:
                found = [(each.topic, bytes(data)) for each, _, data in reader.messages()]
            assert len(found) >= promised
            for topic in TOPICS:
                blocks = [data for name, data in found if name == topic.name]
                first = [int.from_bytes(data[28:36], "little") for data in blocks]
                assert first[: promised // 4] == [100 * k for k in range(promised // 4)]
                assert all(data == block(topic.type_name, k) for k, data in zip(first, blocks, strict=True))


def test_without_any_sync_everything_may_be_lost(tmp_path):
    """The disk of these tests does forget."""
    (tmp_path / "disk").mkdir()
    with logged(tmp_path / "disk") as log:
        writer = Rosbag2McapWriter(tmp_path / "disk" / "bag", live=True)
        add_blocks(writer, 0, 10)
        writer.flush()
        count = len(log.operations)
        writer.abandon()
    sizes = {sum(len(data) for data in tree(state).values()) for state in states(log, tmp_path, count, 30)}
    assert 0 in sizes
    assert len(sizes) > 3


def test_a_file_whose_beginning_is_lost_is_left_out(tmp_path):
    with Rosbag2McapWriter(tmp_path / "bag", live=True) as writer:
        add_blocks(writer, 0, 5)
        writer.split()
        add_blocks(writer, 5, 5)
    (tmp_path / "bag" / "bag_1.mcap").write_bytes(b"")
    recovery = recover_bag(tmp_path / "bag", tmp_path / "a")
    assert sum(recovery.topics.values()) == 20
    (said,) = recovery.damage
    assert said == f"{tmp_path / 'bag' / 'bag_1.mcap'}: its start was never written to disk; the file is left out."
    (tmp_path / "bag" / "bag_0.mcap").write_bytes(bytes(5000))
    with pytest.raises(EmptyTopicError, match=r"bag_0\.mcap: its start"):
        recover_bag(tmp_path / "bag", tmp_path / "b")


def test_a_folder_that_cannot_be_synced(tmp_path, monkeypatch):
    def refuse(number):
        def fsync(_descriptor):
            raise OSError(number, "refused")

        return fsync

    monkeypatch.setattr(durable.os, "fsync", refuse(22))
    durable.sync_folder(tmp_path)  # a file system that cannot: nothing to be done
    monkeypatch.setattr(durable.os, "fsync", refuse(5))
    with pytest.raises(OSError, match="refused"):
        durable.sync_folder(tmp_path)
    with pytest.raises(FileNotFoundError):
        durable.sync_folder(tmp_path / "none")
