"""Reading: every storage, compression and layout gives the same samples; strangers' bags through a signals file."""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
from dataclasses import replace

import lz4.frame
import numpy as np
import pytest
import zstandard
from bag_samples import PERIOD, START, STEP, assert_equal_samples, make_samples, make_truth, write_foreign
from copied_bags import by_rosbags, with_messages
from drive_bags import renamed
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drive_id.errors import ConfigurationError, MissingTopicError, SamplePeriodError
from drive_id.files.messages.field_path import parse_field_path
from drive_id.files.messages.message_reader import _time
from drive_id.files.messages.messages import message_typestore, schema_text
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read.info import bag_info
from drive_id.files.read.several import read_recording
from drive_id.files.write.writer import write_recording


@pytest.fixture
def ours(tmp_path):
    samples = make_samples(gap_at=250)
    write_recording(tmp_path / "bag", samples, make_truth(), chunk_size=3000)
    return tmp_path / "bag", samples


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_our_own_bags(tmp_path, compression):
    samples = make_samples(gap_at=250)
    write_recording(tmp_path / "bag", samples, make_truth(), compression=compression)
    recording = read_recording(tmp_path / "bag")
    assert_equal_samples(recording.samples, samples)
    np.testing.assert_array_equal(recording.samples.i_dq_reference, samples.i_dq_reference)
    file = tmp_path / "bag" / "bag_0.mcap"
    assert recording.digests == {str(file): hashlib.sha256(file.read_bytes()).hexdigest()}
    assert bag_info(tmp_path / "bag").compression == compression


KINDS = [(storage, mode) for storage in StoragePlugin for mode in CompressionMode]
KINDS.remove((StoragePlugin.SQLITE3, CompressionMode.STORAGE))


@pytest.mark.parametrize(("storage", "mode"), KINDS)
@pytest.mark.parametrize("version", [8, 9])
def test_bags_of_rosbags(tmp_path, ours, storage, mode, version):
    path, samples = ours
    copy = by_rosbags(path, tmp_path / "copy", storage, mode, version)
    assert_equal_samples(read_recording(copy).samples, samples)
    info = bag_info(copy)
    assert (info.storage, info.messages, info.complete) == (storage.name.lower(), 28, True)
    kinds = {CompressionMode.FILE: "zstd (file)", CompressionMode.MESSAGE: "zstd (message)"}
    assert info.compression == kinds.get(mode, "zstd" if mode is CompressionMode.STORAGE else "")
    (copy / "metadata.yaml").unlink()
    assert_equal_samples(read_recording(copy).samples, samples)
    (file,) = copy.iterdir()
    assert_equal_samples(read_recording(file).samples, samples)


