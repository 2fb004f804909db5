"""The conductor against nodes that answer as they are told: real services in this process, no drive."""

from __future__ import annotations

import contextlib
import itertools
import math
import threading
import time

import pytest
from ros_bench import own_domain, require_ros

from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.errors import ConfigurationError, ExperimentError

NODES = ("trajectory_publisher", "recorder", "identification")


class Nodes:
    """The three nodes in a thread, with scripted states of the trajectory and parameters."""

    def __init__(self, domain):
        from diagnostic_msgs.msg import DiagnosticArray
        from drive_id_msgs.action import Identify
        from drive_id_msgs.msg import PublisherState
        from drive_id_msgs.srv import Command, StartExperiment, StartRecording, StopRecording
        from drive_id_msgs.srv import Identify as Request
        from rclpy.action import ActionServer
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.parameter import Parameter
        from std_msgs.msg import Empty

        from drive_id.nodes.support.middleware import fast_dds
        from drive_id.nodes.support.parameters import declare_settings
        from drive_id.nodes.support.qos import LATCHED

        self.lock = threading.Lock()
        self.begin()
        self.context = Context()
        with fast_dds():
            self.context.init(args=[], domain_id=domain)
            given = ["--ros-args", "-p", "trajectory_publisher:i_max:=100.0"]
            made = {name: Node(name, namespace="/drive", context=self.context, cli_args=given) for name in NODES}
        self.nodes = made
        declare_settings(made["trajectory_publisher"], ExperimentSettings)
        made["identification"].declare_parameter("i_max", 100.0)
        publisher, recorder, identification = made.values()
        self.parameter = Parameter
        for kind, name in (
            (StartExperiment, "start_experiment"), (Command, "stop_experiment"), (Command, "clear_fault"),
        ):  # fmt: skip
            publisher.create_service(kind, f"~/{name}", self.answer(f"trajectory_publisher/{name}"))
        recorder.create_service(StartRecording, "~/start", self.answer("recorder/start", uri="/data/bag"))
        recorder.create_service(
            StopRecording, "~/stop", self.answer("recorder/stop", uri="/data/bag", samples=7, dropped=2, duration=1.5)
        )
        identification.create_service(Command, "~/reset", self.answer("identification/reset"))
        identification.create_service(Request, "~/check", self.check)
        self.server = ActionServer(identification, Identify, "~/identify", self.identify)
        publisher.create_subscription(Empty, "~/heartbeat", lambda _: self.beats.append(time.monotonic()), 10)
        recorder.create_subscription(Empty, "~/heartbeat", lambda _: self.recorded.append(self.calls[-1:]), 10)
        self.states = publisher.create_publisher(PublisherState, "~/state", LATCHED)
        self.diagnostics = publisher.create_publisher(DiagnosticArray, "/diagnostics", 10)
        publisher.create_timer(0.05, self.report)
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in made.values():
            self.executor.add_node(node)
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()

    def begin(self):
        """Forget what a test has told and called."""
        with self.lock:  # a report under way would bring the last state of the test before back
            self.calls, self.refused, self.slow, self.beats, self.recorded = [], set(), {}, [], []
            self.script, self.state = ["running", "running", "idle"], "idle"
            self.short = self.waiting = False
            self.limits = {"current limit of the drive [A]": "inf", "speed limit of the drive [rad/s]": "1000"}
            self.playing, self.session, self.reason, self.goal = iter(()), 0, "", None

    def answer(self, name, **fields):
        def callback(_, response):
            self.calls.append(name)
            time.sleep(self.slow.get(name, 0.0))
            response.success, response.message = name not in self.refused, f"{name} says so."
            response.code = "ok" if response.success else "limit"
            for field, value in fields.items():
                setattr(response, field, value)
            if self.short and name == "recorder/stop":
                response.duration = 0.5
            if name == "trajectory_publisher/start_experiment" and response.success:
                self.playing, self.session = iter(self.script), self.session + 1
                response.session = self.session
            return response

        return callback

    def check(self, request, response):
        self.asked = request
        response.success, response.code = not request.signals, "configuration" if request.signals else "ok"
        response.message = f"Signals file {request.signals} cannot be read." if request.signals else "Go on."
        return response

    def identify(self, goal):
        from drive_id_msgs.action import Identify

        self.calls.append("identification/identify")
        self.goal = goal.request
        if "identification/identify" in self.refused:
            goal.abort()
            return Identify.Result(code="coverage", message="Too little.")
        goal.succeed()
        return Identify.Result(success=True, code="ok", message="Identified.", output="/out")

    def report(self):
        """Publish the next state; whoever changes it holds the lock, so that no older one comes behind it."""
        with self.lock:
            self.state = next(self.playing, self.state)
            self._publish()

    def rest_in(self, state):
        """Be in a state, which also clients that come later are told first."""
        with self.lock:
            self.state = state
            self._publish()

    def _publish(self):
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
        from drive_id_msgs.msg import PublisherState

        completed = self.state == "idle" and not self.reason
        self.states.publish(
            PublisherState(
                state=self.state,
                session=self.session,
                duration=1.5,
                elapsed=0.3,
                completed=completed,
                reason=self.reason or f"{self.state}.",
            )
        )
        level = DiagnosticStatus.WARN if self.waiting else DiagnosticStatus.OK
        values = [KeyValue(key="coverage", value="0.25"), KeyValue(key="fit: resistance [ohm]", value="0.1")]
        values += [KeyValue(key=key, value=value) for key, value in self.limits.items()]
        self.diagnostics.publish(
            DiagnosticArray(
                status=[
                    DiagnosticStatus(name=f"/drive/{name}", level=level, message=f"{name} reports.", values=values)
                    for name in NODES
                ]
            )
        )

    def close(self):
        self.server.destroy()
        self.executor.shutdown()
        self.thread.join()
        for node in self.nodes.values():
            node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture(scope="module")
