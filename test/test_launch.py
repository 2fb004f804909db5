"""The launch files, executed: by launch_ros where it is installed, else by stand-ins for the little they use of it."""

from __future__ import annotations

import importlib.util
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import yaml
from live_drive import LIGHT
from ros_bench import require_ros, ros_bench

ROOT = Path(__file__).parent.parent
USED = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction"),
    "launch.substitutions": ("LaunchConfiguration",),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
}
INSTALLED = importlib.util.find_spec("launch_ros") is not None


class Configuration:
    """Stands for a launch configuration: the value of an argument."""

    def __init__(self, name):
        self.name = name

    def perform(self, context):
        return context.launch_configurations[self.name]


def stand_ins():
    """The package launch is on no Python package index."""
    for name, members in USED.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member, lambda *args, **given: SimpleNamespace(args=args, **given))
        yield name, module


class Launched:
    """A launch file with arguments, as far as ``_nodes``."""

    def __init__(self, file, monkeypatch, **arguments):
        if not INSTALLED:
            for name, module in stand_ins():
                monkeypatch.setitem(sys.modules, name, module)
        spec = importlib.util.spec_from_file_location("launch_file", ROOT / "launch" / file)
        self.module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(self.module)
        self.declared = {}
        monkeypatch.setattr(self.module, "DeclareLaunchArgument", self._declare)
        monkeypatch.setattr(self.module, "LaunchConfiguration", Configuration)
        monkeypatch.setattr(self.module, "Node", SimpleNamespace)
        monkeypatch.setattr(self.module, "ParameterValue", lambda value, value_type: (value, value_type), raising=False)
        monkeypatch.setattr(self.module, "LaunchDescription", list)
        monkeypatch.setattr(self.module, "OpaqueFunction", lambda function: function)
        self.described = self.module.generate_launch_description()
        values = {name: given["default_value"] for name, given in self.declared.items()}
        assert set(arguments) <= set(values)
        for name, text in arguments.items():
            assert text in self.declared[name].get("choices", [text])
        self.context = SimpleNamespace(launch_configurations=values | arguments)

    def _declare(self, name, **given):
        assert given["description"].endswith(".")
        assert given["default_value"] in given.get("choices", [given["default_value"]])
        self.declared[name] = given
        return name

    def nodes(self):
        return {node.executable: node for node in self.described[-1](self.context)}

    def own(self, node):
        """The parameters that prevail over the file."""
        first, *further = node.parameters
        assert isinstance(first, Configuration)
        assert Path(first.perform(self.context)).is_file()
        values = further[0] if further else {}
        return {
            name: value[0].perform(self.context)
            if isinstance(value, tuple) and not isinstance(value[0], str)
            else value
            for name, value in values.items()
        }


def test_what_is_not_given_does_not_hide_the_parameter_files(monkeypatch):
    bench = Launched("bench.launch.py", monkeypatch)
    assert bench.own(bench.nodes()["bench_simulator"]) == {}
    nodes = Launched("identification.launch.py", monkeypatch)
    assert [nodes.own(node) for node in nodes.nodes().values()] == [{}, {}, {}, {}]
    assert not any(node.respawn for node in nodes.nodes().values())


def test_what_is_given_prevails(monkeypatch):
    bench = Launched("bench.launch.py", monkeypatch, machine="spm", truth_file="/tmp/truth.npz")
    assert bench.own(bench.nodes()["bench_simulator"]) == {"machine": "spm", "truth_file": "/tmp/truth.npz"}
    given = {"i_max": "300", "speed_max": "400", "require_status": "false", "use_sim_time": "true", "respawn": "true"}
    launched = Launched("identification.launch.py", monkeypatch, **given)
    nodes = launched.nodes()
    assert launched.own(nodes["recorder"]) == {"use_sim_time": True}
    assert launched.own(nodes["identification"]) == {"use_sim_time": True, "i_max": 300.0}
    supervision = {"speed_max": 400.0, "require_status": False}
    assert launched.own(nodes["trajectory_publisher"]) == {"use_sim_time": True, "i_max": 300.0} | supervision
    assert {name for name, node in nodes.items() if node.respawn} == {"recorder", "identification", "experiment"}


def test_folders_lifecycle_and_log_level_are_arguments(monkeypatch):
    text = lambda value: (value, str)  # noqa: E731  # as ParameterValue
    given = {"data_directory": "/data", "output_directory": "/out", "activate": "false", "log_level": "debug"}
    launched = Launched("identification.launch.py", monkeypatch, **given)
    nodes = launched.nodes()
    assert launched.own(nodes["recorder"]) == {"data_directory": text("/data"), "activate": False}
    expected = {"data_directory": text("/data"), "output_directory": text("/out"), "activate": False}
    assert launched.own(nodes["identification"]) == expected
    assert launched.own(nodes["trajectory_publisher"]) == {"activate": False}
    for node in nodes.values():
        option, level = node.ros_arguments
        assert (option, level.perform(launched.context)) == ("--log-level", "debug")
    launched = Launched("identification.launch.py", monkeypatch, autostart="false")
    assert [launched.own(node) for node in launched.nodes().values()] == [{"autostart": False}] * 3 + [{}]


