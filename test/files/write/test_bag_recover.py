"""Recordings that break off: read where that is safe, recovered for stock readers wherever something is left."""

from __future__ import annotations

import hashlib
import json
import random
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from bag_samples import START as SAMPLES_START
from bag_samples import make_samples, write_foreign
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from recorder_blocks import TOPICS, feed, metadata, stock_messages
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from drive_id.cli.app import app
from drive_id.errors import BagError, EmptyTopicError, NotABagError, OutputError, TruncatedBagError
from drive_id.files.read.info import bag_info
from drive_id.files.read.several import read_recording
from drive_id.files.write.recover import recover_bag
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter
from drive_id.files.write.writer import write_recording
from drive_id.live.recording.recording_session import RecordingSession
from drive_id.live.recording.recording_settings import RecordingSettings

QOS_OF_HUMBLE = """\
- history: 3
  depth: 0
  reliability: 1
  durability: 2
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A recording of 60 blocks on each topic, small chunks, in two files."""
    path = tmp_path_factory.mktemp("live") / "bag"
    session = RecordingSession(path, TOPICS, RecordingSettings(max_file_duration=0.4, chunk_size=8192))
    feed(session, 60)
    session.stop()
    return path


@pytest.fixture
def copy(live, tmp_path):
    """A copy without metadata.yaml, as a killed recorder leaves it, its last file still whole."""
    shutil.copytree(live, tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    return tmp_path / "bag"


def cut(file: Path, size: int, tail: bytes = b"") -> None:
    file.write_bytes(file.read_bytes()[:size] + tail)


def digest(path: Path) -> str:
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files if file.is_file())).hexdigest()


# -- recordings of ours --------------------------------------------------------------------------------------------


def test_a_recording_cut_anywhere_is_read_as_far_as_it_goes(copy, live):
    every = read_recording(live).samples
    file = copy / "bag_1.mcap"
    data = file.read_bytes()
    lengths = []
    for size in sorted(random.Random(1).sample(range(200, len(data)), 25)):
        file.write_bytes(data[:size])
        recording = read_recording(copy)
        (warning,) = [text for text in recording.warnings if "was not completed" in text]
        assert "bag_1.mcap" in warning
        found = recording.samples
        lengths.append(len(found))
        np.testing.assert_array_equal(found.i_abc, every.i_abc[: len(found)])
        np.testing.assert_array_equal(found.stamp, every.stamp[: len(found)])
        assert not bag_info(copy).complete
    assert lengths == sorted(lengths)
    assert lengths[0] >= 4000
    assert lengths[-1] == 6000


