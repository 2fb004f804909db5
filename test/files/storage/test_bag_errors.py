"""Each kind of bad input has its own error: one sentence, with the place and what to do."""

from __future__ import annotations

import os
import shutil
import sqlite3
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_samples import PERIOD, START, STEP, make_samples, make_truth, write_foreign
from copied_bags import by_rosbags, with_messages
from drive_bags import TOPICS
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drive_id.errors import (
    BagError,
    DriveIdError,
    EmptyTopicError,
    MessageCountError,
    MessageTypeError,
    MissingTopicError,
    NonFiniteError,
    NotABagError,
    SamplePeriodError,
    TruncatedBagError,
)
from drive_id.files.messages.block_codec import encode_block
from drive_id.files.messages.messages import BLOCK_FIELDS, PHASE_CURRENTS
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read.info import bag_info
from drive_id.files.read.several import read_recording
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter
from drive_id.files.write.writer import write_recording

Change = Callable[[str, int, dict], dict | None]


def refused(path: Path, kind: type[DriveIdError], said: str, **options) -> None:
    """Expect one sentence of exactly this kind."""
    with pytest.raises(DriveIdError, match=said) as caught:
        read_recording(path, **options)
    assert type(caught.value) is kind
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith(".")


def blocks(path: Path, change: Change | None = None, count: int = 10) -> Path:
    """Write ``count`` blocks of 20 samples per topic, each as ``change`` makes it; None leaves one out."""
    with Rosbag2McapWriter(path) as writer:
        for topic, kind in TOPICS.items():
            writer.add_topic(topic, kind)
        for k in range(count):
            for topic, kind in TOPICS.items():
                values = [np.full(20, 0.1 * k, np.float32) for _ in BLOCK_FIELDS[kind]]
                block = {"stamp": START + 20 * k * STEP, "first": 20 * k, "period": PERIOD, "values": values}
                changed = change(topic, k, block) if change else block
                if changed is not None:
                    data = encode_block(*(changed[name] for name in ("stamp", "first", "period", "values")), "drive")
                    writer.write(topic, data, START + 20 * (k + 1) * STEP)
    return path


@pytest.fixture
def bag(tmp_path):
    write_recording(tmp_path / "bag", make_samples(), make_truth(), chunk_size=3000)
    return tmp_path / "bag"


# -- not a bag -----------------------------------------------------------------------------------------------------


def test_paths_that_are_no_bag(tmp_path):
    refused(tmp_path / "none", NotABagError, "none: check its name and folder")
    (tmp_path / "folder").mkdir()
    refused(tmp_path / "folder", NotABagError, "folder without an .mcap or .db3 file")
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / "identification.json").write_text("{}")
    refused(tmp_path / "result", NotABagError, "is a result folder, not a recording: see it by drive-id info or report")
    (tmp_path / "text.mcap").write_text("hello, this is no bag at all")
    refused(tmp_path / "text.mcap", NotABagError, "neither an MCAP nor a sqlite3 recording")
    (tmp_path / "empty.mcap").touch()
    refused(tmp_path / "empty.mcap", NotABagError, "is empty")
    (tmp_path / "one.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    refused(tmp_path / "one.bag", TruncatedBagError, "is no readable ROS 1 bag")
    sqlite3.connect(tmp_path / "other.db3").executescript("CREATE TABLE t(x); INSERT INTO t VALUES(1);").close()
    refused(tmp_path / "other.db3", NotABagError, "without the tables 'topics' and 'messages'")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    refused(tmp_path / "loop", NotABagError, "loop")
    (tmp_path / "a" / "x.mcap").mkdir(parents=True)
    refused(tmp_path / "a", NotABagError, "without an .mcap")


@pytest.mark.parametrize(("module", "call"), [(os, "open"), (Path, "iterdir")])
def test_unreadable_files(bag, monkeypatch, module, call):
    def denied(*_args: object, **_options: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(module, call, denied)
    refused(bag, NotABagError, "Permission denied")


def test_devices_are_no_bags():
    refused(Path("/dev/zero"), NotABagError, "is not a file")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "it has no rosbag2_bagfile_information"),
        ("{", "not YAML, see line 1"),
        ("- 1", "it has no rosbag2"),
        ("\x01", "damaged"),
        ("rosbag2_bagfile_information: 3", "is not of type dict"),
        ("rosbag2_bagfile_information: {version: 9}", "it has no relative_file_paths"),
        ("rosbag2_bagfile_information: {relative_file_paths: []}", "not a list of file names"),
        ("rosbag2_bagfile_information: {relative_file_paths: [3]}", "not a list of file names"),
        ("rosbag2_bagfile_information: {relative_file_paths: ['..']}", "has no topics_with_message_count"),
        ("[" * 5000, "damaged"),
    ],
)
def test_damaged_metadata(bag, text, said):
    (bag / "metadata.yaml").write_text(text)
    refused(bag, NotABagError, said)


