"""The action ``~/experiment`` with all nodes and a simulated drive: every goal ends with its code, at zero current."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from action_goal import experiment
from live_drive import LIGHT
from ros_bench import require_ros, ros_bench

from drive_id.files.storage.bag import open_bag
from drive_id.fitting.sources import read_bag

CLIENT = Path(__file__).parents[2] / "examples" / "experiment_client.py"
NODES = "drive_id.nodes."
NAME = "/experiment/experiment"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/msg/GoalStatus
I_MAX = 60.0
ENDED = 20.0
"""Time within which a goal ends that is cancelled, trips or is refused, s: 15 s, and some for a busy computer."""
PUBLISHER = {
    "i_max": I_MAX, "frequency_d": 7.3, "frequency_q": 2.3, "duration": 1.5, "slew_rate": 2e4, "lead_time": 2.0,
    "watch_timeout": 30.0, "clock_offset": 30.0, "follow_band": 300.0,
}  # fmt: skip
"""A short experiment, patient enough for a busy machine."""


class Suite:
    """All nodes, a client of the action, and what the drive measures and the nodes say.

    ``begin`` hosts a node in the test's process, or starts it as one of its own.
    """

    def __init__(self, ros, begin):
        from drive_id_msgs.msg import FitReport, PhaseCurrents, PublisherState, RecorderState
        from rclpy.action import ActionClient
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import Bool

        self.ros, self.kind = ros, ActionClient
        self.data = ros.folder / "data"
        data = {"data_directory": str(self.data)}
        fit = {"output_directory": str(ros.folder / "results"), "i_max": I_MAX, "refit_share": 0.0, "method": "joint"}
        begin(NODES + "recorder", parameters=data)
        begin(NODES + "identification", parameters=data | fit)
        begin(NODES + "trajectory_publisher", parameters=PUBLISHER)
        drive = {"machine": "ipm", "i_max": I_MAX, "speeds": [500.0], "current_noise": 0.001, "ramp_time": 0.2}
        begin(NODES + "bench_simulator", parameters=drive | LIGHT)
        self.experiment = begin("drive_id.ros.experiment", parameters={"timeout": 40.0, "speed_time": 20.0})
        self.currents, self.states, self.recordings, self.reports = [], [], [], []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.button = ros.node.create_publisher(Bool, "emergency_stop", latched)
        ros.node.create_subscription(
            PhaseCurrents, "phase_currents", lambda m: self.currents.append(np.abs(m.a).max()), 1000
        )
        ros.node.create_subscription(PublisherState, "/trajectory_publisher/state", self.states.append, latched)
        ros.node.create_subscription(RecorderState, "/recorder/state", self.recordings.append, latched)
        ros.node.create_subscription(FitReport, "/fit_report", self.reports.append, latched)

    @contextmanager
    def connected(self):
        """Give a client of the action, in a node of its own, both of which are gone afterwards."""
        from drive_id_msgs.action import Experiment
        from rclpy.node import Node

        node = Node("client", context=self.ros.node.context)
        self.ros.executor.add_node(node)
        client = self.kind(node, Experiment, NAME)
        try:
            yield client
        finally:
            self.ros.forget(node)
            client.destroy()
            node.destroy_node()

    def recording(self):
        return self.recordings[-1]

    def at_zero(self):
        return max(self.currents[-20:], default=0.0) < 0.05 * I_MAX

    def clear(self):
        from drive_id_msgs.srv import Command

        def cleared():
            return self.ros.call(Command, "/trajectory_publisher/clear_fault").success

        self.ros.wait(cleared, "a cleared fault")

    def press(self, pressed):
        from std_msgs.msg import Bool

        self.button.publish(Bool(data=pressed))

    def set_speed(self, rpm):
        assert self.ros.set_parameters("/bench_simulator", speeds=[rpm]).successful


@pytest.fixture(scope="module")
def suite():
    require_ros()
    with ros_bench() as bench:
        yield Suite(bench, bench.host)


@pytest.fixture
def goal(suite):
    """A function that sends a goal, first to a publisher without a fault, whatever the test before has left."""
    suite.clear()
    with suite.connected() as client:
        yield partial(experiment, suite.ros, client)


@pytest.mark.essential
@pytest.mark.slow  # a whole experiment in real time
def test_a_goal_records_and_identifies_and_tells_how_far_it_is(suite, goal):
    ran = goal(name="whole", i_max=50.0, duration=2.0, serial="0017", operator_name="Ann", trajectory="lissajous")
    status, result = ran.wait()
    assert (status, result.success, result.code) == (SUCCEEDED, True, "ok"), result.message
    assert result.bags == [str(suite.data / "whole")]
    assert result.dropped == 0
    assert result.duration > 2.0
    assert result.session == suite.states[-1].session
    peak = np.abs(read_bag(Path(result.bags[0])).i_abc).max()
    assert 45.0 < peak < 55.0, "the goal's radius, not the node's"
    found = result.flux_map
    assert (found.i_max, found.method) == (50.0, "joint")
    assert result.report.coverage > 0.5
    phases = list(dict.fromkeys(entry.phase for entry in ran.feedback))
    assert phases == ["waiting", "trajectory", "stopping", "identifying"]
    shares = [entry.share for entry in ran.feedback]
    assert shares == sorted(shares)
    assert any(0.0 < entry.elapsed <= entry.duration == 2.0 for entry in ran.feedback)
    assert 0.3 < np.median(np.diff(ran.times)) < 1.5, "every 0.5 s, later on a busy machine"
    assert all(math.isnan(entry.resistance) for entry in ran.feedback), "no fits in the background here"
    suite.ros.wait(suite.at_zero, "zero current")
    known = (found.serial, list(found.recordings), found.session, found.folder)
    assert known == ("0017", list(result.bags), result.session, result.output)
    suite.ros.wait(lambda: suite.reports, "the report")
    report = suite.reports[-1]
    assert (report.folder, report.stamp, report.mad_d) == (result.output, found.header.stamp, result.report.mad_d)
    results_can_be_asked_for(suite, result)
    with open_bag(Path(result.bags[0])) as bag:
        assert {"/drive_status", "/trajectory_publisher/state"} <= set(bag.topics)
    suite.ros.wait(lambda: suite.recording().state == "idle", "the end of the recording")
    state = suite.recording()
    assert (state.uri, state.samples, state.dropped, state.restarts) == (result.bags[0], result.samples, 0, 0)
    assert state.bytes > 1e5
    assert state.free_space > 1e6
    assert {each.state for each in suite.recordings} >= {"recording", "idle"}


def results_can_be_asked_for(suite, result):
    from drive_id_msgs.srv import GetResult, ListRecordings, ListResults

    asked = partial(suite.ros.call, GetResult, "/identification/get_result")
    for fields in ({}, {"serial": "0017"}, {"folder": result.output}, {"folder": Path(result.output).name}):
        again = asked(**fields)
        assert (again.success, again.output) == (True, result.output), again.message
        assert again.flux_map.header == result.flux_map.header
        assert again.flux_map.psi_d == result.flux_map.psi_d
        assert (again.flux_map.session, again.flux_map.recordings) == (result.session, result.bags)
        assert (again.report.samples_used, again.report.stamp) == (result.report.samples_used, result.report.stamp)
    assert asked(serial="0018").code == "result"
    assert asked(folder="/etc").code == "configuration"
    listed = suite.ros.call(ListResults, "/identification/list_results", serial="0017")
    assert (listed.success, listed.total) == (True, 1)
    (info,) = listed.results
    assert (info.folder, info.operator_name, info.method) == (result.output, "Ann", "joint")
    assert (info.session, info.recordings, info.i_max) == (result.session, result.bags, 50.0)
    assert info.resistance == pytest.approx(result.flux_map.resistance)
    assert suite.ros.call(ListResults, "/identification/list_results", machine="other").total == 0
    recordings = suite.ros.call(ListRecordings, "/recorder/list_recordings", name="whole")
    (recording,) = recordings.recordings
    assert (recording.name, recording.uri, recording.error) == ("whole", result.bags[0], "")
    assert recording.duration == pytest.approx(result.duration, abs=0.5)
    assert recording.messages > 100


@pytest.mark.slow  # an experiment in real time
def test_a_cancelled_goal_ramps_to_zero_and_keeps_the_bag(suite, goal):
    ran = goal(name="cancelled", duration=60.0)
    ran.wait_for("trajectory")
    suite.ros.wait(lambda: not suite.at_zero(), "current")
    other = goal()
    assert other.wait(ENDED)[1].code == "busy"
    ran.handle.cancel_goal_async()
    status, result = ran.wait(ENDED)
    assert (status, result.success, result.code) == (CANCELED, False, "cancelled"), result.message
    assert suite.at_zero()
    assert (suite.states[-1].state, suite.states[-1].completed) == ("idle", False)
    assert result.bags == [str(suite.data / "cancelled")]
    samples = read_bag(Path(result.bags[0]))
    assert np.abs(samples.i_abc[-100:]).max() < 0.05 * I_MAX, "the ramp is in the bag"
    assert not result.output


@pytest.mark.slow  # an experiment in real time
def test_a_trip_and_a_latched_one_end_a_goal(suite, goal):
    ran = goal(name="tripped", duration=60.0)
    ran.wait_for("trajectory")
    suite.ros.wait(lambda: not suite.at_zero(), "current")
    suite.press(True)
    status, result = ran.wait(ENDED)
    assert (status, result.code) == (ABORTED, "tripped"), result.message
    assert "emergency stop" in result.message
    assert read_bag(Path(result.bags[0])) is not None
    suite.press(False)
    latched = goal()
    assert latched.wait(ENDED)[1].code == "tripped"
    suite.clear()
    suite.ros.wait(suite.at_zero, "zero current")


@pytest.mark.slow  # an experiment in real time
def test_half_an_experiment_is_not_ok(suite, goal):
    from drive_id_msgs.srv import Command

    ran = goal(name="half", duration=60.0, method="none")
    ran.wait_for("trajectory")
    suite.ros.wait(lambda: not suite.at_zero(), "current")
    assert suite.ros.call(Command, "/trajectory_publisher/stop_experiment").success
    status, result = ran.wait(ENDED)
    assert (status, result.code) == (ABORTED, "stopped"), result.message
    assert result.bags


@pytest.mark.slow  # an experiment in real time
def test_goals_whose_client_is_gone_or_sends_no_heartbeats_end(suite):
    with suite.connected() as client:
        lost = experiment(suite.ros, client, name="lost", duration=60.0)
        lost.wait_for("trajectory")
        suite.ros.wait(lambda: not suite.at_zero(), "current")
    suite.ros.wait(lambda: suite.states[-1].state == "idle", "the end of a goal without a client", ENDED)
    suite.ros.wait(suite.at_zero, "zero current")
    suite.ros.wait(lambda: not suite.experiment.node._requests.busy, "the end of the goal", ENDED)
    with suite.connected() as client:
        silent = experiment(suite.ros, client, duration=60.0, lease_time=2.0)
        assert silent.wait(ENDED + 2.0)[1].code == "no_heartbeat"


@pytest.mark.slow  # several goals of a drive in real time
def test_goals_that_are_not_possible_are_refused(goal):
    for code, fields in (
        ("limit", {"i_max": 2 * I_MAX}),
        ("configuration", {"trajectory": "zigzag"}),
        ("configuration", {"name": "../elsewhere"}),
        ("configuration", {"i_max": math.inf}),
        ("configuration", {"i_max": math.nan}),
        ("configuration", {"signals": "/no/such.yaml"}),
    ):
        status, result = goal(**fields).wait(ENDED)
        assert (status, result.code, result.output) == (ABORTED, code, ""), result.message
        assert (list(result.bags), result.session) == ([], 0), "nothing has moved"
        assert not result.message.endswith("..")


@pytest.mark.slow  # two experiments in real time
def test_a_trajectory_at_each_speed_in_order(suite, goal):
    speeds = [rpm * 4 * 2 * math.pi / 60 for rpm in (300.0, 400.0)]  # 4 pole pairs
    ran = goal(name="speeds", speeds=speeds, method="none")
    for rpm, speed in zip((300.0, 400.0), speeds, strict=True):
        suite.ros.wait(lambda s=speed: any(f"for {s:.1f} rad/s" in f.waits_for for f in ran.feedback), "the wait")
        suite.set_speed(rpm)
    status, result = ran.wait()
    assert (status, result.code) == (SUCCEEDED, "ok"), result.message
    assert [Path(bag).name for bag in result.bags] == ["speeds_1", "speeds_2"]
    during = [entry.share for entry in ran.feedback if entry.phase == "trajectory"]
    assert during == sorted(during)
    assert max(during) - min(during) > 0.4, "each trajectory is a part of the whole"
    for bag, speed in zip(result.bags, speeds, strict=True):
        assert np.median(read_bag(Path(bag)).speed) == pytest.approx(speed, rel=0.02)
    never = goal(speeds=[1e4])
    never.wait_for("waiting")
    never.handle.cancel_goal_async()
    assert never.wait(ENDED)[1].code == "cancelled"


class Client:
    """The client of examples/ as a process."""

    def __init__(self, suite, *arguments):
        self.ros, self.log = suite.ros, suite.ros.folder / f"client_{time.monotonic_ns()}.log"
        with self.log.open("w") as stream:
            self.process = subprocess.Popen(
                [sys.executable, str(CLIENT), *arguments], stdout=stream, stderr=subprocess.STDOUT,
                env=suite.ros.environment | {name: os.environ[name] for name in ("ROS_DOMAIN_ID",)},
            )  # fmt: skip

    def wait_for(self, text):
        self.ros.wait(lambda: text in self.log.read_text() or self.process.poll() is not None, text)
        assert text in self.log.read_text()

    def end(self, within=180.0):
        """Return exit code, and code, bags and folder as they are printed."""
        self.ros.wait(lambda: self.process.poll() is not None, f"the end of the client {self.log}", within)
        found = re.search(r"^(\w+): .*\nbags: (.*)\nresult: (.*)$", self.log.read_text(), re.MULTILINE)
        assert found, self.log.read_text()
        return self.process.returncode, *found.groups()


@pytest.mark.process
@pytest.mark.slow  # experiments in real time
def test_the_client_of_the_examples(suite):
    """Whole, cancelled, tripped, busy, and killed: each time the drive is at zero current afterwards."""

    def at_rest():
        suite.ros.wait(lambda: not suite.experiment.node._requests.busy, "the end of the goal", 2 * ENDED)
        suite.ros.wait(suite.at_zero, "zero current")

    whole = Client(suite, "0042", "2.0").end()
    assert whole[:2] == (0, "ok")
    assert Path(whole[3], "identification.json").exists()
    at_rest()
    cancelled = Client(suite, "0042", "60.0")
    cancelled.wait_for("trajectory: running")
    assert Client(suite).end()[:2] == (1, "busy")
    cancelled.process.send_signal(signal.SIGINT)
    ended = cancelled.end(ENDED)
    assert ended[:2] == (1, "cancelled")
    assert read_bag(Path(ended[2])) is not None
    at_rest()
    tripped = Client(suite, "0042", "60.0")
    tripped.wait_for("trajectory: running")
    suite.press(True)
    assert tripped.end(ENDED)[:2] == (1, "tripped")
    suite.press(False)
    suite.clear()
    at_rest()
    lost = Client(suite, "0042", "60.0")
    lost.wait_for("trajectory: running")
    lost.process.kill()
    lost.process.wait()
    killed = time.monotonic()
    suite.ros.wait(lambda: suite.states[-1].state == "idle", "the end of the trajectory", ENDED)
    assert time.monotonic() - killed < 8.0, "2 s of the lease, the ramp, and set-points ahead"
    at_rest()