@pytest.mark.parametrize("tail", [bytes(5000), b"\x06" + struct.pack("<Q", 10**15), bytes(1), bytes(1 << 21)])
def test_what_a_power_cut_leaves_behind_the_chunks(copy, tail):
    file = copy / "bag_1.mcap"
    cut(file, file.stat().st_size // 2, tail)
    recording = read_recording(copy)
    assert "was not completed" in recording.warnings[0]
    assert len(recording.samples) > 4500


def test_a_last_chunk_that_is_half_zeros(copy, live):
    """The size of the file had reached the disk, its content had not."""
    file = copy / "bag_1.mcap"
    data = file.read_bytes()
    ends = chunk_ends(data)
    file.write_bytes(data[: ends[5] - 3000] + bytes(3000))
    assert "checksum" in read_recording(copy).warnings[0] or "compression" in read_recording(copy).warnings[0]
    file.write_bytes(data[: ends[5] - 3000] + bytes(3000) + data[ends[5] : ends[6]])
    with pytest.raises(TruncatedBagError, match="drive-id recover"):  # damage with data behind it is no break
        read_recording(copy)
    recovery = recover_bag(copy)
    assert len(recovery.damage) == 2
    assert "is left out" in recovery.damage[0]
    assert 0 < len(stock_messages(recovery.output)) < len(stock_messages(live))


def chunk_ends(data: bytes) -> list[int]:
    position, ends = 8, []
    while data[position] != 0x0F:
        length = struct.unpack_from("<Q", data, position + 1)[0]
        if data[position] == 0x06:
            ends.append(position + 9 + length)
        position += 9 + length
    return ends


def test_damage_far_from_the_end_is_no_break(tmp_path):
    with Rosbag2McapWriter(tmp_path / "bag", live=True, compression="") as writer:
        writer.add_topic("/x", "a/msg/B")
        for number in range(60):
            writer.write("/x", bytes(100_000), number)
        writer.flush()
    file = tmp_path / "bag" / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[chunk_ends(bytes(data))[3] + 9 + 31] ^= 0xFF
    file.write_bytes(data[:-100])
    with pytest.raises(TruncatedBagError, match="drive-id recover"):
        read_recording(file)


@pytest.mark.parametrize("size", [0, 8, 30, 60])
def test_a_recorder_killed_at_once(copy, size):
    (copy / "bag_1.mcap").unlink()
    file = copy / "bag_0.mcap"
    cut(file, size)
    with pytest.raises(BagError, match=r"empty: record it again|has no topic|drive-id recover"):
        read_recording(copy)
    with pytest.raises(BagError):
        recover_bag(copy)
    assert [path.name for path in copy.parent.iterdir()] == ["bag"]


def test_a_whole_file_beside_one_that_is_empty_is_recovered(copy):
    cut(copy / "bag_1.mcap", 50)
    recovery = recover_bag(copy)
    assert [path.name for path in sorted(recovery.output.iterdir())] == ["bag_recovered_0.mcap", "metadata.yaml"]
    assert len(stock_messages(recovery.output)) == sum(recovery.topics.values()) >= 160


def test_others_of_ours_stay_errors(tmp_path):
    write_recording(tmp_path / "bag", make_samples(2000), start_stamp=SAMPLES_START)
    file = tmp_path / "bag" / "bag_0.mcap"
    cut(file, file.stat().st_size - 50)
    with pytest.raises(TruncatedBagError, match="recover it first with 'drive-id recover'"):
        read_recording(tmp_path / "bag")
    recovery = recover_bag(tmp_path / "bag", tmp_path / "new" / "whole")
    assert len(read_recording(recovery.output).samples) == 2000


# -- recovering ----------------------------------------------------------------------------------------------------


def test_recovered_recordings_are_whole(copy, live):
    before = digest(copy)
    file = copy / "bag_1.mcap"
    cut(file, file.stat().st_size * 2 // 3)
    cut_off = digest(copy)
    assert cut_off != before
    recovery = recover_bag(copy)
    assert digest(copy) == cut_off
    assert recovery.output == copy.parent / "bag_recovered"
    messages, every = stock_messages(recovery.output), stock_messages(live)
    assert set(messages) < set(every)
    assert len(messages) > 0.7 * len(every)
    assert bag_info(recovery.output).complete
    whole, rest = read_recording(recovery.output), read_recording(copy)
    assert whole.warnings == ()
    np.testing.assert_array_equal(whole.samples.u_abc, rest.samples.u_abc)
    information = metadata(recovery.output)
    topic = information["topics_with_message_count"][0]["topic_metadata"]
    original = metadata(live)
    assert topic == original["topics_with_message_count"][0]["topic_metadata"]


def test_the_index_alone_is_missing(copy):
    file = copy / "bag_1.mcap"
    cut(file, file.stat().st_size - 10)
    assert len(read_recording(copy).samples) == 6000
    assert sum(recover_bag(copy).topics.values()) == 240


def test_strangers_recordings(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = store.types["std_msgs/msg/String"]
    messages = [(10**18 + number, kind(data=f"{number} " + "x" * 2000)) for number in range(3000)]
    bag = write_foreign(tmp_path / "bag", store, {"/chatter": ("std_msgs/msg/String", messages)})
    file = next(bag.glob("*.mcap"))
    cut(file, file.stat().st_size * 3 // 4)
    recovery = recover_bag(bag)
    found = stock_messages(recovery.output)
    assert 500 < len(found) < 3000
    assert store.deserialize_cdr(found[7][2], "std_msgs/msg/String").data.startswith("7 ")
    bare = tmp_path / "bare.mcap"
    shutil.copy(file, bare)
    assert stock_messages(recover_bag(bare).output) == found
    sqlite = write_foreign(
        tmp_path / "s", store, {"/chatter": ("std_msgs/msg/String", messages[:3])}, storage=StoragePlugin.SQLITE3
    )
    with pytest.raises(NotABagError, match="is not an MCAP file"):
        recover_bag(sqlite)


def test_everything_in_a_file_is_kept(tmp_path):
    """Without chunks, with an attachment, metadata, a private record, and the quality of service of Humble."""
    file = tmp_path / "x.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, use_chunking=False, compression=CompressionType.NONE)
        writer.start("ros2", "someone")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema, {"offered_qos_profiles": QOS_OF_HUMBLE})
        for number in range(5):
            writer.add_message(channel, 1000 + number, b"\0\1\0\0\2\0\0\0a\0", 900 + number, 70 + number)
        writer.add_attachment(1, 2, "photo", "image/png", b"pixels")
        writer.add_metadata("notes", {"weather": "fine"})
        stream.write(b"\x90" + struct.pack("<Q", 3) + b"???" + b"\x05\x99")
    recovery = recover_bag(file)
    assert len(recovery.damage) == 1
    assert len(stock_messages(recovery.output)) == 5
    with (recovery.output / "x_recovered_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        message = next(message for _, _, message in reader.iter_messages())
        assert (message.sequence, message.publish_time) == (70, 900)
        assert [attachment.data for attachment in reader.iter_attachments()] == [b"pixels"]
        assert {"weather": "fine"} in [record.metadata for record in reader.iter_metadata()]
    information = metadata(recovery.output)
    assert information["version"] == 8
    assert "history: 3" in information["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"]


def test_what_follows_a_damaged_record_is_recovered(tmp_path):
    """A length within the record is damaged, its own length is not."""
    file = tmp_path / "x.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, use_chunking=False, compression=CompressionType.NONE, enable_data_crcs=True)
        writer.start("ros2", "someone")
        channel = writer.register_channel("/x", "cdr", writer.register_schema("a/msg/B", "ros2msg", b"uint8 a"))
        writer.add_message(channel, 1000, b"\0\1\0\0\1", 1000)
        writer.add_metadata("notes", {"weather": "fine"})
        for time in (2000, 3000):
            writer.add_message(channel, time, b"\0\1\0\0\2", time)
        writer.finish()
    data = bytearray(file.read_bytes())
    position = data.index(b"\x05\0\0\0notes")
    for length in (b"\xff\xff\xff\x7f", b"\x00\x01\0\0"):
        data[position : position + 4] = length
        file.write_bytes(data)
        recovery = recover_bag(file, tmp_path / f"whole_{length[0]}")
        (said,) = recovery.damage
        assert f"the record at byte {position - 9} is damaged; it is left out" in said
        assert [time for _, time, _ in stock_messages(recovery.output)] == [1000, 2000, 3000]


def test_outputs_that_are_there(copy):
    (copy.parent / "bag_recovered").mkdir()
    with pytest.raises(OutputError, match="exists already"):
        recover_bag(copy)
    with pytest.raises(OutputError, match="cannot be written"):
        recover_bag(copy, copy / "bag_0.mcap" / "below")
    with pytest.raises(NotABagError, match="There is no "):
        recover_bag(copy / "nowhere")


def test_the_command(copy):
    file = copy / "bag_1.mcap"
    cut(file, file.stat().st_size - 5)
    run = CliRunner().invoke(app, ["recover", str(copy)])
    assert run.exit_code == 0, run.output
    assert "240 messages" in run.output
    run = CliRunner().invoke(app, ["recover", str(copy), "--output", str(copy.parent / "x"), "--json"])
    assert json.loads(run.output)["topics"]["/resolver"] == 60
    run = CliRunner().invoke(app, ["recover", str(copy)])
    assert isinstance(run.exception, OutputError)
    empty = copy.parent / "empty.mcap"
    cut(file, 45)
    shutil.copy(file, empty)
    with pytest.raises(EmptyTopicError, match="no message"):
        recover_bag(empty)