@pytest.mark.parametrize("suffix", ["zstd", "lz4"])
def test_files_compressed_as_a_whole(tmp_path, ours, suffix):
    path, samples = ours
    data = (path / "bag_0.mcap").read_bytes()
    packed = zstandard.compress(data) if suffix == "zstd" else lz4.frame.compress(data)
    file = tmp_path / f"alone.mcap.{suffix}"
    file.write_bytes(packed)
    assert_equal_samples(read_recording(file).samples, samples)
    assert bag_info(file).compression == f"zstd+{suffix} (file)"


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("index", [IndexType.NONE, IndexType.ALL])
@pytest.mark.parametrize("statistics", [True, False])
def test_mcap_files_of_other_writers(tmp_path, ours, chunked, index, statistics):
    path, samples = ours
    target = tmp_path / "other.mcap"
    with AnyReader([path]) as reader, target.open("wb") as stream:
        writer = McapWriter(
            stream, 4000, CompressionType.LZ4, index, statistics, statistics, chunked, statistics, statistics
        )
        writer.start("ros2")
        channels = {}
        for topic, info in reader.topics.items():
            schema = writer.register_schema(info.msgtype, "ros2msg", schema_text(info.msgtype).encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for connection, time, raw in reader.messages():
            writer.add_message(channels[connection.topic], time, raw, time)
        writer.finish()
    assert_equal_samples(read_recording(target).samples, samples)
    assert bag_info(target).messages == 28


def test_names_of_files_may_hold_anything(tmp_path, ours):
    path, samples = ours
    odd = tmp_path / "a b%20?#ü"
    copy = by_rosbags(path, tmp_path / "copy", StoragePlugin.SQLITE3)
    odd.mkdir()
    shutil.move(copy / "copy.db3", odd / "100% ?#ü.db3")
    assert_equal_samples(read_recording(odd).samples, samples)


def test_old_sqlite_bags_without_definitions(tmp_path, ours):
    path, samples = ours
    copy = by_rosbags(path, tmp_path / "copy", StoragePlugin.SQLITE3)
    database = sqlite3.connect(copy / "copy.db3")
    database.execute("DROP TABLE message_definitions")
    database.execute("DROP TABLE schema")
    database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    database.commit()
    database.close()
    assert_equal_samples(read_recording(copy).samples, samples)


# -- several bags, several drives ----------------------------------------------------------------------------------


def test_several_bags_are_several_runs(tmp_path):
    first, second = make_samples(300, seed=1), make_samples(200, seed=2)
    write_recording(tmp_path / "one", first, make_truth())
    write_recording(tmp_path / "two", second, make_truth())
    recording = read_recording([tmp_path / "one", tmp_path / "two"])
    assert recording.samples.run_starts.tolist() == [0, 300]
    np.testing.assert_array_equal(recording.samples.i_abc, np.concatenate((first.i_abc, second.i_abc)))
    assert recording.truth is not None
    assert len(recording.digests) == 2
    assert any("overlaps in time" in text for text in recording.warnings)
    with pytest.raises(ConfigurationError, match="the same recording"):
        read_recording([tmp_path / "one", tmp_path / "one" / "one_0.mcap"])
    with pytest.raises(ConfigurationError, match="name at least one"):
        read_recording([])


def test_bags_of_different_rates_are_not_mixed(tmp_path):
    first = make_samples(300)
    slow = replace(first, sample_period=2 * PERIOD, stamp=START + 2 * STEP * np.arange(300))
    write_recording(tmp_path / "one", first)
    write_recording(tmp_path / "two", slow)
    with pytest.raises(SamplePeriodError, match="100 us in the first and 200 us in number 2"):
        read_recording([tmp_path / "one", tmp_path / "two"])


def two_drives(tmp_path, resolver="resolver"):
    store = message_typestore()
    target = tmp_path / "both"
    writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
    samples = {"drive_1": make_samples(300, seed=1), "drive_2": make_samples(300, seed=2)}
    with writer:
        for name, part in samples.items():
            write_recording(tmp_path / f"{name}_alone", part)
            own = "resolver" if name == "drive_1" else resolver
            with AnyReader([renamed(tmp_path / f"{name}_alone", tmp_path / name, name, resolver=own)]) as reader:
                keys = {t: writer.add_connection(t, i.msgtype, typestore=store) for t, i in reader.topics.items()}
                for connection, time, raw in reader.messages():
                    writer.write(keys[connection.topic], time, raw)
    return target, samples


def test_two_drives_need_a_namespace(tmp_path):
    target, samples = two_drives(tmp_path)
    with pytest.raises(ConfigurationError, match=r"\(/drive_1, /drive_2\): choose one with the option namespace"):
        read_recording(target)
    for name, part in samples.items():
        assert_equal_samples(read_recording(target, namespace=name).samples, part)
    with pytest.raises(MissingTopicError, match="/drive_3/phase_currents"):
        read_recording(target, namespace="/drive_3/")


def test_the_only_whole_drive_is_taken(tmp_path):
    target, samples = two_drives(tmp_path, resolver="encoder")
    assert_equal_samples(read_recording(target).samples, samples["drive_1"])


# -- strangers -----------------------------------------------------------------------------------------------------

STATUS = """\
std_msgs/Header header
uint64 counter
float64 time
inverter_msgs/Phase[3] phase
float64[] samples
================================================================================
MSG: inverter_msgs/Phase
float32 current
float32 from
"""
STRANGER = """
currents:
  topic: /inverter/status
  fields: ["phase[0].current", "phase[1].current"]
  scale: [0.001, -0.001]
  first_sample: counter
voltages:
  topic: /inverter/status
  fields: ["phase[0].from", "phase[1].from", "phase[2].from"]
  scale: 560.0
resolver:
  topic: /joint_states
  angle: position[0]
  angle_offset: 0.25
  mechanical: true
  pole_pairs: 4
"""
SPEED = "  speed: velocity[0]\n  speed_unit: rpm\n"


def stranger(tmp_path, storage=StoragePlugin.MCAP, n=400):
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(STATUS, "inverter_msgs/msg/Status"))
    kinds = store.types
    time, header = kinds["builtin_interfaces/msg/Time"], kinds["std_msgs/msg/Header"]
    status, phase = kinds["inverter_msgs/msg/Status"], kinds["inverter_msgs/msg/Phase"]
    joint = kinds["sensor_msgs/msg/JointState"]
    rng = np.random.default_rng(3)
    i_abc = rng.normal(0, 5000, (n, 3)).astype(np.float32)
    duty = rng.uniform(-0.5, 0.5, (n, 3)).astype(np.float32)
    shaft = 0.003 * np.arange(n)
    statuses, joints = [], []
    for k in range(n):
        stamp = START + k * STEP
        head = header(time(*divmod(stamp, 10**9)), "inverter")
        phases = [phase(float(i_abc[k, p]), float(duty[k, p])) for p in range(3)]
        block = np.arange(6 * k, 6 * k + 6, dtype=float)
        statuses.append((stamp + 50_000, status(head, k, (stamp - START) * 1e-9, phases, block)))
        wrapped = np.array([(shaft[k] + np.pi) % (2 * np.pi) - np.pi])
        joints.append((stamp + 60_000, joint(head, ["shaft"], wrapped, np.array([1500.0]), np.array([0.0]))))
    topics = {
        "/inverter/status": ("inverter_msgs/msg/Status", statuses),
        "/joint_states": ("sensor_msgs/msg/JointState", joints),
    }
    path = write_foreign(tmp_path / "stranger", store, topics, storage=storage)
    return path, i_abc.astype(float), duty.astype(float), shaft


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("with_speed", [True, False])
def test_a_strangers_bag(tmp_path, storage, with_speed):
    path, i_abc, duty, shaft = stranger(tmp_path, storage)
    samples = read_recording(path, parse_signals(STRANGER + SPEED * with_speed, "test")).samples
    a, b = 0.001 * i_abc[:, 0], -0.001 * i_abc[:, 1]
    np.testing.assert_allclose(samples.i_abc, np.column_stack((a, b, -a - b)), rtol=1e-12)
    np.testing.assert_allclose(samples.u_abc, 560 * duty, rtol=1e-12)
    np.testing.assert_allclose(np.exp(1j * samples.angle), np.exp(1j * (4 * shaft + 0.25)), atol=1e-9)
    expected = 1500 / 60 * 2 * np.pi * 4 if with_speed else 0.003 * 4 / PERIOD
    np.testing.assert_allclose(samples.speed, expected, rtol=1e-9)
    np.testing.assert_array_equal(samples.stamp, START + STEP * np.arange(400))
    assert samples.sample_period == pytest.approx(PERIOD, rel=1e-9)


