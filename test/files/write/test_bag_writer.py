"""What we write, other readers open: rosbags and mcap list every message with its values."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_samples import START, STEP, assert_equal_samples, make_samples, make_truth
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drive_id.errors import ConfigurationError, OutputError
from drive_id.files.messages.block_codec import decode_block, encode_block
from drive_id.files.messages.message_reader import block_columns
from drive_id.files.messages.message_types import typestore_for
from drive_id.files.messages.messages import BLOCK_FIELDS, CURRENT_REFERENCE, DEFINITIONS, schema_text
from drive_id.files.messages.signal_sources import SignalMap
from drive_id.files.read.several import read_recording
from drive_id.files.storage.bag import open_bag
from drive_id.files.storage.container import TopicInfo
from drive_id.files.storage.metadata import Qos
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter
from drive_id.files.write.writer import write_recording

MSG_DEFS = Path(__file__).parents[3] / "msg_defs" / "msg"
NAMES = {"/phase_currents": "i_abc", "/phase_voltages": "u_abc", "/current_reference": "i_dq_reference"}


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
@pytest.mark.parametrize("block_size", [1, 7, 100, 10_000])
def test_rosbags_lists_every_message_with_its_values(tmp_path, compression, block_size):
    samples = make_samples(gap_at=250)
    write_recording(tmp_path / "bag", samples, compression=compression, block_size=block_size, chunk_size=5000)
    collected: dict[str, list[np.ndarray]] = {}
    with AnyReader([tmp_path / "bag"]) as reader:
        declared = {connection.topic: connection.msgcount for connection in reader.connections}
        counted = dict.fromkeys(declared, 0)
        for connection, _, raw in reader.messages():
            counted[connection.topic] += 1
            message = reader.deserialize(raw, connection.msgtype)
            columns = [getattr(message, name) for name in BLOCK_FIELDS[connection.msgtype]]
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            assert stamp == samples.stamp[message.first_sample]
            last = message.first_sample + len(columns[0]) - 1
            assert samples.stamp[last] - stamp == (len(columns[0]) - 1) * STEP, "a block spans the gap"
            collected.setdefault(connection.topic, []).append(np.column_stack(columns))
    assert counted == declared
    assert set(counted) == {*NAMES, "/resolver"}
    for topic, name in NAMES.items():
        np.testing.assert_array_equal(np.concatenate(collected[topic]), getattr(samples, name))
    np.testing.assert_array_equal(np.concatenate(collected["/resolver"])[:, 0], samples.angle)


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_mcap_lists_every_message_and_the_truth(tmp_path, compression):
    write_recording(tmp_path / "bag", make_samples(), make_truth(), compression=compression)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        assert header.profile == "ros2"
        assert sum(1 for _ in reader.iter_messages()) == summary.statistics.message_count == 24
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        for channel in summary.channels.values():
            assert channel.message_encoding == "cdr"
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
            assert yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]["reliability"] == "reliable"
        (attachment,) = reader.iter_attachments()
        assert attachment.name == "ground_truth.npz"
        with np.load(io.BytesIO(attachment.data)) as truth:
            np.testing.assert_array_equal(truth["psi_d"], make_truth().psi_d)
        (metadata,) = reader.iter_metadata()
        assert metadata.name == "rosbag2"
        inner = yaml.safe_load(metadata.metadata["serialized_metadata"])
    outer = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert inner == outer
    assert outer["version"] == 9
    assert outer["message_count"] == 24
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        assert sum(1 for _ in NonSeekingReader(stream, validate_crcs=True).iter_messages()) == 24


def test_the_truth_is_in_no_topic_and_comes_back(tmp_path):
    truth = make_truth()
    write_recording(tmp_path / "bag", make_samples(), truth)
    with Reader(tmp_path / "bag") as reader:
        assert sorted(reader.topics) == ["/current_reference", "/phase_currents", "/phase_voltages", "/resolver"]
    found = read_recording(tmp_path / "bag").truth
    assert found is not None
    for name in ("i_d", "i_q", "psi_d", "psi_q", "inverter_current", "inverter_voltage"):
        np.testing.assert_array_equal(getattr(found, name), getattr(truth, name))
    scalars = ("machine", "resistance", "i_max", "pole_pairs", "details")
    assert [getattr(found, name) for name in scalars] == [getattr(truth, name) for name in scalars]


def test_the_same_samples_give_the_same_bytes(tmp_path):
    for folder in ("one", "two"):
        write_recording(tmp_path / folder / "bag", make_samples(), make_truth())
    for name in ("bag_0.mcap", "metadata.yaml"):
        assert (tmp_path / "one/bag" / name).read_bytes() == (tmp_path / "two/bag" / name).read_bytes()


def test_messages_are_logged_in_order_and_not_before_their_last_sample(tmp_path):
    samples = make_samples(reference=False)
    write_recording(tmp_path / "bag", samples)
    with Reader(tmp_path / "bag") as reader:
        times = [time for _, time, _ in reader.messages()]
    assert times == sorted(times)
    assert times[-1] == samples.stamp[-1] + STEP


def test_start_stamp(tmp_path):
    samples = make_samples()
    link = np.linspace(400.0, 410.0, len(samples)).astype(np.float32).astype(float)
    samples = replace(samples, dc_link_voltage=link)
    write_recording(tmp_path / "bag", samples, start_stamp=5 * 10**9)
    found = read_recording(tmp_path / "bag").samples
    assert_equal_samples(found, replace(samples, stamp=samples.stamp - START + 5 * 10**9))
    np.testing.assert_allclose(found.dc_link_voltage, link, rtol=1e-6)


def test_unknown_references_are_left_out(tmp_path):
    samples = make_samples()
    reference = samples.i_dq_reference.copy()
    reference[:100] = np.nan
    reference[300:310] = np.nan
    write_recording(tmp_path / "bag", replace(samples, i_dq_reference=reference))
    np.testing.assert_array_equal(read_recording(tmp_path / "bag").samples.i_dq_reference[1:100], np.nan)
    found = read_recording(tmp_path / "bag").samples.i_dq_reference
    np.testing.assert_array_equal(found[100:300], reference[100:300])
    np.testing.assert_array_equal(found[310:], reference[310:])


def test_angles_stay_within_the_contract(tmp_path):
    samples = make_samples()
    angle = np.linspace(-30, 30, len(samples))
    angle[:3] = [np.pi, -np.pi, 3 * np.pi]
    write_recording(tmp_path / "bag", replace(samples, angle=angle))
    found = read_recording(tmp_path / "bag").samples.angle
    assert found.min() >= -np.pi
    assert found.max() < np.pi
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * angle), atol=5e-7)


def test_an_existing_path_is_refused_and_kept(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").write_text("x")
    with pytest.raises(OutputError, match="exists already"):
        write_recording(tmp_path / "bag", make_samples())
    assert [entry.name for entry in tmp_path.iterdir()] == ["bag"]
    assert (tmp_path / "bag" / "precious").read_text() == "x"


def test_nothing_is_left_of_a_recording_that_fails(tmp_path, monkeypatch):
    def full(*_args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mcap.writer.Writer.finish", full)
    with pytest.raises(OutputError, match="No space left on device"):
        write_recording(tmp_path / "bag", make_samples())
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_way_is_an_output_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="cannot be written"):
        write_recording(tmp_path / "file" / "bag", make_samples())


@pytest.mark.parametrize("stamp", [-5, 2**31 * 10**9])
def test_stamps_that_no_message_can_hold(tmp_path, stamp):
    with pytest.raises(ConfigurationError, match="start_stamp"):
        write_recording(tmp_path / "bag", make_samples(), start_stamp=stamp)


def test_block_size_must_be_positive(tmp_path):
    with pytest.raises(ConfigurationError, match="block_size is 0"):
        write_recording(tmp_path / "bag", make_samples(), block_size=0)


def test_the_raw_writer_serves_any_type_and_flushes(tmp_path):
    definition, kind = "float64 data\n", "std_msgs/msg/Float64"
    hash_ = get_typestore(Stores.ROS2_JAZZY).hash_rihs01(kind)
    with Rosbag2McapWriter(tmp_path / "bag", chunk_size=1000) as writer:
        writer.add_topic("/x", kind, qos=Qos(10, "best_effort"), definition=definition, hash_=hash_)
        for k in range(10):
            writer.write("/x", b"\0\1\0\0" + np.float64(k).tobytes(), 1000 + k)
        writer.flush()
        assert (tmp_path / "bag" / "bag_0.mcap").stat().st_size > 300
        with pytest.raises(OutputError, match="recorded already"):
            writer.add_topic("/x", kind, definition=definition)
    with AnyReader([tmp_path / "bag"]) as reader:
        values = [reader.deserialize(raw, connection.msgtype).data for connection, _, raw in reader.messages()]
    assert values == list(range(10))
    with pytest.raises(OutputError, match="exists already"):
        Rosbag2McapWriter(tmp_path / "bag")


def test_an_empty_recording_is_a_recording(tmp_path):
    with Rosbag2McapWriter(tmp_path / "bag") as writer:
        writer.add_topic("/phase_currents", "drive_id_msgs/msg/PhaseCurrents")
    with Reader(tmp_path / "bag") as reader:
        assert list(reader.messages()) == []
        assert reader.message_count == 0


def test_bags_with_the_former_message_of_references_are_read_likewise(tmp_path):
    """It had neither session nor what follows; such bags take the same fast way."""
    samples = make_samples()
    write_recording(tmp_path / "new", samples)
    former = schema_text(CURRENT_REFERENCE).replace("uint64 session\nuint64 count\nbool safe\nbool stator_frame\n", "")
    assert "session" not in former
    with Reader(tmp_path / "new") as reader, Rosbag2McapWriter(tmp_path / "old") as writer:
        for connection in reader.connections:
            known = {"definition": former, "hash_": "RIHS01_x"} if connection.msgtype == CURRENT_REFERENCE else {}
            writer.add_topic(connection.topic, connection.msgtype, **known)
        for connection, time, data in reader.messages():
            (head, values), whole = decode_block(data, len(BLOCK_FIELDS[connection.msgtype])), bytes(data)
            again = encode_block(head.stamp, head.first_sample, head.sample_period, values, "drive")
            assert whole.startswith(again)
            assert len(whole) - len(again) in ({18, 22} if connection.msgtype == CURRENT_REFERENCE else {0})
            writer.write(connection.topic, again, time)
    kept = read_recording(tmp_path / "old").samples
    np.testing.assert_array_equal(kept.i_dq_reference, read_recording(tmp_path / "new").samples.i_dq_reference)
    given = TopicInfo("/current_reference", CURRENT_REFERENCE, 1, "cdr", "ros2msg", former)
    signals = SignalMap()
    assert block_columns(given, signals.reference, signals) == [0, 1]


@pytest.mark.parametrize(
    ("name", "appended", "hash_"),
    [
        ("FluxMap", "\n# Serial number", "1c078f8b56d03decb4f3cf89f9807fbb98609752603867888b4824abf6b587ae"),
        ("FitReport", "\n# Stamp and folder", "d8e82c9a5a0471fd54e0152edf593ed5fa7cf74418eadaadb428e110a5e30f6f"),
    ],
)
def test_bags_with_former_maps_and_reports_are_read(tmp_path, name, appended, hash_):
    """Fields were appended since: the bag's own definition, whose hash was the former one, tells which there are."""
    kind = f"drive_id_msgs/msg/{name}"
    definition = (MSG_DEFS / f"{name}.msg").read_text(encoding="utf-8")
    dependencies = schema_text(CURRENT_REFERENCE)[len(DEFINITIONS[CURRENT_REFERENCE]) :]
    former = definition.partition(appended)[0] + dependencies
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(former, kind))
    assert store.hash_rihs01(kind) == f"RIHS01_{hash_}"
    samples = make_samples()
    write_recording(tmp_path / "new", samples)
    given = {"coverage": 0.75, "warnings": ["Of before.", "Too."], "warning_codes": ["standstill", "gaps"]}
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](7, 8), "drive")
    blank = {"float64[]": np.zeros(0), "uint32[]": np.zeros(0, np.uint32), "bool[]": np.zeros(0, bool), "string[]": []}
    plain = {"string": "", "float64": 0.5, "bool": True}
    fields = [line.split()[:2] for line in former.partition("=" * 80)[0].splitlines() if line and line[0] != "#"]
    values = {
        field: header if type_ == "std_msgs/Header" else {**blank, **plain}.get(type_, 3)
        for type_, field in fields if "=" not in field
    }  # fmt: skip
    data = bytes(store.serialize_cdr(store.types[kind](**values | given), kind))
    with Reader(tmp_path / "new") as reader, Rosbag2McapWriter(tmp_path / "old") as writer:
        for connection in reader.connections:
            writer.add_topic(connection.topic, connection.msgtype)
        writer.add_topic("/told", kind, definition=former, hash_=f"RIHS01_{hash_}")
        for connection, time, raw in reader.messages():
            writer.write(connection.topic, bytes(raw), time)
        writer.write("/told", data, time)
    assert_equal_samples(read_recording(tmp_path / "old").samples, read_recording(tmp_path / "new").samples)
    with open_bag(tmp_path / "old") as bag:
        (message,) = bag.messages(["/told"])
        found = typestore_for(bag.topics["/told"], SignalMap()).deserialize_cdr(message.data, kind)
    assert {field: getattr(found, field) for field in given} == given
    assert not hasattr(found, "folder")
    with AnyReader([tmp_path / "old"]) as reader:
        (told,) = (connection for connection in reader.connections if connection.topic == "/told")
        ((connection, _, raw),) = reader.messages([told])
        assert reader.deserialize(raw, connection.msgtype).warnings == given["warnings"]
