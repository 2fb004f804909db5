"""A drive that is identified live, in real time: memory of each node, and replies to a request every half a minute."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from drive_id_msgs.msg import PublisherState
from drive_id_msgs.srv import Command, Identify, StartRecording, StopRecording
from node_processes import PUBLISHER, Graph, Replies, highest, slope

from drive_id.nodes.support.qos import LATCHED

REQUESTS = 30.0
"""Time between requests, s; one that is still waiting puts off the next."""
_LOOK = 10.0
"""Time between two looks at the memory, s."""
_REPLY = 300.0
"""Longest wait for a reply after the end, s: other processes may have the cores."""
_IDENTIFY = "/identification/identify"


@dataclass
class Watched:
    """What was seen of the nodes: memory of each, MB, at times, s, replies, and the reasons of trips."""

    replies: Replies
    times: list[float] = field(default_factory=list)
    memory: dict[str, list[float]] = field(default_factory=dict)
    peaks: dict[str, float] = field(default_factory=dict)  # the most that it has held at any time
    recorded: int = 0
    dropped: int = 0
    trips: list[str] = field(default_factory=list)

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


def watch(minutes: float, folder: Path, method: str) -> Watched:
    """Run drive, publisher, recorder and identification, and request a fit of the live samples every half a minute.

    In real time; an hour of recording takes some 1.5 GB of the folder. A trip is noted and cleared, for a busy machine
    may cause one.
    """
    folder.mkdir()
    data = {"data_directory": folder / "data"}
    with Graph(folder) as graph:
        watched, states = Watched(graph.replies), list[PublisherState]()
        nodes = {
            "bench_simulator": graph.start("bench_simulator"),
            PUBLISHER: graph.start(PUBLISHER, {"i_max": 100.0, "speed_max": 400.0, "repeat": 0}),
            "recorder": graph.start("recorder", data),
            "identification": graph.start(
                "identification", data | {"i_max": 100.0, "method": method, "output_directory": folder / "results"}
            ),
        }
        graph.node.create_subscription(PublisherState, f"/{PUBLISHER}/state", states.append, LATCHED)
        graph.call(StartRecording, "/recorder/start", name="hour")
        graph.start_trajectory()
        begin = looked = asked = time.monotonic()
        request: Any = None
        while (now := time.monotonic()) < begin + 60 * minutes and all(node.alive for node in nodes.values()):
            graph.spin(0.2)
            if states and states[-1].state == "tripped":
                watched.trips.append(str(states[-1].reason))
                states.clear()
                graph.start_trajectory()
            if now - looked >= _LOOK:
                looked = now
                watched.look(
                    now - begin,
                    {name: node.memory for name, node in nodes.items()},
                    {name: highest(node.popen.pid) for name, node in nodes.items()},
                )
            if request is None and now - asked >= REQUESTS:
                asked = now
                request = graph.send(Identify, _IDENTIFY)
            if request is not None and request.done():
                graph.replies.note("identify", request.result(), now - asked)
                request = None
        graph.replies.findings += [f"{name} has died" for name, node in nodes.items() if not node.alive]
        if request is not None:
            reply = request.result() if graph.wait(request.done, _REPLY) else None
            graph.replies.note("identify", reply, time.monotonic() - asked)
        graph.call(Command, f"/{PUBLISHER}/stop_experiment")
        stopped = graph.call(StopRecording, "/recorder/stop")
        if graph.succeeded("recorder", stopped):
            watched.recorded, watched.dropped = int(stopped.samples), int(stopped.dropped)
        graph.replies.findings += graph.troubles()
    return watched
