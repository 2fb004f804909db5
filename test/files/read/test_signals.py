"""Signals files: the shipped ones load, everything else that is wrong is named with file, line and field."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from drive_id.errors import ConfigurationError
from drive_id.files.messages.field_path import FieldPathError, parse_field_path
from drive_id.files.messages.signals_file import SignalMap, parse_signals, read_signals

CONFIG = Path(__file__).parents[3] / "config"
SHIPPED = sorted(CONFIG.glob("signals*.yaml"))
VALID = """\
currents:
  topic: /a
  fields: [x, y]
voltages:
  topic: /b
  fields: [x, y, z]
resolver:
  topic: /c
  angle: position[0]
"""


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_every_shipped_file_loads(path):
    assert isinstance(read_signals(path), SignalMap)


def test_the_defaults_are_the_shipped_defaults():
    assert len(SHIPPED) >= 2
    assert read_signals(CONFIG / "signals_default.yaml") == SignalMap()


def test_the_example_means_what_it_says():
    signals = read_signals(CONFIG / "signals_example_stranger.yaml")
    assert signals.currents.sample_period == 1e-4
    assert signals.currents.factors == (0.001, -0.001)
    assert set(signals.definitions) == {"inverter_msgs/msg/Phase", "inverter_msgs/msg/Status"}


def test_units():
    rotor = parse_signals(VALID + "  angle_unit: deg\n  mechanical: true\n  pole_pairs: 3\n", "f").resolver
    assert rotor.angle_factor == pytest.approx(np.pi / 60)
    rotor = parse_signals(VALID + "  speed: v\n  speed_unit: rpm\n  speed_scale: -1\n", "f").resolver
    assert rotor.speed_factor == pytest.approx(-np.pi / 30)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("voltages:", "voltage:", r"f has a section 'voltage': the sections are currents, voltages"),
        ("voltages:\n  topic: /b\n  fields: [x, y, z]\n", "", r"f has no section 'voltages'"),
        ("  topic: /b\n", "", r"In f, line 4, section 'voltages': topic is missing"),
        ("  topic: /b\n", "  topic: 3\n", r"'topic' in f, line 4, section 'voltages' is 3"),
        ("  topic: /b\n", "  topic: /b\n  topic: /d\n", r"f, line 6 gives 'topic' twice"),
        ("[x, y, z]", "[x]", r"names 1 phases"),
        ("[x, y, z]", "[x, y, y]", r"the same path twice"),
        ("[x, y, z]", "[x, y, z]\n  scale: [1, 2]", r"scale is \(1.0, 2.0\)"),
        ("[x, y, z]", "[x, y, z]\n  scale: 0", r"none of them zero"),
        ("[x, y, z]", "[x, y, z]\n  scale: .nan", r"scale is nan: it must be a finite number"),
        ("[x, y, z]", "[x, y, z]\n  scale: big", r"section 'voltages': scale is 'big': give numbers, or dc_link"),
        ("[x, y, z]", "[x, y, z]\n  scale: dc_link_voltage", r"voltages in f are scaled by dc_link_voltage, which is"),
        ("[x, y]", "[x, y]\n  scale: dc_link_voltage", r"section 'currents' of f is dc_link_voltage: give the factor"),
        ("position[0]", "p\noptional: [a]", r"f, line 10, section 'optional' is not a mapping"),
        ("position[0]", "p\noptional: {u_dc: {topic: a}}", r"has a signal 'u_dc': the signals are dc_link_volt"),
        ("position[0]", "p\noptional: {shaft_torque: 3}", r"'optional', signal 'shaft_torque' is not a mapping"),
        ("position[0]", "p\noptional: {shaft_torque: {topic: a}}", r"signal 'shaft_torque': field is missing"),
        ("position[0]", "p\noptional: {shaft_torque: {topic: a, field: b, scale: 0}}", r"scale is 0: give a factor"),
        ("[x, y, z]", "[x, y, z]\n  gain: 1", r"'gain' in .* does not exist"),
        ("[x, y, z]", "[x, 'y[', z]", r"fields is 'y\['"),
        ("[x, y, z]", "[x, __class__, z]", r"fields is '__class__'"),
        ("[x, y, z]", "[x, y, z]\n  stamp: 'a..b'", r"stamp is 'a..b'"),
        ("[x, y, z]", "[x, y, z]\n  stamp_unit: d", r"stamp_unit is 'd': it must be one of s, ms, us, ns, min, h"),
        ("[x, y, z]", "[x, y, z]\n  sample_period: 0", r"sample_period is 0.0 s: it must be positive"),
        ("[x, y, z]", "[x, y, z]\n  sample_period: -1e-4", r"sample_period is -0.0001 s"),
        ("  angle: position[0]\n", "", r"angle is missing"),
        ("position[0]", "p\n  mechanical: true", r"pole_pairs is missing"),
        ("position[0]", "p\n  pole_pairs: 3", r"set mechanical: true"),
        ("position[0]", "p\n  mechanical: true\n  pole_pairs: 0", r"pole_pairs is 0: it must be at least 1"),
        ("position[0]", "p\n  mechanical: true\n  pole_pairs: 2.5", r"'pole_pairs' in f, line 7"),
        ("position[0]", "p\n  angle_unit: grad", r"angle_unit is 'grad'"),
        ("position[0]", "p\n  angle_scale: 0", r"angle_scale or speed_scale is 0"),
        ("position[0]", "p\nreference: {topic: r, fields: [d]}", r"names 1 current:"),
        ("position[0]", "p\ntypestore: noetic", r"typestore in f is 'noetic'"),
        ("position[0]", "p\ndefinitions: [1]", r"definitions in f must map"),
        ("  fields: [x, y, z]", "  fields: [x, y, z", r"f is not YAML in line"),
        (VALID, "- 1\n", r"f is not a mapping"),
        (VALID, "currents: 3\n", r"f, line 1, section 'currents' is not a mapping"),
        (VALID, "", r"f has no section 'currents'"),
        (VALID, "a: &x {b: *x}\n", r"f cannot be read as YAML \(it contains itself\)"),
        (VALID, "!!python/object/apply:os.getcwd []\n", r"f is not YAML"),
    ],
)
def test_what_is_wrong_is_named(old, new, said):
    assert old in VALID
    with pytest.raises(ConfigurationError, match=said) as caught:
        parse_signals(VALID.replace(old, new), "f")
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigurationError, match="No such file"):
        read_signals(tmp_path / "none.yaml")
    with pytest.raises(ConfigurationError, match="Is a directory"):
        read_signals(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(bytes(range(256)))
    with pytest.raises(ConfigurationError, match="not a text file"):
        read_signals(tmp_path / "binary.yaml")
    (tmp_path / "control.yaml").write_bytes(bytes(range(32)))
    with pytest.raises(ConfigurationError, match="is not YAML"):
        read_signals(tmp_path / "control.yaml")
    os.mkfifo(tmp_path / "fifo.yaml")
    with pytest.raises(ConfigurationError, match="it is a FIFO, not a file"):
        read_signals(tmp_path / "fifo.yaml")
    (tmp_path / "large.yaml").write_bytes(b" " * (2 << 20))
    with pytest.raises(ConfigurationError, match="too large"):
        read_signals(tmp_path / "large.yaml")


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet="abc[]{}:,-&*!|>'\"#\n 01.", max_size=80))
def test_any_text_is_refused_or_understood(text):
    for document in (text, VALID + text):
        with contextlib.suppress(ConfigurationError):
            parse_signals(document, "f")


# -- paths ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def message():
    kinds = get_typestore(Stores.ROS2_JAZZY).types
    header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](1, 2), "drive")
    points = [kinds["geometry_msgs/msg/Point"](float(k), k + 0.5, -1.0) for k in range(4)]
    return kinds["visualization_msgs/msg/Marker"], kinds, header, points


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("position[0]", [1.0]),
        ("position[-1]", [4.0]),
        ("position", [1.0, 2.0, 3.0, 4.0]),
        ("position[:]", [1.0, 2.0, 3.0, 4.0]),
        ("position[0::2]", [1.0, 3.0]),
        ("position[1:3]", [2.0, 3.0]),
        ("header.stamp.nanosec", [2.0]),
    ],
)
def test_paths(message, path, expected):
    _, kinds, header, _ = message
    joint = kinds["sensor_msgs/msg/JointState"](header, ["a"], np.arange(1.0, 5.0), np.zeros(0), np.zeros(0))
    assert parse_field_path(path, "f").values(joint).tolist() == expected


def test_paths_through_arrays_of_messages(message):
    _, kinds, _, points = message
    cloud = kinds["geometry_msgs/msg/Polygon"]([kinds["geometry_msgs/msg/Point32"](p.x, p.y, p.z) for p in points])
    assert parse_field_path("points[:].y", "f").values(cloud).tolist() == [0.5, 1.5, 2.5, 3.5]
    assert parse_field_path("points[2].x", "f").values(cloud).tolist() == [2.0]


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("speed", r"asks for the field 'speed', but it has header, name, position, velocity, effort"),
        ("position[9]", r"asks for element 9 of an array of 4"),
        ("header[0]", r"takes an element of a field that is not an array"),
        ("position.x", r"there are no fields there"),
        ("header", r"is not a number"),
        ("header.frame_id", r"is not a number"),
        ("name", r"is not a number or an array of numbers"),
    ],
)
def test_paths_that_lead_nowhere(message, path, said):
    _, kinds, header, _ = message
    joint = kinds["sensor_msgs/msg/JointState"](header, ["a"], np.arange(1.0, 5.0), np.zeros(0), np.zeros(0))
    with pytest.raises(FieldPathError, match=said):
        parse_field_path(path, "f").values(joint)


@pytest.mark.parametrize("text", ["", ".", "a.", ".a", "a b", "[0]", "a[", "a[]", "a[x]", "a[::0]", "a[0]b", "é", "_a"])
def test_paths_that_are_none(text):
    with pytest.raises(ConfigurationError, match="write a field path"):
        parse_field_path(text, "fields")


@pytest.mark.parametrize(
    ("line", "setting"),
    [
        ("  angle_offset: 0.2  # EDIT", "angle_offset: 0.2"),
        ("  direction: -1 #EDIT: which way?", "direction: -1"),
        ("  angle_scale: 2.0\t# EDIT, half?", "angle_scale: 2.0"),
        ("  # angle_offset: 0.2  # EDIT", None),
        ("  angle_offset: 0.2  # EDITED by hand", None),
        ("  angle_offset: 0.2  # no EDIT", None),
    ],
)
def test_whatever_is_marked_as_a_guess_is_told(line, setting):
    text = VALID + line + "\n"
    found = parse_signals(text, "f").guessed
    assert found == ({setting: [text.count("\n")]} if setting else {})
