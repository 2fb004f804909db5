"""The commands of the pages for stock tools, executed with their words: ros2cli is on no Python package index."""

from __future__ import annotations

import importlib

import pytest
import yaml
from page_commands import ROOT, commands
from ros_bench import require_ros, ros_bench
from simulated_time import SimulatedTime

TIMES = {"use_sim_time": True, "lead_time": 1.0, "watch_timeout": 10.0}
"""Other tests keep this machine busy."""
STATE = "/trajectory_publisher/state"


def shown(page, *kinds):
    """Return the words of the commands of a page, without ``ros2``, those of these kinds only."""
    words = [each.words[1:] for each in commands("ros2", pages=[ROOT / "docs" / page])]
    return [each for each in words if each[0] in kinds]


def kind_of(name):
    package, folder, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), kind)


class Operator:
    """Does what ros2cli does, and checks what it would print."""

    def __init__(self, ros):
        from drive_id_msgs.msg import PublisherState

        from drive_id.nodes.support.qos import LATCHED

        self.ros, self.state = ros, PublisherState()
        ros.node.create_subscription(PublisherState, STATE, self._on_state, LATCHED)

    def _on_state(self, message):
        self.state = message

    def do(self, kind, verb, *words):
        given = [word for word in words if not word.startswith("--")]
        getattr(self, f"{kind}_{verb}")(*given)

    def topic_echo(self, name):
        assert name == STATE
        self.ros.wait(lambda: self.state.state, f"a message on {name}")

    def topic_pub(self, name, kind, fields):
        assert name == "/emergency_stop"
        publisher = self.ros.node.create_publisher(kind_of(kind), name, 10)
        self.ros.wait(lambda: publisher.get_subscription_count() >= 2, "the subscriptions")
        message = kind_of(kind)(**yaml.safe_load(fields))
        publisher.publish(message)
        pressed = "is pressed" if message.data else "was pressed"
        self.ros.wait(lambda: pressed in self.state.reason or self.state.state == "tripped", "the emergency stop")
        self.ros.node.destroy_publisher(publisher)

    def service_call(self, name, kind, fields="{}"):
        def answered():
            reply = self.ros.call(kind_of(kind), name, **yaml.safe_load(fields))
            assert reply.message
            assert reply.success == (reply.code == reply.CODE_OK)
            return reply.success or name == "/identification/identify"  # so short a recording makes no map

        self.ros.wait(answered, f"success of {name}")

    def action_send_goal(self, name, kind, fields):
        from rclpy.action import ActionClient

        if name == "/experiment/experiment":  # test/ros/test_experiment.py sends goals to it
            assert kind_of(kind).Goal(**yaml.safe_load(fields)).method == "joint"
            return
        client = ActionClient(self.ros.node, kind_of(kind), name)
        self.ros.wait(client.server_is_ready, name)
        sent = client.send_goal_async(kind_of(kind).Goal(**yaml.safe_load(fields)))
        self.ros.wait(sent.done, "the acceptance of a goal")
        assert sent.result().accepted
        result = sent.result().get_result_async()
        self.ros.wait(result.done, "the result of a goal")
        assert result.result().result.message
        client.destroy()

    def param_set(self, node, name, value):
        result = self.ros.set_parameters(node, **{name: yaml.safe_load(value)})
        assert result.successful, result.reason

    def lifecycle_set(self, node, label):
        assert self.ros.change_state(node, label)


@pytest.fixture(scope="module")
def operator():
    require_ros()
    with ros_bench() as ros:
        folders = {"data_directory": str(ros.folder), "output_directory": str(ros.folder / "out")}
        for name, parameters in (
            ("bench_simulator", {"use_sim_time": True}),
            ("trajectory_publisher", {**TIMES, "activate": False}),
            ("recorder", {"data_directory": str(ros.folder), "activate": False}),
            ("identification", {**folders, "activate": False}),
        ):
            file = ROOT / "config" / f"{name}.yaml"
            ros.host(f"drive_id.nodes.{name}", parameters=parameters, files=[file])
        SimulatedTime(ros).follow_topics(lambda: ros.hosted[0], lambda: ros.hosted[1])
        operator = Operator(ros)
        for words in shown("nodes.md", "lifecycle"):
            operator.do(*words)
        yield operator


@pytest.mark.parametrize("page", ["nodes.md", "safety.md"])
def test_what_the_page_shows_works(operator, page):
    lines = shown(page, "topic", "service", "action", "param")
    assert {"topic", "service"} < {kind for kind, *_ in lines}
    for words in lines:
        operator.do(*words)