@pytest.mark.parametrize(
    ("stamp", "start"),
    [
        ("stamp: log_time", START + 50_000),
        ("stamp: time\n  stamp_unit: s", 0),
        ("stamp_offset: 0.002", START + 2_000_000),
    ],
)
def test_sources_of_time(tmp_path, stamp, start):
    path, *_ = stranger(tmp_path)
    text = STRANGER.replace("topic: /inverter/status", f"topic: /inverter/status\n  {stamp}")
    other = "stamp: log_time" if "log" in stamp else stamp if "offset" in stamp else ""
    resolver = "  topic: /joint_states\n" + (f"  {other}\n" if other else f"  stamp_offset: {-START * 1e-9!r}\n")
    text = text.replace("  topic: /joint_states\n", resolver)
    recording = read_recording(path, parse_signals(text, "test"))
    assert abs(recording.samples.stamp[0] - start) <= 1
    assert len(recording.samples) == 400


@pytest.mark.parametrize(
    ("time", "expected"), [(1.5, 1_500_000_000), ([1.5, 2.5], [1_500_000_000, 2_500_000_000]), (np.uint8(3), 3 * 10**9)]
)
def test_one_time_stands_for_a_message_and_several_for_its_samples(time, expected):
    found = _time(parse_field_path("time", "stamp"), {"time": time}, 1e9)
    assert isinstance(found, int) == isinstance(expected, int)
    np.testing.assert_array_equal(found, expected)


