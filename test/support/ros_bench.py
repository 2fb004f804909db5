"""Nodes over DDS for the tests: in the test's own executor, or as processes where the process is the point."""

from __future__ import annotations

import contextlib
import gc
import importlib
import importlib.util
import inspect
import itertools
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

DEADLINE = 100.0
"""s, less than the time of a test; nothing takes as long, but machines are busy."""


DOMAINS = 101
"""That Fast DDS has ports for."""
STRIDE = 13
"""Domains from one bench of a process to its next: no multiple of it is one of ``DOMAINS``, a prime number."""
_calls = itertools.count()
HEARTBEATS = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles><data_writer profile_name="test" is_default_profile="true">
  <times><heartbeatPeriod><sec>0</sec><nanosec>20000000</nanosec></heartbeatPeriod></times>
</data_writer></profiles></dds>
"""
"""Profile of Fast DDS 2 (Jazzy) for the test's own node: readers acknowledge within 20 ms, not within the usual 3 s."""


def require_ros():
    """Skip without ROS 2, unless the caller has promised that it is there."""
    missing = [name for name in ("rclpy", "drive_id_msgs") if importlib.util.find_spec(name) is None]
    if missing:
        complaint = f"{' and '.join(missing)} not found: source a ROS 2 workspace with drive_id_msgs, or use make test"
        if os.environ.get("DRIVE_ID_REQUIRE_ROS") == "1":
            pytest.fail(complaint)
        pytest.skip(complaint)


def own_domain():
    """Return a domain that no other test on this machine has, and the socket that holds it as long as it is open.

    It is not one that this process had before, whose nodes may linger in the discovery under the names of new ones.
    """
    begin = os.getpid() + STRIDE * next(_calls)
    for attempt in range(DOMAINS):
        domain = 1 + (begin + attempt) % DOMAINS
        lock = socket.socket(socket.AF_UNIX)
        try:
            lock.bind(f"\0drive_id_test_domain_{domain}")  # abstract: gone with the process, whatever its end
        except OSError:
            lock.close()
        else:
            return domain, lock
    pytest.fail(f"All {DOMAINS} domains are taken")


class Process:
    """A node in a process of its own, its output in a file."""

    def __init__(self, module, arguments, environment, log):
        self.log = log
        self.expected_to_fail = False
        with log.open("w") as stream:
            self.popen = subprocess.Popen(
                [sys.executable, "-W", "error::RuntimeWarning", "-m", module, *arguments],
                env=environment, stdout=stream, stderr=subprocess.STDOUT,
            )  # fmt: skip

    @property
    def output(self):
        return self.log.read_text(errors="replace")

    @property
    def alive(self):
        return self.popen.poll() is None

    @property
    def has_failed(self):
        """Whether it has ended of itself, and wrongly; what a test kills, has not."""
        return not self.expected_to_fail and self.popen.poll() not in {None, 0, -signal.SIGKILL}

    def interrupt(self, within=DEADLINE, number=signal.SIGINT):
        """End the process and return its exit code and how long it took, s."""
        start = time.monotonic()
        self.popen.send_signal(number)
        self.popen.wait(within)
        return self.popen.returncode, time.monotonic() - start

    def end(self):
        """End it whatever it is doing, and return what was wrong with its end."""
        if self.popen.poll() is None:
            self.popen.send_signal(signal.SIGINT)
            try:
                self.popen.wait(DEADLINE)
            except subprocess.TimeoutExpired:
                self.popen.kill()
                self.popen.wait()
                return f"{self.log.name}: did not end on SIGINT within {DEADLINE} s"
        return f"{self.log.name}: exit code {self.popen.returncode}" if self.has_failed else ""


class Hosted:
    """A node in the test's own process and executor, with arguments as on a command line: an error in it is the test's.

    Its context is the test's, so both know each other at once.
    """

    has_failed = False

    def __init__(self, ros, module, arguments):
        from rclpy.node import Node

        self._ros = ros
        source = importlib.import_module(module)
        (kind,) = (
            kind
            for _, kind in inspect.getmembers(source, inspect.isclass)
            if issubclass(kind, Node) and kind.__module__ == module
        )
        begun = len(ros.logged)
        with _as_if_alone(ros.context, arguments):
            self.node = kind()
        self.name = self.node.get_fully_qualified_name()
        self._begun, self.alive = begun, True
        ros.executor.add_node(self.node)

    @property
    def output(self):
        """What it has logged, as far as it was heard."""
        mine = self.name[1:].replace("/", ".")
        return "\n".join(log.msg for log in self._ros.logged[self._begun :] if log.name == mine)

    def end(self):
        """End it as its process does when it is told to, and return that nothing was wrong."""
        if self.alive and hasattr(self.node, "close"):
            self.node.close()
        self.vanish()
        return ""

    def vanish(self):
        """End it without a word, as if its process were killed."""
        if self.alive:
            self.alive = False
            self._ros.forget(self.node)
            self.node.destroy_node()
            self.node = None
            gc.collect()  # it refers to itself, and would stay in the graph


