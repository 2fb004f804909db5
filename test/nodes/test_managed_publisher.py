"""The lifecycle of ``trajectory_publisher``: what each state permits, and zero current behind every end of active."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from ros_bench import require_ros, ros_bench
from simulated_time import SimulatedTime

MODULE = "drive_id.nodes.trajectory_publisher"
NAME = "/trajectory_publisher"


@pytest.fixture(scope="module")
def ros():
    with ros_bench() as bench:
        simulator = bench.host("drive_id.nodes.bench_simulator", parameters={"use_sim_time": True})
        clock = SimulatedTime(bench)
        last = clock.follow_topics(lambda: simulator, lambda: bench.hosted[-1])
        bench.wait(lambda: "resolver" in last, "the bench")
        yield bench


def stamp(block):
    return block.header.stamp.sec * 10**9 + block.header.stamp.nanosec


class Managed:
    """A publisher in a namespace of its own or not, its references, and its services."""

    def __init__(self, ros, **parameters):
        from drive_id_msgs.msg import CurrentReference

        from drive_id.nodes.support.qos import STREAM

        self.ros = ros
        self.blocks = []
        self.subscription = ros.node.create_subscription(
            CurrentReference, "/current_reference", self.blocks.append, STREAM
        )
        given = {"i_max": 20.0, "lead_time": 1.0, "watch_timeout": 10.0, "use_sim_time": True}
        self.node = ros.host(MODULE, parameters=given | parameters)

    def change(self, label="", number=0):
        return self.ros.change_state(NAME, label, number)

    def state(self):
        from lifecycle_msgs.srv import GetState

        return self.ros.call(GetState, f"{NAME}/get_state").current_state.label

    def call(self, name):
        from std_srvs.srv import Trigger

        return self.ros.call(Trigger, f"{NAME}/{name}")

    def ask(self, name, **fields):
        """Return code and sentence of a typed service, and the session of a start."""
        from drive_id_msgs.srv import Command, StartExperiment

        kind = StartExperiment if name == "start_experiment" else Command
        reply = self.ros.call(kind, f"{NAME}/{name}", **fields)
        assert reply.success == (reply.code == kind.Response.CODE_OK), reply
        assert reply.message
        return reply

    def health(self, condition=lambda _: True):
        """Return the values of the next diagnostics for which the condition holds, with the message."""
        from diagnostic_msgs.msg import DiagnosticArray

        heard = []

        def hear(array):
            for status in array.status:
                values = {value.key: value.value for value in status.values} | {"message": status.message}
                if status.name == NAME and condition(values):
                    heard.append(values)

        subscription = self.ros.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
        self.ros.wait(lambda: heard, "diagnostics")
        self.ros.node.destroy_subscription(subscription)
        return heard[0]

    def begin(self):
        """Start an experiment, as soon as the drive is heard, and wait until it has current."""
        self.blocks.clear()
        self.ros.wait(lambda: self.call("start").success, "a start")
        self.ros.wait(lambda: len(self.blocks) > 10 and np.abs(self.blocks[-1].d).max() > 1.0, "references")

    def assert_ends_at_zero(self):
        """The last blocks lead to zero by the slew rate, none is missing, and nothing follows."""
        self.ros.wait(lambda: not np.any(self.blocks[-1].d) and not np.any(self.blocks[-1].q), "zeros")
        self.rest()
        last = self.blocks[-1]
        begin = max(k for k, (a, b) in enumerate(pairwise(self.blocks), 1) if stamp(b) <= stamp(a))
        ramp = np.concatenate([np.stack([block.d, block.q], axis=-1) for block in self.blocks[begin:]])
        assert np.hypot(*np.diff(ramp, axis=0).T).max() <= 1e4 * 1e-4 * (1 + 1e-3)
        assert not ramp[-1].any()
        count = len(self.blocks)
        self.rest()
        assert len(self.blocks) == count
        assert last is self.blocks[-1]
        assert all(b.first_sample == a.first_sample + len(a.d) for a, b in pairwise(self.blocks))

    def rest(self):
        self.ros.spin(0.3)

    def close(self):
        self.ros.node.destroy_subscription(self.subscription)
        self.ros.forget_clients()
        self.node.end()


@pytest.mark.slow  # a table of all states, each of which the state machine has in test/core
def test_without_autostart_each_state_permits_what_it_should(ros):
    managed = Managed(ros, autostart=False)
    assert managed.state() == "unconfigured"
    reply = managed.call("start")
    assert not reply.success
    assert "is unconfigured: configure and activate it" in reply.message
    assert managed.call("stop").message == "Nothing is running."
    assert ros.node.count_publishers("/current_reference") == 0
    for label, number in (("activate", 0), ("", 3), ("", 200), ("nonsense", 0)):  # none of them leads anywhere
        assert not managed.change(label, number), (label, number)
    assert managed.state() == "unconfigured"
    assert managed.change("configure")
    assert managed.state() == "inactive"
    assert "is inactive: activate it" in managed.call("start").message
    assert managed.change("activate")
    managed.begin()
    assert managed.change("deactivate")
    managed.assert_ends_at_zero()
    assert managed.state() == "inactive"
    assert not managed.call("start").success
    assert managed.change("cleanup")
    ros.wait(lambda: ros.node.count_publishers("/current_reference") == 0, "the publisher to go")
    managed.rest()  # meanwhile the drive goes on: these samples are not lost
    assert managed.change("configure")
    assert managed.change("activate")
    managed.begin()  # again
    health = managed.health()
    assert [value for key, value in health.items() if key.startswith("lost samples")] == ["0", "0"]
    assert managed.change("shutdown")
    managed.assert_ends_at_zero()
    assert managed.state() == "finalized"
    refusal = managed.call("start")
    assert not refusal.success
    assert refusal.message == "Not started. The node was shut down and stays so: start its process again."
    managed.close()


def test_without_activate_it_configures_itself_and_waits(ros):
    managed = Managed(ros, activate=False)
    assert managed.state() == "inactive"
    ros.wait(lambda: ros.node.count_publishers("/current_reference"), "the publisher of a configured node")
    assert managed.ask("start_experiment").code == "inactive"
    assert managed.change("activate")
    managed.begin()
    managed.node.end()
    managed.assert_ends_at_zero()
    managed.close()


def test_every_reply_has_a_code(ros):
    """And each field of a request reaches the supervision, whose codes test_supervision.py has."""
    from std_msgs.msg import Empty

    managed = Managed(ros, autostart=False)
    beat = ros.node.create_publisher(Empty, f"{NAME}/heartbeat", 1)
    assert managed.ask("start_experiment").code == "inactive"
    assert managed.ask("stop_experiment").code == "ok"
    reply = managed.ask("clear_fault")
    assert reply.code == "inactive"
    assert reply.message.startswith("Not cleared. The node is unconfigured: configure and activate it")
    assert managed.change("configure")
    assert managed.ask("start_experiment").code == "inactive"
    assert managed.ask("clear_fault").code == "inactive"
    assert managed.change("activate")
    ros.wait(lambda: managed.ask("start_experiment", require_lease=True).code == "no_heartbeat", "the drive")
    ros.wait(lambda: managed.ask("start_experiment", dry_run=True).success, "a dry run")
    assert managed.ask("stop_experiment").message == "Stopping: the current ramps down to zero."
    ros.wait(lambda: managed.health()["state"] == "idle", "its end")
    assert not any(np.any(block.d) or np.any(block.q) for block in managed.blocks)

    beats = ros.node.create_timer(0.1, lambda: beat.publish(Empty()))

    def begun():
        return (reply := managed.ask("start_experiment", require_lease=True)).success and reply

    session = ros.wait(begun, "a start").session
    ros.wait(lambda: managed.blocks and managed.blocks[-1].session == session != 0, "references of the session")
    ros.node.destroy_timer(beats)
    ros.node.destroy_publisher(beat)
    managed.close()


def test_a_single_press_and_a_single_release_of_the_emergency_stop_are_heard(ros):
    """As ``ros2 topic pub --once`` sends them: it ends 0.1 s after the only message."""
    from std_msgs.msg import Bool

    managed = Managed(ros)

    def publish_once(pressed):
        publisher = ros.node.create_publisher(Bool, "/emergency_stop", 10)
        ros.wait(lambda: publisher.get_subscription_count() >= 2, "the subscriptions")
        publisher.publish(Bool(data=pressed))
        ros.spin(0.1)
        ros.node.destroy_publisher(publisher)

    ros.wait(lambda: "Nothing has arrived" not in managed.ask("clear_fault").message, "the drive")
    for _ in range(10):
        publish_once(True)
        reply = managed.ask("clear_fault")
        assert (reply.code, reply.message) == ("fault", "Not cleared: The emergency stop (/emergency_stop) is pressed.")
        publish_once(False)
        ros.wait(lambda: "emergency" not in managed.ask("clear_fault").message, "the release")
    managed.close()


def test_it_activates_itself_and_ends_at_zero_with_the_process(ros):
    managed = Managed(ros)
    assert managed.state() == "active"
    managed.rest()
    assert managed.blocks == []  # no current without a start
    managed.begin()
    assert not managed.change("configure")
    assert managed.state() == "active"
    managed.node.end()
    managed.assert_ends_at_zero()
    managed.close()


def test_an_incompatible_subscription_is_named(ros):
    from drive_id_msgs.msg import CurrentReference
    from rclpy.qos import DurabilityPolicy, QoSProfile

    managed = Managed(ros)
    late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    subscription = ros.node.create_subscription(CurrentReference, "/current_reference", lambda _: None, late)
    said = managed.health(lambda values: "receives nothing" in values["message"])
    assert said["state"] == "idle"
    sentence = said["message"].partition(". ")[2]
    start = "/test_bench receives nothing on /current_reference: its quality of service is incompatible ("
    assert sentence.startswith(start)
    assert "transient local" in sentence
    ros.node.destroy_subscription(subscription)
    managed.health(lambda values: "receives nothing" not in values["message"])
    assert managed.node.output.count("receives nothing") == 1
    managed.close()


def test_a_subscription_of_another_type_is_named():
    """With a mock graph: in DDS, one process cannot have a topic with two types."""
    require_ros()
    from drive_id.nodes.support.qos import STREAM, incompatible_subscriptions, known_nodes

    def info(namespace, name, kind):
        return SimpleNamespace(node_namespace=namespace, node_name=name, topic_type=kind, qos_profile=STREAM)

    other, right = "x/msg/Other", "x/msg/Right"
    publishers = [info("/ns", "z", other), info("/ns", "own", right)]
    subscriptions = [info("/", "a", other), info("/b", "c", other), info("/", "d", right)]
    subscriptions.append(info("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_", other))
    graph = SimpleNamespace(
        resolve_topic_name=lambda name: f"/ns/{name}",
        get_fully_qualified_name=lambda: "/ns/own",
        get_publishers_info_by_topic={"/ns/topic": publishers, "/ns/no": publishers[:1]}.get,
        get_subscriptions_info_by_topic={"/ns/topic": subscriptions, "/ns/no": subscriptions}.get,
    )
    why = "receives nothing on /ns/topic: it expects x/msg/Other instead of x/msg/Right."
    assert incompatible_subscriptions(graph, "topic") == [f"/a {why}", f"/b/c {why}"]
    assert incompatible_subscriptions(graph, "no") == []
    assert known_nodes(subscriptions) == ["/a", "/b/c", "/d"]  # a drive that was killed is no second one