def domain():
    require_ros()
    number, lock = own_domain()
    yield number
    lock.close()


@pytest.fixture(scope="module")
def all_nodes(domain):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        made = Nodes(domain)
        yield made
        made.close()


@pytest.fixture
def nodes(all_nodes):
    all_nodes.begin()
    all_nodes.rest_in("idle")
    return all_nodes


@contextlib.contextmanager
def conductor(**options):
    from drive_id.ros.conductor import Conductor

    with Conductor("/drive", **{"timeout": 20.0, **options}) as made:
        yield made


def run_all(identify=None, run=None, **options):
    from drive_id.ros.conductor import Goal

    with conductor(**options) as made:
        return made.run(Goal("bag", run or {}, identify=identify)), made.recorded


def refused(code, text, **options):
    """Run an experiment that fails with a code and a sentence."""
    with pytest.raises(ExperimentError, match=text) as error:
        run_all(**options)
    assert error.value.code == code


def test_an_experiment_calls_the_nodes_in_order(nodes):
    result, recording = run_all({"method": "joint", "i_max": 40.0})
    assert nodes.calls == [
        "recorder/start", "identification/reset", "trajectory_publisher/start_experiment", "recorder/stop",
        "identification/identify",
    ]  # fmt: skip
    assert (recording.uris, recording.samples, recording.dropped, recording.duration) == (("/data/bag",), 7, 2, 1.5)
    assert (result.output, result.message) == ("/out", "Identified.")
    assert (list(nodes.goal.bags), nodes.goal.method, nodes.goal.i_max) == (["/data/bag"], "joint", 40.0)
    assert nodes.goal.session == recording.session == nodes.session


def test_a_fit_that_fails_has_its_own_code(nodes):
    nodes.refused = {"identification/identify"}
    refused("coverage", r"identification/identify: Too little\.", identify={})


def test_heartbeats_come_as_long_as_an_experiment_runs(nodes):
    """The publisher ramps down without them: nothing runs on when this process is gone."""
    nodes.script = ["running"] * 40 + ["idle"]
    run_all()
    assert len(nodes.beats) >= 5
    assert max(b - a for a, b in itertools.pairwise(nodes.beats)) < 1.5
    time.sleep(0.5)
    nodes.beats.clear()
    time.sleep(0.5)
    assert nodes.beats == []


def test_the_recorder_gets_heartbeats_from_its_start_to_its_stop(nodes):
    """They bind a recording to its client; one of somebody else they must not."""
    nodes.script = ["running"] * 40 + ["idle"]
    run_all({})
    during = nodes.calls[: nodes.calls.index("recorder/stop")]
    assert len(nodes.recorded) >= 3
    assert {name for (name,) in nodes.recorded} <= set(during)
    nodes.recorded.clear()
    nodes.refused = {"recorder/start"}
    refused("limit", "says so")
    assert nodes.recorded == []


def test_a_trajectory_that_trips_leaves_the_drive_at_rest(nodes):
    nodes.script = ["running", "tripped"]
    refused("tripped", r"The trajectory was stopped: tripped\.")
    assert nodes.calls[-2:] == ["trajectory_publisher/stop_experiment", "recorder/stop"]


def test_a_trajectory_that_somebody_stops_is_not_complete(nodes):
    nodes.script, nodes.reason = ["running", "ramp_out", "idle"], "Stopped on request."
    refused("stopped", r"The trajectory did not reach its end: Stopped on request\.")
    assert nodes.calls[-1] == "recorder/stop"


def test_a_recording_that_ends_early_is_not_complete(nodes):
    nodes.short = True
    refused("incomplete", r"/data/bag holds 0\.500 s of a trajectory of 1\.500 s")