def test_interleaved_blocks_with_a_period_of_their_own(tmp_path):
    path, *_ = stranger(tmp_path)
    fields = '["samples[0::3]", "samples[1::3]", "samples[2::3]"]'
    half = f"  topic: /inverter/status\n  sample_period: 5e-5\n  fields: {fields}\n"
    text = f"currents:\n{half}voltages:\n{half}resolver:\n  topic: /inverter/status\n  angle: samples[0:2]\n"
    samples = read_recording(path, parse_signals(text + "  sample_period: 0.00005\n", "test")).samples
    np.testing.assert_array_equal(samples.i_abc.ravel(), np.arange(2400))
    assert samples.sample_period == 5e-5
    missing = text.replace("  sample_period: 5e-5\n", "")
    with pytest.raises(SamplePeriodError, match="hold up to 2 samples: give their sample_period in section 'currents'"):
        read_recording(path, parse_signals(missing, "test"))


def test_definitions_from_the_signals_file(tmp_path):
    path, i_abc, *_ = stranger(tmp_path, StoragePlugin.SQLITE3)
    database = sqlite3.connect(path / "stranger.db3")
    database.execute("DELETE FROM message_definitions")
    database.commit()
    database.close()
    indented = "".join(f"    {line}\n" for line in STATUS.splitlines())
    text = STRANGER + "typestore: humble\ndefinitions:\n  inverter_msgs/msg/Status: |\n" + indented
    samples = read_recording(path, parse_signals(text, "test")).samples
    np.testing.assert_allclose(samples.i_abc[:, 0], 0.001 * i_abc[:, 0], rtol=1e-12)


def test_our_messages_through_a_signals_file(tmp_path):
    samples = make_samples()
    write_recording(tmp_path / "ours", samples)
    renamed(tmp_path / "ours", tmp_path / "bag", phase_currents="i", phase_voltages="u", resolver="r")
    text = """
currents: {topic: i, fields: [b, a, c], scale: 2, sample_period: sample_period, first_sample: first_sample}
voltages: {topic: u, fields: [a, b, c], sample_period: 1e-4}
resolver: {topic: r, angle: angle, speed: speed, sample_period: sample_period, first_sample: first_sample}
"""
    found = read_recording(tmp_path / "bag", parse_signals(text, "test")).samples
    np.testing.assert_array_equal(found.i_abc, 2 * samples.i_abc[:, [1, 0, 2]])
    np.testing.assert_array_equal(found.u_abc, samples.u_abc)


def test_losses_are_told_by_the_counter(tmp_path):
    samples = make_samples(reference=False)
    write_recording(tmp_path / "whole", samples, block_size=50)
    with_messages(tmp_path / "whole", tmp_path / "lossy", lambda messages: [m for m in messages if m[0] != 4])
    recording = read_recording(tmp_path / "lossy")
    assert len(recording.samples) == 550
    assert recording.samples.run_starts.tolist() == [0, 50]
    assert any("50 samples of" in text and "missing in 1 place" in text for text in recording.warnings)
