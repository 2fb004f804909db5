"""The action ``~/identify``: progress, cancelling, the queue, clients that go, quota and restart."""

from __future__ import annotations

import shutil
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from action_goal import SentGoal
from test_identification_node import I_MAX

from drive_id.files.write.writer import write_recording

MODULE = "drive_id.nodes.identification"
NAME = "/identification/identify"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/msg/GoalStatus
LONG = tuple(f"long_{number}" for number in range(3))
"""Recordings that take seconds to accumulate."""
SOON = 10.0
"""s, for a second on a machine that does nothing else."""
STAGES = ["Waiting", "Reading", "Accumulating", "Solving", "Writing"]


@pytest.fixture(scope="module")
def parameters(ros, bag, simulation):
    data = ros.folder / "data"
    shutil.copytree(bag, data / "bag")
    for number, name in enumerate(LONG):
        later = simulation.samples.stamp + number * 10**10
        write_recording(data / name, replace(simulation.samples, stamp=later))
    return {
        "data_directory": str(data),
        "output_directory": str(ros.folder / "results"),
        "results_count": 3,
        "i_max": I_MAX,
    }


@pytest.fixture(scope="module")
def node(ros, parameters):
    return ros.host(MODULE, parameters=parameters)


def sent(ros, client, *bags, method="full"):
    """Send a goal."""
    from drive_id_msgs.action import Identify

    return SentGoal(ros, client, Identify.Goal(bags=list(bags), method=method))


@contextmanager
def action_client(node):
    from drive_id_msgs.action import Identify
    from rclpy.action import ActionClient

    client = ActionClient(node, Identify, NAME)
    try:
        yield client
    finally:
        client.destroy()


@pytest.fixture
def client(ros, node):  # noqa: ARG001  # whose client it is
    with action_client(ros.node) as client:
        yield client


def folders(ros):
    results = ros.folder / "results"
    return {path.name for path in results.iterdir() if not path.name.startswith(".last")}


def test_a_goal_gives_what_the_service_gives_and_tells_how_far_it_is(ros, client, fitted_in_full):
    goal = sent(ros, client, "bag")
    status, result = goal.wait()
    assert (status, result.success, result.code) == (SUCCEEDED, True, "ok"), result.message
    offline = fitted_in_full
    psi_d = np.array(result.flux_map.psi_d).reshape(offline.flux_map.psi_d.shape)
    np.testing.assert_allclose(psi_d, offline.flux_map.psi_d, rtol=0, atol=1e-6 * np.abs(psi_d).max())
    assert result.report.samples_read == offline.report.samples_read
    assert (Path(result.output) / "identification.json").exists()
    assert len(goal.feedback) > 3
    shares = [entry.progress for entry in goal.feedback]
    assert shares == sorted(shares)
    assert all(0 <= share <= 1 for share in shares)
    stages = [STAGES.index(entry.stage) for entry in goal.feedback]
    assert stages == sorted(stages)
    assert {"Solving"} < {entry.stage for entry in goal.feedback}
    assert all(entry.message.startswith(entry.stage) for entry in goal.feedback)


def test_a_bad_goal_is_aborted_with_the_code_of_the_service(ros, client):
    for bags, method, code in ((("missing",), "full", "not_a_bag"), (("bag",), "best", "configuration")):
        status, result = sent(ros, client, *bags, method=method).wait()
        assert (status, result.success, result.code) == (ABORTED, False, code)
        assert result.message == ros.identify(*bags, method=method).message


def test_a_cancelled_fit_frees_the_node_soon(ros, client):
    before = folders(ros)
    for stage in ("Accumulating", "Solving"):
        goal = sent(ros, client, *LONG)
        goal.wait_for(stage)
        start = time.monotonic()
        ros.wait(goal.handle.cancel_goal_async().done, "the answer to cancel")
        status, result = goal.wait()
        assert (status, result.success, result.code) == (CANCELED, False, "cancelled")
        assert ros.identify("missing").code == "not_a_bag"  # not busy
        assert time.monotonic() - start < SOON
    assert folders(ros) == before  # nothing is left behind, and nothing comes later
    assert ros.identify("bag", method="psm").success


def test_one_goal_waits_and_more_are_busy(ros, client):
    first, second, third = sent(ros, client, *LONG), *(sent(ros, client, "bag", method="psm") for _ in range(2))
    status, result = third.wait()
    assert (status, result.success, result.code) == (ABORTED, False, "busy")
    assert ros.identify("bag").code == "busy"
    second.wait_for("Waiting")
    first.handle.cancel_goal_async()
    assert first.wait()[0] == CANCELED
    status, result = second.wait()
    assert (status, result.flux_map.method) == (SUCCEEDED, "psm")


def test_a_client_that_vanishes_leaves_nothing_behind(ros, node):
    """Neither a fit nor a folder; a second goal of it waits, and goes, too."""
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    before, context = folders(ros), Context()
    context.init(args=[], domain_id=int(ros.environment["ROS_DOMAIN_ID"]))
    stranger = Node("stranger", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(stranger)
    ros.meanwhile.append(lambda: executor.spin_once(timeout_sec=0))
    with action_client(stranger) as client:
        goals = [sent(ros, client, *LONG) for _ in range(2)]
        goals[0].wait_for("Accumulating")
    ros.meanwhile.clear()
    executor.shutdown()
    stranger.destroy_node()
    context.try_shutdown()
    start = time.monotonic()
    ros.wait(lambda: ros.identify("missing").code == "not_a_bag", "a free node")
    assert time.monotonic() - start < SOON + 8.0
    ros.wait(lambda: "the request was cancelled" in node.output, "a word on it")
    assert folders(ros) == before


@pytest.mark.slow  # two nodes, one after the other
def test_the_quota_and_the_last_map_after_a_restart(ros, node, parameters):
    from drive_id_msgs.msg import FluxMap

    from drive_id.nodes.support.qos import LATCHED

    replies = [ros.identify("bag", method=method) for method in ("psm", "joint", "psm", "joint")]
    assert len(folders(ros)) == 3
    assert all(Path(reply.output).exists() == (number > 0) for number, reply in enumerate(replies))
    assert ros.identify("missing").code == "not_a_bag"  # an error leaves the last good map
    node.vanish()
    got = []
    subscription = ros.node.create_subscription(FluxMap, "/flux_map", got.append, LATCHED)
    again = ros.host(MODULE, parameters=parameters | {"time_limit": 0.01})
    ros.wait(lambda: got, "the last map")
    ros.node.destroy_subscription(subscription)
    last = replies[-1].flux_map
    assert (got[0].header, got[0].method, got[0].machine) == (last.header, last.method, last.machine)
    np.testing.assert_allclose(got[0].psi_d, last.psi_d)
    np.testing.assert_array_equal(got[0].inside, last.inside)
    assert list(got[0].warnings) == list(last.warnings)
    assert (got[0].coverage, got[0].i_max) == (last.coverage, last.i_max)
    ros.wait(lambda: "Published again" in again.output, "a word on it")
    reply = ros.identify("bag", method="full")
    assert (reply.success, reply.code) == (False, "time_limit")
    assert "time_limit, 0.01 s" in reply.message
