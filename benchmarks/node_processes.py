"""Nodes as processes that are started, ended and killed, their memory and logs, and a client of their services."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 101))

from diagnostic_msgs.msg import DiagnosticArray
from drive_id_msgs import msg
from drive_id_msgs.srv import Command, StartExperiment
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from drive_id.nodes.support.middleware import fast_dds

if TYPE_CHECKING:
    from typing_extensions import Self

PATIENCE = 90.0
"""Longest wait for anything, s: the machine may be busy."""

TOPICS = {
    "/phase_currents": msg.PhaseCurrents,
    "/phase_voltages": msg.PhaseVoltages,
    "/resolver": msg.Resolver,
    "/current_reference": msg.CurrentReference,
}
"""Topics of the drive with their types."""
PUBLISHER = "trajectory_publisher"
_DISCOVERY = 2.0
"""Time in which nodes of the same domain are discovered, s."""


def resident(pid: int | None = None) -> float:
    """Return the memory that a process, by default this one, holds, MB."""
    pages = int(Path(f"/proc/{pid or 'self'}/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def highest(pid: int) -> float:
    """Return the most memory that a process has ever held, MB, which a look every now and then would miss."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    return float(re.findall(r"VmHWM:\s+(\d+) kB", status)[0]) * 1024 / 1e6


def slope(times: list[float], values: list[float]) -> float:
    """Return the slope of the later two thirds of a series, without what is loaded at first use."""
    later = len(times) // 3
    if len(times) - later < 3:
        return 0.0
    return float(np.polyfit(times[later:], values[later:], 1)[0])