def test_names_in_metadata_that_no_file_can_have(bag):
    edit(bag, lambda tree: tree.update(relative_file_paths=["x" * 300 + ".mcap"]))
    refused(bag, NotABagError, "which is not there")
    edit(bag, lambda tree: tree.update(relative_file_paths=["a\0b"]))
    refused(bag, NotABagError, "which is not there")
    edit(bag, lambda tree: tree.update(relative_file_paths=["x.mcap"] * 30_000))
    refused(bag, NotABagError, "it names 30000 files")


def test_type_names_of_old_metadata(bag):
    """As in bags of the first distributions: ``package/Name`` for ``package/msg/Name``."""

    def shorten(tree):
        for entry in tree["topics_with_message_count"]:
            entry["topic_metadata"]["type"] = entry["topic_metadata"]["type"].replace("/msg/", "/")

    edit(bag, shorten)
    assert len(read_recording(bag).samples) == len(make_samples())
    write_recording(bag.parent / "other", make_samples())
    target = by_rosbags(bag.parent / "other", bag.parent / "sqlite", StoragePlugin.SQLITE3)
    (file,) = target.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("UPDATE topics SET type = replace(type, '/msg/', '/')")
    database.close()
    assert len(read_recording(target).samples) == len(make_samples())


def edit(bag: Path, change: Callable[[dict], None]) -> None:
    tree = yaml.safe_load((bag / "metadata.yaml").read_text())
    change(tree["rosbag2_bagfile_information"])
    (bag / "metadata.yaml").write_text(yaml.safe_dump(tree))


def test_metadata_that_do_not_fit_the_files(bag):
    def count(tree):
        tree["topics_with_message_count"][0]["message_count"] += 1

    edit(bag, count)
    refused(bag, MessageCountError, "declares 7 messages on /phase_currents but its files hold 6")
    assert not bag_info(bag).complete
    edit(bag, lambda tree: tree["topics_with_message_count"][0]["topic_metadata"].update(type="a/msg/B"))
    refused(bag, MessageTypeError, "gives /phase_currents the type a/msg/B")
    edit(bag, lambda tree: tree.update(relative_file_paths=["../bag_1.mcap"]))
    refused(bag, NotABagError, "names bag_1.mcap, which is not there")
    shutil.copy(bag / "bag_0.mcap", bag / "bag_1.mcap")
    refused(bag, NotABagError, "holds bag_0.mcap, which its metadata.yaml does not name")


def test_other_qos_in_the_metadata_loses_nothing(bag):
    edit(
        bag,
        lambda tree: [t["topic_metadata"].update(offered_qos_profiles=[]) for t in tree["topics_with_message_count"]],
    )
    assert len(read_recording(bag).samples) == 600


# -- truncated and damaged -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.999])
def test_truncated_bags(bag, part):
    file = bag / "bag_0.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * part)])
    refused(bag, TruncatedBagError, "breaks off before its end: recover it first with 'drive-id recover'")
    info = bag_info(file)
    assert not info.complete
    assert "breaks off" in info.problem
    assert info.messages <= 24
    assert part < 0.5 or info.messages > 0


def test_a_recorder_that_was_killed(tmp_path):
    writer = Rosbag2McapWriter(tmp_path / "killed")
    writer.add_topic("/phase_currents", PHASE_CURRENTS)
    writer.write("/phase_currents", encode_block(START, 0, PERIOD, [np.ones(9, np.float32)] * 3, "drive"), START)
    writer.flush()
    writer.abandon()
    refused(tmp_path / "killed", TruncatedBagError, "drive-id recover")
    assert bag_info(tmp_path / "killed").messages == 1


