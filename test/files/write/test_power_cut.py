"""What survives a power cut: files and names that were synced, in the order in which they are needed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from bag_samples import make_samples
from recorder_blocks import START, TOPICS, block, feed

from drive_id.errors import EmptyTopicError
from drive_id.files.storage import durable
from drive_id.files.write.recover import recover_bag
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter
from drive_id.files.write.writer import write_recording
from drive_id.live.recording.recording_session import RecordingSession
from drive_id.live.recording.recording_settings import RecordingSettings


def of(path):
    """Return the names in a folder, or the size of a file, as a set."""
    return {each.name for each in path.iterdir()} if path.is_dir() else {path.stat().st_size}


class Disk:
    """What is on the disk: sizes of files and names in folders when they were last synced, by their inodes."""

    def __init__(self, monkeypatch):
        self.there, sync = {}, os.fsync

        def fsync(descriptor):
            path = Path(f"/proc/self/fd/{descriptor}").resolve()
            self.there[path.stat().st_ino] = of(path)
            sync(descriptor)

        monkeypatch.setattr(os, "fsync", fsync)

    def lacks(self, folder):
        """Return the names of files and folders below, and above up to ``disk``, of which something was not synced."""
        above = [each for each in (folder, *folder.parents) if "disk" in each.parts]
        paths = {*above, *folder.rglob("*.mcap"), *folder.rglob("*.yaml")}
        return {path.name for path in paths if of(path) - self.there.get(path.stat().st_ino, set())}


@pytest.fixture
def disk(monkeypatch):
    return Disk(monkeypatch)


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
    ("write", "bag"),
    [
        (recorded, "new/bag"), (recovered, "bag"),
        (lambda folder: write_recording(folder / "bag", make_samples(2000)), "bag"),
    ],
)  # fmt: skip
def test_a_complete_recording_is_on_the_disk_with_all_its_names(tmp_path, disk, write, bag):
    (tmp_path / "disk").mkdir()
    write(tmp_path / "disk")
    assert (tmp_path / "disk" / bag / "metadata.yaml").exists()
    assert disk.lacks(tmp_path / "disk" / bag) == set()


def test_what_was_flushed_to_the_disk_is_there_and_the_next_file_has_a_name(tmp_path, disk):
    (tmp_path / "disk").mkdir()
    bag = tmp_path / "disk" / "new" / "bag"
    writer = Rosbag2McapWriter(bag, live=True, chunk_size=4096)
    add_blocks(writer, 0, 10)
    assert "bag_0.mcap" in disk.lacks(bag)  # so far, it may be lost
    writer.flush()
    assert disk.lacks(bag) == set()
    writer.split()
    add_blocks(writer, 10, 10)
    writer.flush()
    assert disk.lacks(bag) == set()
    writer.abandon()


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
