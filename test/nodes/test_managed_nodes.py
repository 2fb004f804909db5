"""The lifecycle of ``identification`` and ``signal_bridge``, and many requests at once."""

from __future__ import annotations

from collections import Counter
from functools import partial

import pytest
from recorder_blocks import PERIOD, TOPICS
from ros_bench import DEADLINE, ros_bench
from test_recorder_node import Bench

REQUESTS = 200


@pytest.fixture
def ros():
    with ros_bench() as bench:
        yield bench


def settings(ros, **further):
    return {"data_directory": str(ros.folder), "output_directory": str(ros.folder / "out"), **further}


def test_the_lifecycle_of_identification(ros):
    given = settings(ros, i_max=40.0, method="joint", autostart=False)
    ros.host("drive_id.nodes.identification", parameters=given)
    change, bench = partial(ros.change_state, "/identification"), Bench(ros)
    heard = bench.publishers[TOPICS[0].name].get_subscription_count
    assert (reply := ros.identify()).code == "inactive"
    assert "The node is unconfigured: configure and activate it" in reply.message
    assert not change("activate")
    assert change("configure")
    ros.wait(heard, "a subscription")
    bench.publish(10)
    assert (reply := ros.identify()).code == "inactive"
    assert "The node is inactive: activate it" in reply.message
    assert change("activate")
    assert "No sample" in ros.identify().message  # what came before is none of its
    bench.publish(30)
    ros.wait(lambda: ros.identify().report.samples_read >= 3000, "the samples of the active node")
    assert change("deactivate")
    assert ros.identify().code == "inactive"
    assert change("cleanup")
    ros.wait(lambda: not heard(), "no subscription")
    assert change("configure")
    assert change("activate")
    assert "No sample" in ros.identify().message
    assert change("shutdown")
    assert (reply := ros.identify()).code == "inactive"
    assert "The node was shut down and stays so: start its process again." in reply.message


def test_a_lifecycle_manager_brings_all_nodes_up_and_down(ros):
    """By the services and numbers that such managers use: all are configured, then activated, and back in reverse."""
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import GetState

    nodes = ("recorder", "identification", "trajectory_publisher")
    for node in nodes:
        given = {} if node == "trajectory_publisher" else {"data_directory": str(ros.folder)}
        given |= {"output_directory": str(ros.folder / "out")} if node == "identification" else {}
        ros.host(f"drive_id.nodes.{node}", parameters=given | {"autostart": False})
    for number, state, order in (
        (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE, nodes),
        (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE, nodes),
        (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE, nodes[::-1]),
        (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED, nodes[::-1]),
        (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, State.PRIMARY_STATE_FINALIZED, nodes[::-1]),
    ):
        for node in order:
            assert ros.change_state(f"/{node}", number=number)
            assert ros.call(GetState, f"/{node}/get_state").current_state.id == state


def test_a_request_under_way_ends_with_the_activity(ros):
    from drive_id_msgs.srv import Identify

    ros.host("drive_id.nodes.identification", parameters=settings(ros, i_max=40.0))
    bench = Bench(ros)
    bench.publishers.pop(TOPICS[3].name)
    bench.wait_for_listeners()
    bench.publish(300)
    bench.wait_until_delivered()
    future = ros.call_async(Identify, "/identification/identify")
    assert ros.change_state("/identification", "deactivate")
    ros.wait(future.done, "a reply")
    assert not future.result().success  # these samples make no map anyway
    assert future.result().code in {"inactive", "coverage", "standstill", "unexplained", "data"}


def test_the_lifecycle_of_the_bridge(ros):
    from drive_id_msgs.msg import PhaseCurrents

    file = ros.folder / "signals.yaml"
    section = f"fields: [a, b, c], sample_period: {PERIOD}, first_sample: first_sample"
    file.write_text(
        f"currents: {{topic: in/phase_currents, {section}}}\nvoltages: {{topic: in/phase_voltages, {section}}}\n"
        f"resolver: {{topic: in/resolver, angle: angle, speed: speed, sample_period: {PERIOD}}}\n"
    )
    received = []
    kept = ros.node.create_subscription(PhaseCurrents, "/phase_currents", received.append, 1000)
    given = {"signals": str(file), "autostart": False}
    ros.host("drive_id.nodes.signal_bridge", parameters=given)
    change, bench = partial(ros.change_state, "/signal_bridge"), Bench(ros, namespace="/in")
    bench.publishers = {topic.name: bench.publishers[topic.name] for topic in TOPICS[:3]}
    assert change("configure")
    bench.wait_for_listeners()
    bench.publish(30)
    bench.wait_until_delivered()
    assert change("activate")  # by then, it has seen what came before
    assert received == []

    def translated():
        bench.publish(1)
        return received

    ros.wait(translated, "translated blocks")
    assert change("deactivate")
    assert change("cleanup")
    ros.wait(lambda: not any(p.get_subscription_count() for p in bench.publishers.values()), "no subscription")
    ros.node.destroy_subscription(kept)


def test_each_of_many_requests_at_once_is_answered(ros):
    """With the default queue of ten, a client on a busy machine may lose some replies."""
    from drive_id_msgs.srv import Identify, StartExperiment, StartRecording
    from rclpy.qos import qos_profile_services_default as default

    from drive_id.nodes.support.qos import SERVICE

    ros.host("drive_id.nodes.identification", parameters=settings(ros, i_max=40.0))
    ros.host("drive_id.nodes.recorder", parameters={"data_directory": str(ros.folder)})
    ros.host("drive_id.nodes.trajectory_publisher")
    for kind, name, usual, profile, least in (
        (Identify, "/identification/identify", "busy", SERVICE, REQUESTS),
        (StartRecording, "/recorder/start", "busy", default, 0.5 * REQUESTS),
        (StartExperiment, "/trajectory_publisher/start_experiment", "fault", default, 0.5 * REQUESTS),  # of no drive
    ):
        ros.call(kind, name)  # answered: the services know each other
        client = ros.node.create_client(kind, name, qos_profile=profile)
        ros.wait(client.service_is_ready, name)
        futures = [client.call_async(kind.Request()) for _ in range(REQUESTS)]
        ros.wait(lambda: sum(f.done() for f in futures) >= least, "all replies", DEADLINE)  # noqa: B023
        codes = Counter(future.result().code for future in futures if future.done())
        assert set(codes) <= {usual, "empty_topic"}
        assert codes[usual] >= least - 20
        ros.node.destroy_client(client)


def test_the_quality_of_service_of_outputs_is_a_parameter_and_that_of_safety_is_not():
    from rclpy.qos import ReliabilityPolicy

    with ros_bench() as ros:
        data = {"data_directory": str(ros.folder), "output_directory": str(ros.folder / "out")}
        given = {"qos_overrides./flux_map.publisher.reliability": "best_effort"}
        node = ros.host("drive_id.nodes.identification", parameters=data | given).node
        (info,) = ros.node.get_publishers_info_by_topic("/flux_map")
        assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        declared = {name.split(".")[1] for name in node._parameters if name.startswith("qos_overrides.")}
        assert declared == {"/flux_map", "/flux_map_points", "/fit_report", "/operating_point"}
        publisher = ros.host("drive_id.nodes.trajectory_publisher").node
        assert not [name for name in publisher._parameters if name.startswith("qos_overrides.")]
