"""Emergency stops of any quality of service are heard without an alarm; nodes of one name and two drives are named."""

from __future__ import annotations

import pytest
from ros_bench import ros_bench

PUBLISHER = "drive_id.nodes.trajectory_publisher"
RELIABLE, LATCHED, BEST_EFFORT = "reliable", "latched", "best effort"


@pytest.fixture
def ros():
    with ros_bench() as bench:
        yield bench


def profile(name):
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    options = {
        RELIABLE: {},
        LATCHED: {"durability": DurabilityPolicy.TRANSIENT_LOCAL},
        BEST_EFFORT: {"reliability": ReliabilityPolicy.BEST_EFFORT},
    }
    return QoSProfile(depth=1, **options[name])


@pytest.mark.parametrize("quality", [RELIABLE, LATCHED, BEST_EFFORT])
def test_an_emergency_stop_is_heard_and_nobody_is_alarmed(ros, quality):
    """Neither its own node, nor the one that listens, says that their qualities of service are incompatible."""
    from drive_id_msgs.srv import Command
    from rclpy.event_handler import PublisherEventCallbacks
    from std_msgs.msg import Bool

    alarms = []
    events = PublisherEventCallbacks(incompatible_qos=alarms.append, use_default_callbacks=False)
    stop = ros.node.create_publisher(Bool, "/emergency_stop", profile(quality), event_callbacks=events)
    stop.publish(Bool(data=True))  # pressed before anybody listens: a latched one is heard all the same
    node = ros.start(PUBLISHER)
    ros.wait(lambda: "Ready" in node.output and stop.get_subscription_count() > 0, "the node that listens")

    def pressed():
        if quality != LATCHED:
            stop.publish(Bool(data=True))
        return "(/emergency_stop) is pressed" in ros.call(Command, "/trajectory_publisher/clear_fault").message

    ros.wait(pressed, "the press")
    assert not alarms
    assert "incompatible" not in node.output.lower()


def health(ros):
    """Return what each node says of itself, by its name, as a list that grows."""
    from diagnostic_msgs.msg import DiagnosticArray

    said = {}

    def hear(array):
        for status in array.status:
            said.setdefault(status.name, []).append(
                " ".join([status.message, *(v.value for v in status.values if v.key.startswith("also"))])
            )

    ros.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 100)
    return said


def test_two_nodes_of_one_name_are_named(ros):
    """What both keep on latched topics overwrites each other: one that idles hides the trip of the other one."""
    said = health(ros)
    ros.host(PUBLISHER)
    ros.wait(lambda: said.get("/trajectory_publisher"), "diagnostics")
    assert "Another node" not in said["/trajectory_publisher"][-1]
    twin = ros.host(PUBLISHER)
    words = "Another node is named /trajectory_publisher as well"
    ros.wait(lambda: words in said["/trajectory_publisher"][-1], "the twin")
    twin.end()
    said.clear()
    ros.wait(lambda: words not in said.get("/trajectory_publisher", [words])[-1], "the end of the twin")


@pytest.mark.cases
@pytest.mark.parametrize("module", [PUBLISHER, "drive_id.nodes.identification", "drive_id.nodes.recorder"])
def test_a_second_drive_is_named_though_it_is_silent(ros, module, tmp_path):
    """The drive and the idle publisher are nodes of two names."""
    from drive_id_msgs.msg import PhaseCurrents

    from drive_id.nodes.support.qos import STREAM

    said = health(ros)
    own = {} if module == PUBLISHER else {"data_directory": str(tmp_path)}
    name = "/" + module.rpartition(".")[2]
    ros.host(module, parameters=own)
    ros.host("drive_id.nodes.bench_simulator")
    ros.wait(lambda: len(said.get(name, [])) > 1, "diagnostics")
    assert "both publish" not in said[name][-1]
    rival = ros.node.create_publisher(PhaseCurrents, "/phase_currents", STREAM)
    ros.wait(lambda: "both publish /phase_currents" in said[name][-1], "the second drive")
    assert "/bench_simulator" in said[name][-1]
    assert "/test_bench" in said[name][-1]
    ros.node.destroy_publisher(rival)
    ros.wait(lambda: "both publish" not in said[name][-1], "its end")