def test_a_disk_that_shows_endless_zeros_is_read_in_no_time(tmp_path):
    """The size of the file was stored before the crash, its content was not."""
    write_recording(tmp_path / "bag", make_samples())
    file = tmp_path / "bag" / "bag_0.mcap"
    size = file.stat().st_size
    with file.open("r+b") as stream:
        stream.truncate(size // 2)
        stream.truncate(1 << 36)
    refused(file, TruncatedBagError, "breaks off before its end")
    before = time.process_time()
    assert "breaks off" in bag_info(file).problem
    assert time.process_time() - before < 5.0


def test_truncated_sqlite(tmp_path, bag):
    file = by_rosbags(bag, tmp_path / "copy", StoragePlugin.SQLITE3) / "copy.db3"
    data = file.read_bytes()
    for part in (0.02, 0.3, 0.7, 0.98):
        file.write_bytes(data[: int(len(data) * part)])
        refused(file, TruncatedBagError, r"recover it first, for instance with 'sqlite3 copy.db3 .recover'")
    file.write_bytes(data)
    Path(f"{file}-wal").write_bytes(b"x")
    refused(file, TruncatedBagError, "was not closed")


def test_damaged_compression(tmp_path):
    for name, magic in (("x.mcap.zstd", b"\x28\xb5\x2f\xfd"), ("x.db3.lz4", b"\x04\x22\x4d\x18")):
        (tmp_path / name).write_bytes(magic + b"\xff" * 50)
        refused(tmp_path / name, TruncatedBagError, f"compression of .*{name} is damaged")


def test_messages_that_vanish_from_sqlite(tmp_path, bag):
    folder = by_rosbags(bag, tmp_path / "copy", StoragePlugin.SQLITE3)
    database = sqlite3.connect(folder / "copy.db3")
    database.execute("DELETE FROM messages WHERE id = 9")
    database.commit()
    database.close()
    refused(folder, MessageCountError, "metadata.yaml of .* declares 6 messages")


def test_damaged_truth(tmp_path):
    blocks(tmp_path / "good")
    with_messages(tmp_path / "good", tmp_path / "bad", list, truth=b"PK no archive")
    refused(tmp_path / "bad", BagError, "ground truth attached to .* cannot be read")


# -- topics --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("missing", list(TOPICS))
def test_missing_topic(tmp_path, missing):
    with Rosbag2McapWriter(tmp_path / "bag") as writer:
        for topic, kind in TOPICS.items():
            if topic != missing:
                writer.add_topic(topic, kind)
    has = ", ".join(sorted(set(TOPICS) - {missing}))
    refused(tmp_path / "bag", MissingTopicError, rf"has no topic .*{missing[1:]} for the .* \(it has {has}\)")


def test_no_topic_at_all(tmp_path):
    Rosbag2McapWriter(tmp_path / "bag").close()
    refused(tmp_path / "bag", MissingTopicError, "it has none at all")


@pytest.mark.parametrize("empty", list(TOPICS))
def test_empty_topic(tmp_path, empty):
    blocks(tmp_path / "none", lambda topic, _, block: None if topic == empty else block)
    refused(tmp_path / "none", EmptyTopicError, f"{empty} in .* holds no sample")

    def hollow(topic, _, block):
        return {**block, "values": [v[:0] for v in block["values"]]} if topic == empty else block

    blocks(tmp_path / "hollow", hollow)
    refused(tmp_path / "hollow", EmptyTopicError, f"{empty} in .* holds no sample")


def test_wrong_type(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    joint, header = store.types["sensor_msgs/msg/JointState"], store.types["std_msgs/msg/Header"]
    time = store.types["builtin_interfaces/msg/Time"]
    message = joint(header(time(1, 0), ""), [], np.zeros(3), np.zeros(0), np.zeros(0))
    topics = {name: ("sensor_msgs/msg/JointState", [(START, message)]) for name in TOPICS}
    write_foreign(tmp_path / "bag", store, topics)
    said = "cannot be read as sensor_msgs/msg/JointState .*asks for the field 'a', but it has header, name, position"
    refused(tmp_path / "bag", MessageTypeError, said)


@pytest.mark.parametrize(
    ("encoding", "said"),
    [("protobuf", "is encoded as 'protobuf', not as CDR, ROS 1 or JSON"), ("json", "there are no fields there")],
)
def test_a_topic_that_is_not_ros(tmp_path, encoding, said):
    with (tmp_path / "x.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("")
        for name in TOPICS:
            schema = writer.register_schema("drive", "jsonschema", b"{}")
            channel = writer.register_channel(name, encoding, schema)
            writer.add_message(channel, START, b"{}", START)
        writer.finish()
    refused(tmp_path / "x.mcap", MessageTypeError, said)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a/msg/B:\n    pass\nimport os\nclass C", "float32 a"),
        ("drive_id_msgs/msg/PhaseCurrents", "this is no definition"),
        ("drive_id_msgs/msg/PhaseCurrents", "other_msgs/Thing a"),
        ("drive_id_msgs/msg/PhaseCurrents", "\0\0\0"),
        ("unknown_msgs/msg/Thing", ""),
        ("", ""),
    ],
)
def test_definitions_that_make_no_sense(tmp_path, name, text):
    with Rosbag2McapWriter(tmp_path / "bag") as writer:
        for topic in TOPICS:
            writer.add_topic(topic, name, definition=text, hash_="x")
            writer.write(topic, b"\0\1\0\0" + bytes(60), START)
    refused(
        tmp_path / "bag", MessageTypeError, "not a message type|cannot be understood|holds no definition|cannot be read"
    )


def test_another_version_of_our_messages_is_read_by_its_names_or_refused(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("std_msgs/Header header\nfloat32[] a\nfloat32[] b\n", PHASE_CURRENTS))
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    ones = np.ones(3, np.float32)
    message = store.types[PHASE_CURRENTS](header(time(1, 0), ""), ones, ones)
    write_foreign(tmp_path / "bag", store, {name: (PHASE_CURRENTS, [(START, message)]) for name in TOPICS})
    refused(tmp_path / "bag", MessageTypeError, "asks for the field '(c|angle)', but it has header, a, b")


def test_garbage_in_a_message(tmp_path):
    blocks(tmp_path / "good")

    def cut(messages):
        return [(k, topic, data if k != 10 else data[:50], time) for k, topic, data, time in messages]

    with_messages(tmp_path / "good", tmp_path / "bad", cut)
    refused(
        tmp_path / "bad",
        MessageTypeError,
        rf"logged at {START + 80 * STEP} ns, cannot be read as .*(ends too early|more than it holds)",
    )


# -- samples -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("topic", list(TOPICS))
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_samples_that_are_not_finite(tmp_path, topic, value):
    def spoil(name, k, block):
        if name == topic and k == 5:
            block["values"][1][3] = value
        return block

    blocks(tmp_path / "bag", spoil)
    refused(tmp_path / "bag", NonFiniteError, rf"In .*bag: {topic} holds 1 sample of NaN or infinity, .* 0\.0103")


@pytest.mark.parametrize("topic", list(TOPICS))
def test_periods_that_disagree(tmp_path, topic):
    blocks(tmp_path / "two", lambda name, k, block: {**block, "period": 2e-4} if name == topic and k > 3 else block)
    refused(tmp_path / "two", SamplePeriodError, f"sample period of {topic} changes from 0.0001 to 0.0002 s")
    blocks(tmp_path / "nil", lambda name, _, block: {**block, "period": 0.0} if name == topic else block)
    refused(tmp_path / "nil", SamplePeriodError, f"A message on {topic} .* declares a sample period of 0.0 s")


def test_unequal_arrays(tmp_path):
    def shorten(_, k, block):
        return {**block, "values": [block["values"][0][:-1], *block["values"][1:]]} if k == 2 else block

    blocks(tmp_path / "bag", shorten)
    refused(tmp_path / "bag", MessageTypeError, "arrays have different lengths, 19 and 20")


def test_a_stranger_without_header(tmp_path):
    blocks(tmp_path / "bag")
    text = "".join(f"{section}: {{topic: /i, fields: [a, b, c]}}\n" for section in ("currents", "voltages"))
    text += "resolver: {topic: /i, angle: a}\n"
    refused(tmp_path / "bag", MissingTopicError, "has no topic /i for the currents", signals=parse_signals(text, "f"))
    text = text.replace("/i", "/phase_currents").replace("angle: a", "angle: a, stamp: first_sample, stamp_unit: s")
    refused(tmp_path / "bag", SamplePeriodError, "give their sample_period", signals=parse_signals(text, "f"))