def test_a_fault_is_cleared_or_it_is_told_why_not(nodes):
    with conductor() as made:
        made.wait_until_ready(30.0)
        assert made.clear_fault() == "trajectory_publisher/clear_fault says so."
        nodes.refused = {"trajectory_publisher/clear_fault"}
        with pytest.raises(ExperimentError, match=r"clear_fault: trajectory_publisher/clear_fault says so\."):
            made.clear_fault()
    assert nodes.calls == ["trajectory_publisher/clear_fault"] * 2


def test_a_refusal_is_passed_on_and_the_recording_is_closed(nodes):
    nodes.refused = {"trajectory_publisher/start_experiment"}
    refused("limit", r"^trajectory_publisher/start_experiment: .* says so\.")
    assert nodes.calls[-1] == "recorder/stop"


def test_a_recorder_that_is_busy_for_another_client_is_left_alone(nodes):
    nodes.refused = {"recorder/start"}
    refused("limit", r"recorder/start: recorder/start says so\.")
    assert nodes.calls == ["recorder/start"]


def test_a_terminal_that_is_gone_does_not_keep_the_drive_from_rest(nodes):
    nodes.script = ["running"] * 400
    nodes.slow = {"trajectory_publisher/stop_experiment": 1.5}

    def tell(_):
        if "trajectory_publisher/start_experiment" in nodes.calls:
            nodes.playing = iter(["idle"])
            raise BrokenPipeError("the terminal is gone")

    with pytest.raises(BrokenPipeError):
        run_all(tell=tell)
    assert nodes.calls[-2:] == ["trajectory_publisher/stop_experiment", "recorder/stop"]


def test_nodes_that_do_not_fit_are_refused_before_current_flows(nodes):
    nodes.nodes["identification"].set_parameters([nodes.parameter("i_max", value=60.0)])
    refused("experiment", "drives up to 100 A and identification maps up to 60 A")
    nodes.nodes["identification"].set_parameters([nodes.parameter("i_max", value=100.0)])
    nodes.nodes["trajectory_publisher"].set_parameters([nodes.parameter("repeat", value=0)])
    refused("configuration", "repeat of trajectory_publisher is 0")
    nodes.nodes["trajectory_publisher"].set_parameters([nodes.parameter("repeat", value=1)])
    assert nodes.calls == []


def test_a_goal_beyond_a_limit_is_told_at_once_and_one_within_runs(nodes):
    """Before anything is recorded or forgotten for it, and though the publisher warns of its own i_max."""
    refused("limit", r"i_max is 101 A, more than the parameter of trajectory_publisher, 100 A\.$", run={"i_max": 101.0})
    nodes.waiting = True
    refused("limit", "i_max is 101 A", run={"i_max": 101.0})
    nodes.limits |= {"current limit of the drive [A]": "20", "refused for": "limit"}
    refused("limit", r"i_max is 30 A, above the current_limit of the drive, 20 A\.$", run={"i_max": 30.0})
    refused("limit", "i_max is 100 A, above the current_limit")
    refused("configuration", "duration is nan", run={"i_max": 15.0, "duration": math.nan})
    assert nodes.calls == []
    run_all(run={"i_max": 15.0})
    assert nodes.calls[-1] == "recorder/stop"


def test_what_the_fit_would_refuse_is_told_before_current_flows(nodes):
    """By the node that fits: a signals file is on its machine."""
    refused("configuration", r"check: Signals file /no\.yaml cannot", identify={"signals": "/no.yaml", "u_dc": [540.0]})
    assert (list(nodes.asked.bags), list(nodes.asked.u_dc)) == (["bag"], [540.0])
    assert nodes.calls == []


def test_a_latched_trip_is_told_before_anything_is_recorded(nodes):
    nodes.rest_in("tripped")
    refused("tripped", "trajectory_publisher has tripped")
    assert nodes.calls == []


def test_a_namespace_that_is_none_is_told():
    require_ros()
    from drive_id.ros import Bench

    with pytest.raises(ConfigurationError, match=r"Invalid ROS arguments .*Invalid namespace"):
        Bench(namespace="bad-name")


def test_two_drives_in_one_namespace_are_refused(nodes):
    from drive_id_msgs.msg import Resolver

    two = list(nodes.nodes.values())[:2]
    publishers = [node.create_publisher(Resolver, "resolver", 1) for node in two]
    refused("experiment", "2 nodes publish /drive/resolver: leave one drive")
    for node, publisher in zip(two, publishers, strict=True):
        node.destroy_publisher(publisher)


def test_a_silent_drive_is_told(nodes):
    nodes.waiting = True
    refused("fault", r"After 4 s, still waiting for the drive: trajectory_publisher reports\.$", timeout=4.0)


def test_progress_counts_the_trajectory(nodes):
    nodes.script = ["running"] * 40 + ["idle"]
    told = []
    run_all(tell=told.append)
    during = [one for one in told if one.phase == "trajectory"]
    assert {(one.duration, one.elapsed, one.coverage, one.resistance) for one in during} >= {(1.5, 0.3, 0.25, 0.1)}
    assert during[-1].share == pytest.approx(0.2)
