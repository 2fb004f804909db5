"""Optional signals in bags: what we write, rosbags reads; what others write, we read, whole and piece by piece."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bag_samples import START, STEP, assert_equal_samples, make_samples, write_foreign
from copied_bags import by_rosbags
from drive_bags import renamed
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from test_bag_reader import STRANGER, stranger

import drive_id
from drive_id.core.signals.join import joined
from drive_id.errors import MissingTopicError
from drive_id.files.messages.signals_file import SignalMap, parse_signals
from drive_id.files.read import extraction
from drive_id.files.read.reader import bag_pieces
from drive_id.files.read.several import read_recording
from drive_id.files.write.writer import write_recording
from drive_id.types import SCALARS


def with_scalars(n=6000, **options):
    samples = make_samples(n, **options)
    time = 1e-4 * np.arange(n)
    return replace(
        samples,
        dc_link_voltage=(560 + np.sin(40 * time)).astype(np.float32).astype(float),
        winding_temperature=40 + 2 * time,
        shaft_torque=np.where(time < 0.1, np.nan, 3.0),
    )


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("namespace", ["", "drive_1"])
def test_what_is_written_comes_back(tmp_path, storage, namespace):
    samples = with_scalars()
    write_recording(tmp_path / "ours", samples, scalar_periods={"winding_temperature": 0.05})
    path = by_rosbags(renamed(tmp_path / "ours", tmp_path / "bag", namespace), tmp_path / "copy", storage)
    found = read_recording(path).samples
    assert_equal_samples(found, samples)
    np.testing.assert_array_equal(found.dc_link_voltage, samples.dc_link_voltage)
    np.testing.assert_allclose(found.winding_temperature, samples.winding_temperature, atol=0.1)  # held at the ends
    np.testing.assert_array_equal(found.shaft_torque, 3.0)  # held backwards over 0.1 s
    assert found.magnet_temperature is None
    assert list(drive_id.read_bag(path).scalars()) == ["dc_link_voltage", "winding_temperature", "shaft_torque"]


def test_rosbags_reads_what_we_write(tmp_path):
    samples = with_scalars()
    write_recording(tmp_path / "bag", samples, scalar_periods={"winding_temperature": 0.1, "dc_link_voltage": 1e-3})
    found = {name: [] for name in SCALARS}
    with AnyReader([tmp_path / "bag"]) as reader:
        assert {connection.topic for connection in reader.connections if connection.msgcount} == {
            "/phase_currents", "/phase_voltages", "/resolver", "/current_reference", "/dc_link_voltage",
            "/winding_temperature", "/shaft_torque",
        }  # fmt: skip
        for connection, _, raw in reader.messages():
            if connection.topic[1:] in found:
                assert connection.msgtype == "drive_id_msgs/msg/ScalarSamples"
                message = reader.deserialize(raw, connection.msgtype)
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                step = round(1e9 * message.sample_period)
                found[connection.topic[1:]] += [(stamp + k * step, value) for k, value in enumerate(message.value)]
    every = {"winding_temperature": 1000, "dc_link_voltage": 10, "shaft_torque": 1}
    for name, stride in every.items():
        stamps, values = (np.array(column) for column in zip(*found[name], strict=True))
        known = np.isfinite(getattr(samples, name)[::stride])
        np.testing.assert_array_equal(stamps, samples.stamp[::stride][known])
        np.testing.assert_array_equal(values, getattr(samples, name)[::stride][known].astype(np.float32))


@pytest.mark.parametrize("storage", [None, *StoragePlugin])
def test_pieces_are_the_whole(tmp_path, monkeypatch, storage):
    monkeypatch.setattr(extraction, "PART_SAMPLES", 300)
    write_recording(
        tmp_path / "bag", with_scalars(gap_at=2500), chunk_size=1500, scalar_periods={"winding_temperature": 0.2}
    )
    path = tmp_path / "bag" if storage is None else by_rosbags(tmp_path / "bag", tmp_path / "copy", storage)
    monkeypatch.setattr("drive_id.files.read.reader._LOCKING_PAIRS", 100)
    pieces = list(bag_pieces(path, SignalMap()))
    assert len(pieces) > (storage is not StoragePlugin.MCAP)  # rosbags writes large chunks
    whole = read_recording(path).samples
    assert_equal_samples(joined(pieces), whole)
    for name in SCALARS:
        np.testing.assert_array_equal(getattr(joined(pieces), name), getattr(whole, name), err_msg=name)


def test_a_topic_of_that_name_with_another_type_is_not_ours(tmp_path):
    """Bags that were readable before there were optional signals still are."""
    write_recording(tmp_path / "bag", make_samples(600))
    store = get_typestore(Stores.ROS2_JAZZY)
    float64 = store.types["std_msgs/msg/Float64"]
    for kind in ("phase_currents", "phase_voltages", "resolver"):
        store.register(get_types_from_msg(drive_id_definition(kind), TYPES[kind]))
    topics = {"/dc_link_voltage": ("std_msgs/msg/Float64", [(START + k, float64(560.0)) for k in range(3)])}
    with AnyReader([tmp_path / "bag"]) as reader:
        for name, kind in TYPES.items():
            connections = [c for c in reader.connections if c.topic == f"/{name}"]
            messages = [(t, reader.deserialize(raw, kind)) for _, t, raw in reader.messages(connections)]
            topics[f"/{name}"] = (kind, messages)
    found = read_recording(write_foreign(tmp_path / "mixed", store, topics)).samples
    assert len(found) == 600
    assert found.dc_link_voltage is None


TYPES = {
    "phase_currents": "drive_id_msgs/msg/PhaseCurrents",
    "phase_voltages": "drive_id_msgs/msg/PhaseVoltages",
    "resolver": "drive_id_msgs/msg/Resolver",
}


def drive_id_definition(topic):
    from drive_id.files.messages.messages import schema_text

    return schema_text(TYPES[topic])


OPTIONAL = """
optional:
  dc_link_voltage:
    topic: /inverter/status
    field: time
    scale: 1000.0
    offset: 540.0
  shaft_torque:
    topic: /joint_states
    field: velocity[0]
    scale: -0.01
  winding_temperature:
    topic: /not/recorded
    field: data
