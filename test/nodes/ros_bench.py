"""Real processes over DDS for the tests of the nodes: start them, talk to them, end them with SIGINT, all bounded."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

DEADLINE = 60.0
"""s; nothing takes as long, but machines are busy."""


def require_ros():
    """Skip without ROS 2, unless the caller has promised that it is there."""
    missing = [name for name in ("rclpy", "drive_id_msgs") if importlib.util.find_spec(name) is None]
    if missing:
        complaint = f"{' and '.join(missing)} not found: source a ROS 2 workspace with drive_id_msgs, or use make test"
        if os.environ.get("DRIVE_ID_REQUIRE_ROS") == "1":
            pytest.fail(complaint)
        pytest.skip(complaint)


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

    def interrupt(self, within=DEADLINE, number=signal.SIGINT):
        """End the process and return its exit code and how long it took, s."""
        start = time.monotonic()
        self.popen.send_signal(number)
        self.popen.wait(within)
        return self.popen.returncode, time.monotonic() - start

    def end(self):
        """End it whatever it is doing."""
        if self.popen.poll() is None:
            self.popen.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.popen.wait(10)
        if self.popen.poll() is None:
            self.popen.kill()
            self.popen.wait()


class RosBench:
    """A node of the test's own in a domain of its own, and the processes that it has started."""

    def __init__(self, folder, domain=None):
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        self.folder = Path(folder)
        self.environment = dict(os.environ)
        domain = domain or 1 + os.getpid() % 101
        self.environment |= {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(self.folder / "ros_log"),
        }
        with _environment(self.environment):
            self.context = Context()
            self.context.init(args=[], domain_id=domain)
            self.node = Node("test_bench", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.processes = []
        self._clients = {}

    def start(self, module, *, parameters=None, files=(), arguments=(), namespace=""):
        """Start ``python -m module`` with parameter files, and with parameters by name that prevail over them."""
        given = [part for file in files for part in ("--params-file", str(file))]
        for name, value in (parameters or {}).items():
            given += ["-p", f"{name}:={_yaml(value)}"]
        remaps = ["-r", f"__ns:={namespace}"] if namespace else []
        log = self.folder / f"{module.rsplit('.', 1)[-1]}_{len(self.processes)}.log"
        process = Process(module, ["--ros-args", *given, *remaps, *arguments], self.environment, log)
        self.processes.append(process)
        return process

    def wait(self, condition, what, timeout=DEADLINE):
        """Spin until the condition holds and return it; fail with the processes' output when it does not."""
        end = time.monotonic() + timeout
        while not (value := condition()):
            if any(process.popen.poll() == 1 and not process.expected_to_fail for process in self.processes):
                pytest.fail(f"A node has given up while waiting for: {what}\n{self.outputs()}")
            if time.monotonic() > end:
                pytest.fail(f"Not within {timeout} s: {what}\n{self.outputs()}")
            self.executor.spin_once(timeout_sec=0.02)
        return value

    def outputs(self):
        return "\n".join(f"--- {process.log.name}\n{process.output}" for process in self.processes)

    def call_async(self, kind, name, /, timeout=DEADLINE, **fields):
        """Send a request when the service is there and return the future."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        self.wait(client.service_is_ready, f"service {name}", timeout)
        return client.call_async(kind.Request(**fields))

    def call(self, kind, name, /, timeout=DEADLINE, **fields):
        """Send a request and return its response."""
        future = self.call_async(kind, name, timeout, **fields)
        self.wait(future.done, f"reply of {name}", timeout)
        return future.result()

    def close(self):
        for process in self.processes:
            process.end()
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


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


@contextlib.contextmanager
def _environment(values):
    before = dict(os.environ)
    os.environ.update(values)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _yaml(value):
    if isinstance(value, bool):
        return str(value).lower()
    return f"'{value}'" if isinstance(value, str) else str(value)