class NodeProcess:
    """One start of a node, its output in a file."""

    def __init__(self, command: list[str], log: Path) -> None:
        self.log = log
        with log.open("w", encoding="utf-8") as stream:
            self.popen = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT, stdin=subprocess.PIPE)

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self.popen.poll() is None

    @property
    def text(self) -> str:
        """Its output so far."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    @property
    def memory(self) -> float:
        """Its memory, MB."""
        return resident(self.popen.pid)

    def end(self, number: int) -> str:
        """End it by a signal; return a finding, or an empty string."""
        if not self.alive:
            return f"{self.log.name} ended by itself with code {self.popen.returncode}"
        self.popen.send_signal(number)
        if self.popen.stdin is not None:
            self.popen.stdin.close()
        try:
            code = self.popen.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()
            return f"{self.log.name} did not end on signal {number}"
        wanted = -signal.SIGKILL if number == signal.SIGKILL else 0
        return "" if code == wanted else f"{self.log.name} ended with code {code} on signal {number}"

    def trouble(self) -> str:
        """Return a traceback in its output, if there is one."""
        text = self.text
        return f"{self.log.name}: {text[text.index('Traceback') :][:600]}" if "Traceback" in text else ""


@dataclass
class Replies:
    """Replies to requests: how often each code came, the longest wait, s, and what is wrong with them."""

    codes: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    findings: list[str] = field(default_factory=list)

    @property
    def told(self) -> str:
        """The codes, and how often each came."""
        return ", ".join(f"{count} `{code}`" for code, count in self.codes.most_common())

    def note(self, what: str, reply: Any, took: float = 0.0, *, success: bool | None = True) -> None:
        """Judge one reply; None: there was none. It must be a sentence, and as successful as is said here."""
        self.codes["no answer" if reply is None else reply.code] += 1
        self.slowest = max(self.slowest, took)
        if reply is None:
            self.findings.append(f"{what}: no answer")
        elif success not in (None, reply.success):
            self.findings.append(f"{what}: {reply.code}, {reply.message}")
        elif not reply.message.endswith(".") or "Traceback" in reply.message or reply.code == "internal":
            self.findings.append(f"{what}: {reply.code}, not a sentence: {reply.message[:200]!r}")


class Graph:
    """A client in a ROS context of its own, and the nodes that it has started; a folder takes the logs.

    It refuses a domain with other nodes, whose answers could be mistaken for ours.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[NodeProcess] = []
        self.replies = Replies()
        os.environ["ROS_LOG_DIR"] = str(folder / "ros_log")
        with fast_dds():
            self._context = Context()
            self._context.init(args=[])
            self.node = Node("endurance", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}
        self.spin(_DISCOVERY)
        others = set(self.node.get_node_names()) - {self.node.get_name()}
        if others:
            domain = os.environ["ROS_DOMAIN_ID"]
            raise SystemExit(f"Other nodes are in domain {domain} ({', '.join(sorted(others))}): set ROS_DOMAIN_ID.")

    def start(self, name: str, parameters: dict[str, Any] | None = None) -> NodeProcess:
        """Start a node of the package and wait until it is ready."""
        command = [sys.executable, "-m", f"drive_id.nodes.{name}", "--ros-args"]
        for key, value in (parameters or {}).items():
            command += ["-p", f"{key}:={value}"]
        process = self.run(command, name)
        if not self.wait(lambda: "Ready" in process.text or not process.alive) or not process.alive:
            raise SystemExit(f"{name} is not ready:\n{process.text}")
        return process

    def run(self, command: list[str], name: str) -> NodeProcess:
        """Start a process."""
        self.started.append(NodeProcess(command, self.folder / f"{len(self.started)}_{name}.log"))
        return self.started[-1]

    def spin(self, seconds: float) -> None:
        """Spin for a time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=min(left, 0.05))

    def wait(self, condition: Callable[[], Any], patience: float = PATIENCE) -> bool:
        """Spin until a condition holds or time is up; return whether it holds."""
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True

    def send(self, kind: Any, name: str, /, **fields: Any) -> Any:
        """Send a request and return its future; None if there is no server."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
            self._wait_until_known(name.rpartition("/")[0])
        client = self._clients[name]
        return client.call_async(kind.Request(**fields)) if self.wait(client.service_is_ready) else None

    def call(self, kind: Any, name: str, /, **fields: Any) -> Any:
        """Call a service and return the response; None if there is none."""
        future = self.send(kind, name, **fields)
        return future.result() if future is not None and self.wait(future.done) else None

    def succeeded(self, what: str, reply: Any) -> bool:
        """Return whether a command succeeded, and note it if not."""
        if reply is None or not reply.success:
            self.replies.findings.append(f"{what}: {'no answer' if reply is None else reply.message}")
        return reply is not None and bool(reply.success)

    def start_trajectory(self, patience: float = PATIENCE) -> None:
        """Start it as soon as the drive allows it: when its messages have arrived, and a trip is cleared."""
        said: list[Any] = [None]

        def started() -> bool:
            self.call(Command, f"/{PUBLISHER}/clear_fault")
            said[0] = self.call(StartExperiment, f"/{PUBLISHER}/start_experiment")
            self.spin(0.0 if said[0] is None or said[0].success else 0.5)
            return said[0] is None or bool(said[0].success)

        self.wait(started, patience)
        self.succeeded(f"{PUBLISHER}/start_experiment", said[0])

    def _wait_until_known(self, node: str) -> None:
        """Wait until a node knows the client that was just made: a reply to one that it does not know is lost.

        What the node publishes reaches a subscription when the node has learned of it, and so of all that is older.
        """
        heard: set[str] = set()
        subscription = self.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda array: heard.update(status.name for status in array.status), 100
        )
        self.wait(lambda: node in heard)
        self.node.destroy_subscription(subscription)

    def forget(self, node: str) -> None:
        """Make new clients of a node that was started again."""
        for name in [name for name in self._clients if name.startswith(f"/{node}/")]:
            self.node.destroy_client(self._clients.pop(name))

    def troubles(self) -> list[str]:
        """Return the tracebacks in all output."""
        return [said for process in self.started if (said := process.trouble())]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self.started:
            if process.alive:
                process.end(signal.SIGINT)
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()