"""


@pytest.mark.parametrize("speed", ["", "  speed: velocity[0]\n  speed_unit: rpm\n"])
@pytest.mark.parametrize("declared", [False, True])
def test_a_strangers_bag_with_duty_cycles(tmp_path, speed, declared):
    path, _, duty, _ = stranger(tmp_path)
    text = STRANGER.replace("scale: 560.0", "scale: dc_link_voltage") + speed
    if declared:
        text = text.replace("  topic:", "  sample_period: 0.0001\n  topic:")
    signals = parse_signals(text + OPTIONAL, "test")
    samples = read_recording(path, signals).samples
    u_dc = 540 + 1000 * (STEP * 1e-9 * np.arange(400))
    np.testing.assert_allclose(samples.dc_link_voltage, u_dc, rtol=1e-9)
    np.testing.assert_allclose(samples.u_abc, duty * u_dc[:, None], rtol=1e-9)
    np.testing.assert_allclose(samples.shaft_torque, -15.0)
    assert samples.winding_temperature is None
    pieces = joined(list(bag_pieces(path, signals)))
    np.testing.assert_array_equal(pieces.u_abc, samples.u_abc)
    np.testing.assert_array_equal(pieces.shaft_torque, samples.shaft_torque)


def test_duty_cycles_need_their_topic(tmp_path):
    path, *_ = stranger(tmp_path)
    text = STRANGER.replace("scale: 560.0", "scale: dc_link_voltage")
    text += "optional: {dc_link_voltage: {topic: /u_dc, field: data}}\n"
    with pytest.raises(MissingTopicError, match="has no topic /u_dc for the dc_link_voltage"):
        read_recording(path, parse_signals(text, "test"))