class RosBench:
    """A node of the test's own in a domain of its own, the nodes that it hosts, and the processes it has started."""

    def __init__(self, folder):
        from rcl_interfaces.msg import Log
        from rclpy.context import Context

        from drive_id.nodes.support.middleware import fast_dds

        self.folder = Path(folder)
        domain, self._lock = own_domain()
        self._patch = pytest.MonkeyPatch()  # also for whatever makes a context of its own in this process
        for name in ("ROS_DOMAIN_ID", "DRIVE_ID_DOMAIN"):  # the latter for make
            self._patch.setenv(name, str(domain))
        self._patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self._patch.setenv("ROS_LOG_DIR", str(self.folder / "ros_log"))
        self.environment = os.environ | {"PYTHONFAULTHANDLER": "1"}
        profiles = self.folder / "heartbeats.xml"
        profiles.write_text(HEARTBEATS)
        with fast_dds(), pytest.MonkeyPatch.context() as patch:
            patch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(profiles))
            self.context = Context()
            self.context.init(args=[], domain_id=domain)
            self.node = _node_without_events("test_bench", self.context)
        self.executor = _executor(self.context)
        self.executor.add_node(self.node)
        self.processes, self.hosted = [], []
        self.logged = []
        self.node.create_subscription(Log, "/rosout", self.logged.append, 1000)
        self.meanwhile = []
        """Called again and again while the test waits."""
        self._clients = {}

    def host(self, module, *, parameters=None, files=(), namespace=""):
        """Make the node of a module in this process, with parameters as in :meth:`start`, and run it while waiting."""
        node = Hosted(self, module, _arguments(parameters, files, namespace))
        self.hosted.append(node)
        return node

    def start(self, module, *, parameters=None, files=(), arguments=(), namespace="", alone=False):
        """Start ``python -m module`` with parameter files, and with parameters by name that prevail over them.

        What is alone does not know of any other process, nor anybody of it.
        """
        log = self.folder / f"{module.rsplit('.', 1)[-1]}_{len(self.processes)}.log"
        environment = self.environment | ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"} if alone else {})
        given = [*_arguments(parameters, files, namespace), *arguments]
        process = Process(module, ["--ros-args", *given], environment, log)
        self.processes.append(process)
        return process

    def forget(self, node):
        """Let the executor have nothing to do for a node any longer, so that all of it can be destroyed."""
        self.executor.remove_node(node)
        for _ in range(2):  # the executor forgets the node, then makes the calls that were due before
            done = self.executor.create_task(lambda: None)
            while not done.done():
                self.executor.spin_once(timeout_sec=0.02)

    def wait(self, condition, what, timeout=DEADLINE):
        """Spin until the condition holds and return it; fail with the processes' output when it does not.

        ``what`` is awaited, as a text or as something whose text is made at the failure.
        """
        end = time.monotonic() + timeout
        while not (value := condition()):
            if any(process.has_failed for process in self.processes):
                pytest.fail(f"A node has given up or died while waiting for: {what}\n{self.outputs()}")
            if time.monotonic() > end:
                pytest.fail(f"Not within {timeout} s: {what}\n{self.outputs()}")
            for call in self.meanwhile:
                call()
            self.executor.spin_once(timeout_sec=0.02)
        return value

    def spin(self, seconds):
        """Let the nodes of this process go on for so long."""
        until = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() > until, "a while")

    def outputs(self):
        hosted = [f"--- {node.name}\n{node.output}" for node in self.hosted]
        return "\n".join([*hosted, *(f"--- {process.log.name}\n{process.output}" for process in self.processes)])

    def call_async(self, kind, name, /, timeout=DEADLINE, **fields):
        """Send a request when the service is there and return the future."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
            node = name.rpartition("/")[0]
            if node not in {hosted.name for hosted in self.hosted}:
                self._wait_until_known(node)
        client = self._clients[name]
        self.wait(client.service_is_ready, f"service {name}", timeout)
        return client.call_async(kind.Request(**fields))

    def forget_clients(self):
        """Make new clients from now on, for a node that was started again."""
        for client in self._clients.values():
            self.node.destroy_client(client)
        self._clients = {}

    def _wait_until_known(self, node):
        """Wait until a node, by its full name, knows the client that was just made.

        A request may come to it before the news of its client, and the reply is lost if that takes a tenth of a second.
        What the node publishes reaches a subscription when the node has learned of it, and so of all that is older:
        what it has logged within the last ten seconds at once, its diagnostics within a second.
        """
        from diagnostic_msgs.msg import DiagnosticArray
        from rcl_interfaces.msg import Log
        from rclpy.qos import DurabilityPolicy, QoSProfile

        heard = set()
        logged = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscriptions = (
            self.node.create_subscription(
                Log, "/rosout", lambda log: heard.add(f"/{log.name.replace('.', '/')}"), logged
            ),
            self.node.create_subscription(
                DiagnosticArray, "/diagnostics", lambda array: heard.update(status.name for status in array.status), 100
            ),
        )
        self.wait(lambda: node in heard, f"news of {node}")
        for subscription in subscriptions:
            self.node.destroy_subscription(subscription)

    def call(self, kind, name, /, timeout=DEADLINE, **fields):
        """Send a request and return its response."""
        future = self.call_async(kind, name, timeout, **fields)
        self.wait(future.done, f"reply of {name}", timeout)
        return future.result()

    def identify(self, *bags, node="/identification", **request):
        """Ask a node, by its full name, for the map of bags, or of live samples, and return its response."""
        from drive_id_msgs.srv import Identify

        return self.call(Identify, f"{node}/identify", bags=list(bags), **request)

    def set_parameters(self, node, **values):
        """Set parameters of a node, by its full name, together and return what it says to it."""
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        return self.call(SetParametersAtomically, f"{node}/set_parameters_atomically", parameters=parameters).result

    def diagnostics(self):
        """Return what each node says on /diagnostics, by its name: values and ``message``, which go on changing."""
        from diagnostic_msgs.msg import DiagnosticArray

        said = {}

        def hear(array):
            for status in array.status:
                said[status.name] = {value.key: value.value for value in status.values} | {"message": status.message}

        self.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 100)
        return said

    def change_state(self, node, label="", number=0):
        """Ask a node, by its full name, for a transition of its lifecycle, and tell whether it made it."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        return self.call(ChangeState, f"{node}/change_state", transition=Transition(label=label, id=number)).success

    def close(self):
        troubles = [trouble for each in (*self.hosted, *self.processes) if (trouble := each.end())]
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
        self._lock.close()
        self._patch.undo()
        if troubles:
            pytest.fail("\n".join([*troubles, self.outputs()]))