def test_the_bridge_or_the_identification_reads_the_signals_file(monkeypatch):
    launched = Launched("identification.launch.py", monkeypatch, signals="my.yaml")
    nodes = launched.nodes()
    assert "signal_bridge" not in nodes
    assert launched.own(nodes["identification"]) == {"signals": ("my.yaml", str)}
    launched = Launched("identification.launch.py", monkeypatch, signals="my.yaml", bridge="true", respawn="true")
    nodes = launched.nodes()
    assert launched.own(nodes["signal_bridge"]) == {"signals": ("my.yaml", str)}
    assert launched.own(nodes["identification"]) == {}
    assert nodes["signal_bridge"].respawn


def test_a_radius_that_is_no_number_is_named(monkeypatch):
    launched = Launched("identification.launch.py", monkeypatch, i_max="abc")
    with pytest.raises(ValueError, match=r"i_max:=abc is not a number: write it as in i_max:=300\.0"):
        launched.nodes()


@pytest.mark.parametrize("file", ["bench.launch.py", "identification.launch.py"])
def test_every_topic_can_be_renamed_and_every_file_has_what_its_node_is_told(monkeypatch, file):
    launched = Launched(file, monkeypatch)
    for node in launched.nodes().values():
        assert {topic: target.name for topic, target in node.remappings} == {t: t for t in launched.module.TOPICS}
        text = Path(node.parameters[0].perform(launched.context)).read_text(encoding="utf-8")
        assert list(yaml.safe_load(text)) == ["/**"]  # for any name and namespace
    assert set(launched.module.TOPICS) <= set(launched.declared)


def test_the_topics_are_those_that_the_nodes_use(monkeypatch):
    """The policy is compared with the running nodes by a test of its own."""
    profiles = ET.parse(ROOT / "config" / "sros2" / "drive_id.policy.xml").iter("profile")
    used = {topic.text for profile in profiles for topic in profile.iter("topic")}
    launched = Launched("identification.launch.py", monkeypatch)
    assert set(launched.module.TOPICS) == {name for name in used if "/" not in name and name[0] != "~"}
    bench = set(Launched("bench.launch.py", monkeypatch).module.TOPICS)
    assert bench == set(launched.module.TOPICS) - {
        "emergency_stop", "fit_report", "flux_map", "flux_map_points", "operating_point",
    }  # fmt: skip


@pytest.mark.process
@pytest.mark.slow  # an experiment in simulated time, beside another drive; in one thread, ten nodes starve at load 8
def test_two_benches_run_beside_each_other_each_by_its_own_clock(monkeypatch):
    """The nodes that the launch file describes: an experiment of one, while the other runs by another time."""
    require_ros()
    from action_goal import experiment
    from diagnostic_msgs.msg import DiagnosticArray
    from drive_id_msgs.action import Experiment
    from rclpy.action import ActionClient
    from rosgraph_msgs.msg import Clock

    if not INSTALLED:
        for name, module in stand_ins():
            monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("launch_file", ROOT / "launch" / "two_benches.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "Node", SimpleNamespace)
    monkeypatch.setattr(module, "LaunchDescription", list)
    with ros_bench() as ros:
        clocks, named = {}, set()
        monkeypatch.chdir(ros.folder)
        for node in module.generate_launch_description():
            file, own = node.parameters
            room = "ros" if node.executable == "experiment" else "nodes"
            patient = {"watch_timeout": 30.0, "clock_offset": 30.0, "lead_time": 2.0, "duration": 1.0}
            own |= patient if node.executable == "trajectory_publisher" else {}
            own |= {"method": "joint", "refit_share": 0.0} if node.executable == "identification" else {}
            own |= LIGHT | {"time_scale": 0.5} if node.executable == "bench_simulator" else {}
            ((old, new),) = node.remappings
            ros.start(
                f"drive_id.{room}.{node.executable}", parameters=own, files=[file], namespace=f"/{node.namespace}",
                arguments=["-r", f"{old}:={new}"],
            )  # fmt: skip
            clocks.setdefault(new, [])
        for topic, heard in clocks.items():
            ros.node.create_subscription(Clock, topic, heard.append, 100)
        ros.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda m: named.update(each.name for each in m.status), 100
        )
        client = ActionClient(ros.node, Experiment, "/drive_2/experiment/experiment")
        _, result = experiment(ros, client).wait()
        client.destroy()
        assert result.code == "ok", result.message
        assert "drive_2/recordings" in result.bags[0]
        assert result.flux_map.i_max == 20.0
        assert all(clocks.values()), "both publish a clock"
        ros.wait(lambda: len(named) == 10, "the diagnostics of all nodes")
        assert_each_has_one_analyzer(named)


def assert_each_has_one_analyzer(names):
    """``GenericAnalyzer`` takes a status whose name contains one of the words."""
    tree = yaml.safe_load((ROOT / "config" / "analyzers.yaml").read_text(encoding="utf-8"))
    analyzers = [each for each in tree["/**"]["ros__parameters"].values() if isinstance(each, dict)]
    for name in names:
        assert sum(any(word in name for word in each["contains"]) for each in analyzers) == 1, name
