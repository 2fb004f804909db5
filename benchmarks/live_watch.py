"""A drive that is identified live, in real time: memory of each node, and replies to a request every half a minute."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from drive_id_msgs.msg import PublisherState
from drive_id_msgs.srv import Command, Identify, StartExperiment, StartRecording, StopRecording
from node_processes import Graph, highest, slope

from drive_id.nodes.support.qos import LATCHED

REQUESTS = 30.0
"""Time between requests, s; one that is still waiting puts off the next."""
_LOOK = 10.0
"""Time between two looks at the memory, s."""
_REPLY = 300.0
"""Longest wait for a reply after the end, s: other processes may have the cores."""
PUBLISHER = "trajectory_publisher"
_SETTINGS = {"i_max": 100.0, "speed_max": 400.0, "repeat": 0}


@dataclass
class Watched:
    """What was seen of the nodes: memory of each, MB, at times, s; codes of replies, and the longest wait, s."""

    times: list[float] = field(default_factory=list)
    memory: dict[str, list[float]] = field(default_factory=dict)
    peaks: dict[str, float] = field(default_factory=dict)  # the most that it has held at any time
    codes: Counter[str] = field(default_factory=Counter)
    asked: int = 0
    slowest: float = 0.0
    recorded: int = 0
    dropped: int = 0
    trips: list[str] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)

    def look(self, elapsed: float, memory: dict[str, float], peaks: dict[str, float]) -> None:
        """Note the memory of each node, and the most that it has held so far."""
        self.times.append(elapsed)
        for name, value in memory.items():
            self.memory.setdefault(name, []).append(value)
        self.peaks |= peaks

    def row(self, name: str) -> tuple[str, ...]:
        """Return memory at first, median, peak, MB, and growth per hour over the later two thirds, MB, of a node."""
        values = self.memory[name]
        growth = round(3600 * slope(self.times, values))
        return f"{values[0]:.0f}", f"{np.median(values):.0f}", f"{self.peaks[name]:.0f}", f"{growth:+d}"


class _Operator:
    """Keeps the trajectory running; a trip is noted and cleared, for a busy machine may cause one."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._last = PublisherState()
        graph.node.create_subscription(PublisherState, f"/{PUBLISHER}/state", self._on_state, LATCHED)

    def _on_state(self, message: PublisherState) -> None:
        self._last = message

    def start(self) -> None:
        """Start the trajectory, as soon as the drive allows it."""

        def started() -> bool:
            self._graph.call(Command, f"/{PUBLISHER}/clear_fault")
            reply = self._graph.call(StartExperiment, f"/{PUBLISHER}/start_experiment")
            return bool(reply is not None and reply.success)

        if not self._graph.wait(started):
            raise SystemExit("The trajectory does not start.")

    def tripped(self) -> str:
        """Start the trajectory again after a trip, and return its reason; empty without one."""
        reason = str(self._last.reason) if self._last.state == "tripped" else ""
        if reason:
            self._last = PublisherState()
            self.start()
        return reason


def watch(minutes: float, folder: Path, method: str) -> Watched:
    """Run drive, publisher, recorder and identification, and request a fit of the live samples every half a minute.

    In real time; an hour of recording takes some 1.5 GB of the folder.
    """
    folder.mkdir()
    watched = Watched()
    with Graph(folder) as graph:
        data = folder / "data"
        nodes = {
            "bench_simulator": graph.start("bench_simulator"),
            PUBLISHER: graph.start(PUBLISHER, _SETTINGS),
            "recorder": graph.start("recorder", {"data_directory": data}),
            "identification": graph.start(
                "identification",
                {"i_max": 100.0, "method": method, "data_directory": data, "output_directory": folder / "results"},
            ),
        }
        operator = _Operator(graph)
        graph.call(StartRecording, "/recorder/start", name="hour")
        operator.start()
        begin = looked = asked = time.monotonic()
        request: Any = None
        while (now := time.monotonic()) < begin + 60 * minutes and all(node.alive for node in nodes.values()):
            graph.spin(0.2)
            watched.trips += [reason for reason in [operator.tripped()] if reason]
            if now - looked >= _LOOK:
                looked = now
                watched.look(
                    now - begin,
                    {name: node.memory for name, node in nodes.items()},
                    {name: highest(node.popen.pid) for name, node in nodes.items()},
                )
            if request is None and now - asked >= REQUESTS:
                asked = now
                watched.asked += 1
                request = graph.send(Identify, "/identification/identify")
            if request is not None and request.done():
                _note(watched, request, time.monotonic() - asked)
                request = None
        watched.findings += [f"{name} has died" for name, node in nodes.items() if not node.alive]
        if request is not None:
            graph.wait(request.done, _REPLY)
            _note(watched, request, time.monotonic() - asked)
        graph.call(Command, f"/{PUBLISHER}/stop_experiment")
        stopped = graph.call(StopRecording, "/recorder/stop")
        if stopped is None or not stopped.success:
            watched.findings.append(f"recorder: {'no answer' if stopped is None else stopped.message}")
        else:
            watched.recorded, watched.dropped = int(stopped.samples), int(stopped.dropped)
        watched.findings += graph.troubles()
    return watched


def _note(watched: Watched, request: Any, took: float) -> None:
    reply = request.result() if request.done() else None
    watched.slowest = max(watched.slowest, took)
    watched.codes["no answer" if reply is None else reply.code] += 1
    if reply is None or not reply.success:
        watched.findings.append(f"identify: {'no answer' if reply is None else reply.message}")