@contextlib.contextmanager
def ros_bench():
    """Give a bench, and leave nothing behind."""
    require_ros()
    with tempfile.TemporaryDirectory() as folder:
        bench = RosBench(folder)
        try:
            yield bench
        finally:
            bench.close()


def _executor(context):
    """Return the executor of the nodes (:mod:`drive_id.nodes.support.runtime`)."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def _node_without_events(name, context):
    """Return a node whose publishers, subscriptions and timers may go while an events executor has to call them."""
    from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
    from rclpy.node import Node

    class Quiet(Node):
        def create_publisher(self, *args, **options):
            events = PublisherEventCallbacks(use_default_callbacks=False)
            return super().create_publisher(*args, **({"event_callbacks": events} | options))

        def create_subscription(self, *args, **options):
            events = SubscriptionEventCallbacks(use_default_callbacks=False)
            return super().create_subscription(*args, **({"event_callbacks": events} | options))

        def create_timer(self, period, callback, **options):
            timer = super().create_timer(period, lambda: callback() if timer in self.timers else None, **options)
            return timer

    return Quiet(name, context=context)


@contextlib.contextmanager
def _as_if_alone(context, arguments):
    """Give a node that is made in the body what it would find as a process of its own: a context, and arguments."""
    from rclpy.node import Node

    def make(node, name, **options):
        plain(node, name, **{"context": context, "cli_args": ["--ros-args", *arguments], **options})

    plain = Node.__init__
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Node, "__init__", make)
        yield


def _arguments(parameters, files, namespace):
    given = [part for file in files for part in ("--params-file", str(file))]
    for name, value in (parameters or {}).items():
        given += ["-p", f"{name}:={_yaml(value)}"]
    remaps = ["-r", f"__ns:={namespace}"] if namespace else []
    return [*given, *remaps]


def _yaml(value):
    if isinstance(value, bool):
        return str(value).lower()
    return f"'{value}'" if isinstance(value, str) else str(value)
