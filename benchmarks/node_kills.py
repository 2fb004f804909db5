"""Nodes killed and restarted in random order during experiments, reproducible by a seed."""

from __future__ import annotations

import random
import signal
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from drive_id_msgs.srv import Command, Identify, StartRecording, StopRecording
from node_processes import PUBLISHER, TOPICS, Graph, NodeProcess
from rosbags.rosbag2 import Reader

from drive_id.errors import DriveIdError, EmptyTopicError
from drive_id.files.messages.block_codec import decode_block, read_head
from drive_id.files.read.several import read_recording
from drive_id.files.write.recover import recover_bag
from drive_id.nodes.support.qos import STREAM

NODES = ("bench_simulator", PUBLISHER, "recorder", "identification")
FLUSH = 1.0
"""Default of ``flush_period``, s."""
ALLOWANCE = 1.0
"""Longest delay of messages to the recorder on a busy machine, s."""
LEAD = 0.3
"""Default of ``lead_time``, s."""
I_MAX = 100.0
_START = 10.0
"""Longest wait for the trajectory to start, s."""
_IN_FLIGHT = 5
"""Most messages at the end of a killed node's run that one listener may have got and another not."""
_REST = 0.02 * I_MAX
"""Current of a drive at rest, A: noise."""


@dataclass
class Recorded:
    """A recording that was begun: when it began and ended, s of the steady clock, and whether it was stopped."""

    path: Path
    begin: float
    end: float = 0.0
    stopped: bool = False


@dataclass
class Killed:
    """Results of the rounds."""

    rounds: int = 0
    actions: Counter[str] = field(default_factory=Counter)
    recordings: int = 0
    messages: int = 0
    longest: float = 0.0
    runs_cut: int = 0
    """Ends of a killed node's messages that the recorder did not get, ..."""
    most_cut: int = 0
    """... and the most messages of one of them."""


