"""The client against nodes that answer as they are told: real services in this process, no drive."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from types import SimpleNamespace

import pytest
from ros_bench import own_domain, require_ros

from drive_id.errors import ConfigurationError, ExperimentError

NODES = ("trajectory_publisher", "recorder", "identification")


class Nodes:
    """The three nodes in a thread, with scripted states of the trajectory and parameters."""

    def __init__(self, domain):
        from diagnostic_msgs.msg import DiagnosticArray
        from drive_id_msgs.srv import Command, Identify, StartExperiment, StartRecording, StopRecording
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.parameter import Parameter
        from std_msgs.msg import Empty

        from drive_id.nodes.support.middleware import fast_dds

        self.begin()
        self.context = Context()
        with fast_dds():
            self.context.init(args=[], domain_id=domain)
            made = {name: Node(name, namespace="/drive", context=self.context) for name in NODES}
        self.nodes = made
        for name, value in (("trajectory_publisher", 100.0), ("identification", 100.0)):
            made[name].declare_parameter("i_max", value)
        publisher, recorder, identification = made.values()
        self.parameter = Parameter
        for kind, name in (
            (StartExperiment, "start_experiment"), (Command, "stop_experiment"), (Command, "clear_fault"),
        ):  # fmt: skip
            publisher.create_service(kind, f"~/{name}", self.answer(f"trajectory_publisher/{name}"))
        recorder.create_service(StartRecording, "~/start", self.answer("recorder/start", uri="/data/bag"))
        recorder.create_service(
            StopRecording, "~/stop", self.answer("recorder/stop", uri="/data/bag", samples=7, dropped=2, duration=0.5)
        )
        identification.create_service(Command, "~/reset", self.answer("identification/reset"))
        identification.create_service(Identify, "~/identify", self.answer("identification/identify", output="/out"))
        publisher.create_subscription(Empty, "~/heartbeat", lambda _: self.beats.append(time.monotonic()), 10)
        self.diagnostics = publisher.create_publisher(DiagnosticArray, "/diagnostics", 10)
        publisher.create_timer(0.05, self.report)
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in made.values():
            self.executor.add_node(node)
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()

    def begin(self):
        """Forget what a test has told and called."""
        self.calls, self.refused, self.slow, self.beats = [], set(), {}, []
        self.script, self.state = ["running", "running", "idle"], "idle"
        self.waiting, self.playing = False, iter(())

    def answer(self, name, **fields):
        def callback(_, response):
            self.calls.append(name)
            time.sleep(self.slow.get(name, 0.0))
            response.success, response.message = name not in self.refused, f"{name} says so."
            for field, value in fields.items():
                setattr(response, field, value)
            if name == "trajectory_publisher/start_experiment" and response.success:
                self.playing = iter(self.script)
            return response

        return callback

    def report(self):
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        self.state = next(self.playing, self.state)
        level = DiagnosticStatus.WARN if self.waiting else DiagnosticStatus.OK
        values = [KeyValue(key="state", value=self.state), KeyValue(key="duration [s]", value="1.5")]
        self.diagnostics.publish(
            DiagnosticArray(
                status=[
                    DiagnosticStatus(name=f"/drive/{name}", level=level, message=f"{name} reports.", values=values)
                    for name in NODES
                ]
            )
        )

    def close(self):
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
    return all_nodes


@contextlib.contextmanager
def client(**options):
    from drive_id.ros import Bench

    with Bench("/drive", timeout=20.0, **options) as bench:
        yield bench


def run_all(timeout=30.0, **options):
    with client(**options) as bench:
        bench.wait_until_ready(timeout)
        bench.run_experiment()


def test_an_experiment_calls_the_services_in_order(nodes):
    told = []
    with client(tell=told.append) as bench:
        bench.wait_until_ready(30.0)
        recording = bench.run_experiment("bag")
        result = bench.identify([recording.uri], "joint")
        assert bench.stop() == []  # nothing of it is under way any more
    assert nodes.calls == [
        "recorder/start", "identification/reset", "trajectory_publisher/start_experiment", "recorder/stop",
        "identification/identify",
    ]  # fmt: skip
    assert (recording.uri, recording.samples, recording.dropped, recording.duration) == ("/data/bag", 7, 2, 0.5)
    assert (result.output, result.message) == ("/out", "identification/identify says so.")


def test_heartbeats_come_as_long_as_an_experiment_runs(nodes):
    """The publisher ramps down without them: nothing runs on when this process is gone."""
    nodes.script = ["running"] * 40 + ["idle"]
    with client() as bench:
        bench.wait_until_ready(30.0)
        bench.run_experiment()
        assert len(nodes.beats) >= 5
        assert max(b - a for a, b in itertools.pairwise(nodes.beats)) < 1.5
    time.sleep(0.5)
    nodes.beats.clear()
    time.sleep(0.5)
    assert nodes.beats == []


def test_a_trajectory_that_trips_leaves_the_drive_at_rest(nodes):
    nodes.script = ["running", "tripped"]
    with pytest.raises(ExperimentError, match=r"The trajectory was stopped: trajectory_publisher reports\."):
        run_all()
    assert nodes.calls[-2:] == ["trajectory_publisher/stop_experiment", "recorder/stop"]


def test_a_fault_is_cleared_or_it_is_told_why_not(nodes):
    with client() as bench:
        bench.wait_until_ready(30.0)
        assert bench.clear_fault() == "trajectory_publisher/clear_fault says so."
        nodes.refused = {"trajectory_publisher/clear_fault"}
        with pytest.raises(ExperimentError, match=r"clear_fault: trajectory_publisher/clear_fault says so\."):
            bench.clear_fault()
    assert nodes.calls == ["trajectory_publisher/clear_fault"] * 2


def test_a_refusal_is_passed_on_and_the_recording_is_closed(nodes):
    nodes.refused = {"trajectory_publisher/start_experiment"}
    with pytest.raises(ExperimentError, match=r"^trajectory_publisher/start_experiment: .* says so\."):
        run_all()
    assert nodes.calls[-1] == "recorder/stop"


def test_a_recorder_that_is_busy_for_another_client_is_left_alone(nodes):
    nodes.refused = {"recorder/start"}
    with pytest.raises(ExperimentError, match=r"recorder/start: recorder/start says so\."):
        run_all()
    assert nodes.calls == ["recorder/start"]


def test_an_error_that_the_block_catches_leaves_the_drive_at_rest_too(nodes):
    nodes.script = ["running", "tripped"]
    with client() as bench:
        bench.wait_until_ready(30.0)
        with contextlib.suppress(ExperimentError):
            bench.run_experiment()
    assert nodes.calls[-2:] == ["trajectory_publisher/stop_experiment", "recorder/stop"]


def test_a_terminal_that_is_gone_does_not_keep_the_drive_from_rest(nodes):
    nodes.script = ["running"] * 400
    nodes.slow = {"trajectory_publisher/stop_experiment": 1.5}

    def tell(_):
        if "trajectory_publisher/start_experiment" in nodes.calls:
            raise BrokenPipeError("the terminal is gone")

    with pytest.raises(BrokenPipeError):
        run_all(tell=tell)
    assert nodes.calls[-2:] == ["trajectory_publisher/stop_experiment", "recorder/stop"]


def test_nodes_that_do_not_fit_are_refused_before_current_flows(nodes):
    nodes.nodes["identification"].set_parameters([nodes.parameter("i_max", value=60.0)])
    with (
        pytest.raises(ExperimentError, match="drives up to 100 A and identification maps up to 60 A"),
        client() as bench,
    ):
        bench.wait_until_ready(30.0)
    nodes.nodes["identification"].set_parameters([nodes.parameter("i_max", value=100.0)])
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
    with pytest.raises(ExperimentError, match="2 nodes publish /drive/resolver: leave one drive"):
        run_all()
    for node, publisher in zip(two, publishers, strict=True):
        node.destroy_publisher(publisher)


def test_a_silent_drive_is_told(nodes):
    nodes.waiting = True
    with pytest.raises(ExperimentError, match=r"After 8 s, still waiting for the drive: trajectory_publisher reports"):
        run_all(8.0)


def test_progress_counts_the_trajectory(nodes):
    nodes.script = ["running"] * 40 + ["idle"]
    told = []
    with client(tell=told.append) as bench:
        bench.wait_until_ready(30.0)
        bench.run_experiment()
    assert any(SimpleNamespace(**vars(one)).duration == 1.5 for one in told)