class Rounds:
    """Kills, ends and starts nodes, runs experiments, and checks what must hold whatever happens."""

    def __init__(self, graph: Graph, rng: random.Random) -> None:
        self.graph, self.rng, self.result = graph, rng, Killed()
        self.findings = graph.replies.findings
        self._data = graph.folder / "data"
        self._nodes: dict[str, NodeProcess] = {}
        self._received: dict[str, list[tuple[float, bytes]]] = {name: [] for name in TOPICS}
        self._recording: Recorded | None = None
        self._ended: list[Recorded] = []
        self._killed: list[tuple[str, float]] = []
        self._quiet_from = 0.0  # until the next start of an experiment, no reference may differ from zero
        for name, kind in TOPICS.items():
            graph.node.create_subscription(kind, name, self._listener(name), STREAM, raw=True)
        for name in NODES:
            self._start(name)

    def _listener(self, name: str) -> Any:
        def listen(data: bytes) -> None:
            self._received[name].append((time.monotonic(), data))
            if name == "/current_reference" and self._quiet_from and time.monotonic() > self._quiet_from:
                self._check_zero(data)

        return listen

    def _check_zero(self, data: bytes) -> None:
        if max(float(np.abs(values).max(initial=0.0)) for values in decode_block(data, 2).values) > 0.0:
            self.findings.append("a nonzero reference although no experiment was started")
            self._quiet_from = 0.0

    # -- actions -------------------------------------------------------------------------------------------------------

    def round(self) -> None:
        """Start an experiment, disturb nodes, restart those that are gone, and check."""
        before, said = len(self.findings), list[str]()
        self._begin()
        for _ in range(self.rng.randint(1, 4)):
            self.graph.spin(self.rng.uniform(0.1, 1.5))
            name = self.rng.choice(NODES)
            action = self.rng.choice(("kill", "kill", "terminate", "interrupt", "restart"))
            said.append(f"{action} {name}")
            self._act(action, name)
        for name in self.rng.sample(NODES, len(NODES)):
            if name not in self._nodes:
                said.append(f"start {name}")
                self._start(name)
        self._check_services()
        for recording in self._ended:
            self._check_recording(recording)
        self._ended.clear()
        self._check_rest()
        self.findings[before:] = [
            f"round {self.result.rounds} ({', '.join(said)}): {finding}" for finding in self.findings[before:]
        ]
        self.result.rounds += 1
        for messages in self._received.values():
            messages.clear()
        self._killed.clear()

    def _begin(self) -> None:
        """Start recording and trajectory."""
        reply = self.graph.call(StartRecording, "/recorder/start", name="")
        if self.graph.succeeded("recorder/start", reply):
            self._recording = Recorded(Path(reply.uri), time.monotonic())
        self._quiet_from = 0.0
        self.graph.start_trajectory(_START)

    def _act(self, action: str, name: str) -> None:
        self.result.actions[action] += 1
        if name in self._nodes:
            number = {"terminate": signal.SIGTERM, "interrupt": signal.SIGINT}.get(action, signal.SIGKILL)
            self._end(name, number)
        else:
            self._start(name)
        if action == "restart" and name not in self._nodes:
            self._start(name)

    def _end(self, name: str, number: int) -> None:
        moment = time.monotonic()
        if number == signal.SIGKILL:
            self._killed.append((name, moment))
        trouble = self._nodes.pop(name).end(number)
        self.graph.forget(name)
        if trouble:
            self.findings.append(trouble)
        if name == PUBLISHER:
            self._quiet_from = time.monotonic() + LEAD
        if name == "recorder":
            self._end_of_recording(moment, stopped=number != signal.SIGKILL)

    def _start(self, name: str) -> None:
        data = {"data_directory": self._data}
        settings: dict[str, dict[str, Any]] = {
            "bench_simulator": {"current_noise": 1e-3},
            PUBLISHER: {"i_max": I_MAX, "duration": 30.0},
            "recorder": data,
            "identification": data | {"output_directory": self._data / "results", "i_max": I_MAX, "method": "joint"},
        }
        self._nodes[name] = self.graph.start(name, settings[name])

    # -- checks --------------------------------------------------------------------------------------------------------

    def _check_services(self) -> None:
        """Check that every node answers, whatever happened to it."""
        stop = f"{PUBLISHER}/stop_experiment"
        self.graph.succeeded(stop, self.graph.call(Command, f"/{stop}"))
        self._quiet_from = time.monotonic() + 2 * LEAD
        reply = self.graph.call(StopRecording, "/recorder/stop")
        if self._recording is not None:
            self.graph.succeeded("recorder/stop", reply)
            self._end_of_recording(time.monotonic(), stopped=True)
        elif reply is None:
            self.findings.append("recorder/stop: no answer")
        reply = self.graph.call(Identify, "/identification/identify", bags=[], method="joint")
        self.graph.replies.note("identification/identify", reply, success=None)
        self.findings += self.graph.troubles()

    def _end_of_recording(self, moment: float, *, stopped: bool) -> None:
        if self._recording is not None:
            self._recording.end, self._recording.stopped = moment, stopped
            self._ended.append(self._recording)
            self._recording = None

    def _check_rest(self) -> None:
        """Check that the drive is at rest, and stays there."""
        self._received["/phase_currents"].clear()
        quiet = self.graph.wait(lambda: self._amplitude() < _REST, 10.0)
        self.graph.spin(0.5)
        if not quiet or self._amplitude() > _REST:
            self.findings.append(f"the drive is not at rest: {self._amplitude():.1f} A")

    def _amplitude(self) -> float:
        """Return the largest current of the last message, A."""
        heard = self._received["/phase_currents"]
        if not heard:
            return float("inf")
        return max(float(np.abs(values).max()) for values in decode_block(heard[-1][1], 3).values)

    def _check_recording(self, recording: Recorded) -> None:
        """Check that it contains all messages received here, but for those not flushed when the recorder was killed."""
        self.result.recordings += 1
        title = f"{recording.path.name} ({'stopped' if recording.stopped else 'killed'})"
        try:
            read_recording(recording.path)
        except EmptyTopicError:
            pass  # the drive had been killed before
        except DriveIdError as error:
            self.findings.append(f"{title} cannot be read: {error}")
        path = recording.path
        if not recording.stopped:
            try:
                path = recover_bag(path).output
            except EmptyTopicError as error:
                if recording.end - recording.begin > FLUSH + ALLOWANCE:
                    self.findings.append(f"{title}: {error}")
                return
        with Reader(path) as reader:
            found = {(each.topic, bytes(data)) for each, _, data in reader.messages()}
        self.result.messages += len(found)
        lost = 0.0
        for topic, heard in self._received.items():
            during = [(when, data) for when, data in heard if recording.begin < when < recording.end]
            for run in _runs(during):
                there = [(topic, data) in found for _, data in run]
                flushed = recording.stopped or (run and run[-1][0] < recording.end - FLUSH - ALLOWANCE)
                cut = _cut(there) if flushed and self._was_killed(topic, run) else 0
                if cut:
                    self.result.runs_cut += 1
                    self.result.most_cut = max(self.result.most_cut, cut)
                begin = there.index(True) if True in there else len(run)
                missing = [run[k][0] for k in range(begin, len(run) - cut) if not there[k]]
                lost = max(lost, recording.end - min(missing, default=recording.end))
        self.result.longest = max(self.result.longest, lost)
        if lost > (0.0 if recording.stopped else FLUSH) + ALLOWANCE:
            self.findings.append(f"{title}: messages received up to {lost:.2f} s before its end are missing")

    def _was_killed(self, topic: str, run: list[tuple[float, bytes]]) -> bool:
        """Return whether the node whose messages these are was killed at their end."""
        node = PUBLISHER if topic == "/current_reference" else "bench_simulator"
        return bool(run) and any(name == node and abs(moment - run[-1][0]) < ALLOWANCE for name, moment in self._killed)


def _cut(there: list[bool]) -> int:
    """Return how many messages, up to the limit, are not there at the end of a run, all that follow the last one there.

    What a reliable writer has given to one listener and not yet to another is lost when its process is killed, and a
    listener gets nothing behind a message that it lacks: a message that is missing before one that is there was lost
    otherwise.
    """
    missing = next((k for k, each in enumerate(reversed(there)) if each), len(there))
    return missing if missing <= _IN_FLIGHT else 0


def _runs(heard: list[tuple[float, bytes]]) -> list[list[tuple[float, bytes]]]:
    """Split received messages at restarts of their node: a subscriber may discover it too late for the first ones."""
    runs: list[list[tuple[float, bytes]]] = [[]]
    last = -1
    for when, data in heard:
        first = read_head(data).first_sample
        if first <= last:
            runs.append([])
        runs[-1].append((when, data))
        last = first
    return runs


def kills(rounds: int, seed: int, folder: Path) -> tuple[Killed, list[str]]:
    """Run a number of rounds, which the seed determines, and return findings as well; ``folder`` is scratch space."""
    with Graph(folder) as graph:
        running = Rounds(graph, random.Random(seed))
        for _ in range(rounds):
            running.round()
        return running.result, running.findings
