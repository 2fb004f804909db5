"""Reaction times of trajectory publisher and simulated drive to trouble, and random scripts of it.

    python benchmarks/safety.py                          each hazard of docs/engineering/safety_measured.md ten times
    python benchmarks/safety.py --rounds 0 --scripts 200 --seed 1
    python benchmarks/safety.py --rounds 0 --scripts 200 --seed 1 --replay 41     ten times script 41 of these, alone
    python benchmarks/safety.py --rounds 0 --goals 60         random scripts during goals of the node experiment

Both nodes run as processes with the shipped parameter files, 100 A, without end. What is checked is what the drive
measures: never above the limit, and zero within the stated time after each stop, trip, death or intruder. In scripts,
the node identification listens as well: it must not make one map of two drives. With ``--goals``, the trouble comes
before, during and after the trajectory of a goal: it must end with a code in time, its bags must be readable, and one
that is ``ok`` must be whole. Times are those of the drive's samples
by their count, however late its process gets to publish them, or this one to read: on a busy computer the simulated
drive is held up, and then makes and publishes within moments what it has missed. No clock that is set wrong changes
that count. The exit code is 1 if there is a finding.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from drive_id_msgs.action import Experiment
from drive_id_msgs.msg import CurrentReference, DriveStatus, PhaseCurrents, PublisherState, RecorderState
from drive_id_msgs.srv import Command, Identify, StartExperiment
from node_processes import Graph, NodeProcess
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from reporting import Row, Section
from std_msgs.msg import Bool, Empty

from drive_id.files.storage.bag import open_bag
from drive_id.nodes.support.qos import LATCHED, STREAM

CONFIG = Path(__file__).parent.parent / "config"
I_MAX, LIMIT = 100.0, 125.0
REST = 3.0
"""Current of a drive at rest, A: the ripple of the inverter."""
QUIET = 0.7
"""Time without current after which a drive counts as at rest, s: more than messages are ever late."""
OWNED = 0.6
"""Time after a run in which a drive surely belongs to its publisher, s: its second, less what it takes to intrude."""
_HEARD = 20.0
"""Time within which the node identification hears of another drive, s, however busy the computer."""
_FOUND = 10.0
"""Time within which a drive and its listeners find each other, s, however busy the computer; told once a second."""
_ATTEMPTS = 4
_REPLAYS = 10
_START, _CATCH_UP, _BEHIND = 90.0, 5.0, 0.1
"""Time for a start, and that for a drive to catch up, s, which is started again if it is still so far behind, s."""
PUBLISHER, DRIVE, LISTENER, RIVAL = "trajectory_publisher", "bench_simulator", "identification", "rival"
RECORDER, CONDUCTOR = "recorder", "experiment"
_LINGERS = 22.0
"""Time for which DDS takes a killed node for alive, s."""
_GOAL, _PATIENCE = 4.0, 15.0
"""Duration of the trajectory of a goal, and the node's parameter ``timeout``, s."""
_ENDS = 60.0
"""Time within which a goal ends after its first trouble, s: the trajectory to its end and ``timeout`` (19 s), a node
that was killed is noticed (20 s), and 15 s for the stop."""
SERVICES = {"start_experiment": StartExperiment, "stop_experiment": Command, "clear_fault": Command}


@dataclass(frozen=True)
class Hazard:
    """Something that goes wrong."""

    stated: float  # time within which the measured current is zero, s
    faults: dict[str, Any] = field(default_factory=dict)  # parameters of the simulated drive
    act: str = ""  # name of a method of :class:`Cell` instead, and of what undoes it with ``un_`` before it
    killed: str = ""  # name of a node that is killed instead, and started again to undo it
    reason: str = ""  # part of what the publisher says; empty if it need not trip


HAZARDS = {
    "~/stop": Hazard(0.3, act="stop"),
    "emergency stop": Hazard(0.3, act="press", reason="emergency stop"),
    "drive clock 5 s behind": Hazard(0.5, {"clock_offset": -5.0}, reason="The stamps of"),
    "drive clock 1 s ahead": Hazard(0.5, {"clock_offset": 1.0}, reason="The stamps of"),
    "drive clock drifts by 0.5 s/s": Hazard(0.8, {"clock_drift": 0.5}, reason="The stamps of"),
    "drive ignores references": Hazard(0.5, {"ignore_references": True}, reason="does not follow"),
    "stamps of feedback frozen": Hazard(0.5, {"freeze": "stamps"}, reason="do not advance"),
    "samples of feedback frozen": Hazard(0.5, {"freeze": "samples"}, reason="does not follow"),
    "drive restarts": Hazard(0.3, {"restarts": 1}, reason="the drive was restarted"),
    "drive trips": Hazard(0.3, {"trip": True}, reason="The drive reports a fault"),
    "all messages lost": Hazard(0.9, {"loss": 1.0}, reason=" "),
    "a third of the messages lost": Hazard(1.0, {"loss": 0.3}, reason=" "),
    "a third of the messages overtaken": Hazard(1.0, {"disorder": 0.3}, reason=" "),
    "messages 0.4 s late": Hazard(1.0, {"latency": 0.4}, reason=" "),
    "second publisher, silent": Hazard(0.5, act="appear", reason="Another node publishes"),
    "second publisher sends references": Hazard(0.5, act="intrude", reason=" "),
    "overspeed": Hazard(0.6, act="overspeed", reason="above speed_max"),
    "client dies (lease)": Hazard(2.4, act="die", reason="no heartbeat"),
    "publisher killed": Hazard(0.6, killed=PUBLISHER),
    "publisher stopped (SIGSTOP)": Hazard(0.6, act="suspend", reason=" "),
    "drive killed": Hazard(0.9, killed=DRIVE, reason="Nothing has arrived"),
    "drive exchanged": Hazard(0.9, act="exchange", reason=" "),
    "second drive": Hazard(0.5, act="double", reason=" "),
}
OF_GOALS = {
    "goal cancelled": Hazard(0.5, act="cancel"),
    "recorder killed": Hazard(_GOAL + _PATIENCE, killed=RECORDER),
    "identification killed": Hazard(_GOAL + _PATIENCE, killed=LISTENER),
    "experiment killed": Hazard(2.4, killed=CONDUCTOR),
    "client dies (lease)": Hazard(2.4, act="die"),
}
"""What can go wrong with goals besides."""
ANOTHER = {"drive restarts", "drive exchanged", "second drive"}
"""Hazards after which the samples are of two drives, or may be."""
BY_CHANCE = {"loss": 0.3, "disorder": 0.3}
"""Faults that strike some time after they begin: in scripts, nothing tells by when the current must be zero."""


def _published(info: Any) -> float:
    """Return when a message was published, s of the monotonic clock; ``info`` has it by the system's clock, ns."""
    return time.monotonic() - (time.time_ns() - int(info["source_timestamp"])) / 1e9


class Cell:
    """The two nodes, what the drive measures, and an operator.

    Parameters
    ----------
    graph : Graph
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.findings: list[str] = []
        self.peaks: list[tuple[float, float]] = []
        """Times at which blocks of currents were complete, s of the monotonic clock, and their largest values, A."""
        self.heard = 0
        """Times that blocks of another drive began, or of this one anew."""
        self.behind, self.lag = 0.0, 0.0
        """Time from then until a block was published, s: of the last one, and the longest."""
        self.reason, self.state, self.leased = "", "", True
        self.recording = RecorderState()
        self._seen: set[int] = set()
        self._zeros: dict[int, float] = {}
        """When a drive had no samples, s of the monotonic clock, by the count of its next one: two may publish."""
        self._frozen = False
        self._listeners: dict[str, int] = {}
        """Subscriptions that receive the currents of a drive, by the drive's name, as it said last."""
        self.rivals: list[Any] = []
        node = graph.node
        node.create_subscription(PhaseCurrents, "/phase_currents", self._on_currents, STREAM)
        node.create_subscription(DriveStatus, "/drive_status", self._on_status, STREAM)
        node.create_subscription(PublisherState, f"/{PUBLISHER}/state", self._on_state, LATCHED)
        node.create_subscription(RecorderState, f"/{RECORDER}/state", self._on_recording, LATCHED)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.estop = node.create_publisher(Bool, "/emergency_stop", LATCHED)
        self.heartbeat = self._own_beat = node.create_publisher(Empty, f"/{PUBLISHER}/heartbeat", 1)
        node.create_timer(0.2, lambda: self.leased and self.heartbeat.publish(Empty()))
        self.nodes: dict[str, NodeProcess] = {}
        self._starts: dict[str, Callable[[], None]] = {
            DRIVE: self.start_drive, PUBLISHER: self.start_publisher, LISTENER: self.start_listener,
            RECORDER: self.start_recorder, CONDUCTOR: self.restart_conductor,
        }  # fmt: skip
        self.start_drive()
        self.start_publisher()

    def start_listener(self) -> None:
        """Start the node identification, whose maps are to be of one drive."""
        given = ["-p", "i_max:=100.0", "-p", "method:=joint", "-p", "refit_share:=0.0"]
        given += ["-p", f"output_directory:={self.graph.folder / 'maps'}"]
        given += ["-p", f"data_directory:={self.graph.folder / 'data'}"]
        self.nodes[LISTENER] = self._ready([f"drive_id.nodes.{LISTENER}", "--ros-args", *given])

    def start_nodes(self) -> None:
        """Start what a goal needs besides."""
        self._goals = ActionClient(self.graph.node, Experiment, f"/{CONDUCTOR}/{CONDUCTOR}")
        self._beat_of_goal = self.graph.node.create_publisher(Empty, f"/{CONDUCTOR}/heartbeat", 1)
        self.start_listener()
        self.start_recorder()
        self.start_conductor()

    def start_recorder(self) -> None:
        """Start the recorder."""
        given = ["-p", f"data_directory:={self.graph.folder / 'data'}"]
        self.nodes[RECORDER] = self._ready([f"drive_id.nodes.{RECORDER}", "--ros-args", *given])

    def start_conductor(self) -> None:
        """Start the node that takes goals."""
        given = ["-p", f"timeout:={_PATIENCE}"]
        self.nodes[CONDUCTOR] = self._ready([f"drive_id.ros.{CONDUCTOR}", "--ros-args", *given])

    def send(self) -> Any:
        """Send a goal and return its handle, None if nobody takes it."""
        self.feedback: list[Any] = []
        self.heartbeat = self._beat_of_goal
        goal = Experiment.Goal(duration=_GOAL, repeat=1, lease_time=2.0)
        self.graph.wait(self._goals.server_is_ready, _FOUND)
        sent = self._goals.send_goal_async(goal, feedback_callback=lambda heard: self.feedback.append(heard.feedback))
        self.graph.wait(sent.done, _FOUND)
        self.handle: Any = sent.result() if sent.done() else None
        return self.handle

    def cancel(self) -> None:
        """Cancel the goal under way."""
        self.handle.cancel_goal_async()

    def restart_conductor(self) -> None:
        """Start it again; a client finds it when its predecessor is forgotten, and by then the recording has ended."""
        self.start_conductor()
        self.graph.spin(_LINGERS)
        if self.recording.state in {RecorderState.RECORDING, RecorderState.PAUSED}:
            self.findings.append(f"{self.recording.uri} is recorded for nobody")

    def start_drive(self, machine: str = "ipm", name: str = DRIVE) -> None:
        """Start a drive."""
        given = ["--params-file", str(CONFIG / f"{DRIVE}.yaml"), "-p", f"machine:={machine}", "-r", f"__node:={name}"]
        self.nodes[name] = self._ready([f"drive_id.nodes.{DRIVE}", "--ros-args", *given, "-p", "i_max:=100.0"])

    def start_publisher(self) -> None:
        """Start the publisher, to run without end."""
        file = CONFIG / f"{PUBLISHER}.yaml"
        given = ["--params-file", str(file), "-p", "repeat:=0", "-p", "speed_max:=400.0"]
        self.nodes[PUBLISHER] = self._ready([f"drive_id.nodes.{PUBLISHER}", "--ros-args", *given])

    def _ready(self, arguments: list[str]) -> NodeProcess:
        import sys  # noqa: PLC0415  # only here

        process = self.graph.run([sys.executable, "-m", *arguments], arguments[0].rpartition(".")[2])
        if not self.graph.wait(lambda: "Ready" in process.text or not process.alive) or not process.alive:
            raise SystemExit(f"{arguments[0]} is not ready:\n{process.text}")
        return process

    def _on_currents(self, message: PhaseCurrents, info: Any) -> None:
        block = b"".join(phase.tobytes() for phase in (message.a, message.b, message.c))
        peak = float(np.abs(np.frombuffer(block, np.float32)).max())
        if peak > LIMIT:
            self.findings.append(f"{peak:.1f} A measured")
        when = self._sampled(message, _published(info))
        self._frozen = hash(block) in self._seen
        if not self._frozen:
            self._seen.add(hash(block))
            self.peaks.append((when, peak))

    def _sampled(self, message: PhaseCurrents, published: float) -> float:
        """Return when a block was complete."""
        count = message.first_sample + len(message.a)
        age = count * message.sample_period
        self.heard += message.first_sample not in self._zeros
        zero = min(self._zeros.pop(message.first_sample, np.inf), published - age)  # by the most prompt block
        self._zeros[count] = zero
        self.behind = published - age - zero
        self.lag = max(self.lag, self.behind)
        return float(zero + age)

    def _on_status(self, message: DriveStatus, info: Any) -> None:
        if self._frozen:  # samples that say nothing
            self.peaks.append((_published(info), float(np.hypot(message.i_d, message.i_q))))

    def _on_state(self, message: PublisherState) -> None:
        self.state, self.reason = message.state, message.reason

    def _on_recording(self, message: RecorderState) -> None:
        self.recording = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for value in status.values:
                if value.key == "/phase_currents: listeners":
                    self._listeners[status.name] = int(value.value)

    def set(self, node: str, **values: Any) -> bool:
        """Set parameters of a node."""
        given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        reply = self.graph.call(SetParameters, f"/{node}/set_parameters", parameters=given)
        return reply is not None and all(result.successful for result in reply.results)

    def call(self, name: str, **fields: Any) -> Any:
        """Call a service of the publisher."""
        return self.graph.call(SERVICES[name], f"/{PUBLISHER}/{name}", **fields)

    def begin(self) -> str:
        """Clear faults, start, and wait for current; return what went wrong."""
        self.leased, self.reason, self.state, self.heartbeat = True, "", "", self._own_beat
        self.revive()
        self.call("stop_experiment")  # the first call of a service takes the time to find it
        self.set(DRIVE, loss=0.0)
        begin = tried = time.monotonic()
        said = None
        while time.monotonic() < begin + _START:
            if self.behind > _BEHIND and time.monotonic() > tried + _CATCH_UP:
                self._end(DRIVE)
                self.start_drive()
                tried = time.monotonic()
            cleared = self.call("clear_fault")
            said = (
                self.call("start_experiment", require_lease=True)
                if cleared is not None and cleared.success
                else cleared
            )
            if said is not None and said.success:
                self.graph.wait(lambda: self.state == "tripped" or (self.peaks and self.peaks[-1][1] > 20.0), 5.0)
                if self.state != "tripped":  # a drive that has just been started may be late, and trip once more
                    return ""
            self.graph.spin(0.2)
        return f"no start: {said.message if said else 'no answer'} {self.reason}"

    def revive(self) -> None:
        """Start a node again that ended because it heard nobody any more after it was held up."""
        for name in (DRIVE, PUBLISHER):
            if not self.nodes[name].alive and "hears nobody" in self.nodes[name].text:
                self.nodes.pop(name)
                self.graph.forget(name)
                self._starts[name]()

    def rested(self, since: float) -> float:
        """Wait for rest, and return the time since then at which the last current was measured, s."""

        def over() -> bool:
            last = [when for when, peak in self.peaks if peak > REST]
            return time.monotonic() > max([since, *last[-1:]]) + QUIET

        self.graph.spin(QUIET)  # first of all, hear what has arrived meanwhile
        self.graph.wait(over, 10.0)
        return max((when for when, peak in self.peaks if peak > REST and when > since), default=since) - since

    def inject(self, hazard: Hazard) -> float:
        """Let something go wrong, and return when: for a fault of the drive, when it has confirmed it."""
        begin = time.monotonic()
        if hazard.killed:
            self._end(hazard.killed)
        elif hazard.act:
            getattr(self, hazard.act)()
        else:
            self.set(DRIVE, **hazard.faults)
        return begin if hazard.killed or hazard.act not in {"", "double"} else time.monotonic()

    def undo(self, hazard: Hazard) -> None:
        """Put it right again."""
        healthy = {"freeze": "none", "ignore_references": False, "trip": False, "restarts": 0}
        if hazard.killed:
            self._starts[hazard.killed]()
        elif hazard.faults:
            self.set(DRIVE, **{name: healthy.get(name, 0.0) for name in hazard.faults})
        elif hasattr(self, f"un_{hazard.act}"):
            getattr(self, f"un_{hazard.act}")()

    # Hazards

    def stop(self) -> None:
        """Stop."""
        self.call("stop_experiment")

    def press(self) -> None:
        """Press the emergency stop."""
        self.estop.publish(Bool(data=True))

    def un_press(self) -> None:
        """Release it."""
        self.estop.publish(Bool(data=False))

    def appear(self) -> None:
        """Create a second publisher of references."""
        self.rivals.append(self.graph.node.create_publisher(CurrentReference, "/current_reference", STREAM))

    def intrude(self) -> None:
        """Publish references in a session of its own: 50 A for half a second."""
        self.appear()
        self.graph.wait(lambda: self.rivals[-1].get_subscription_count() > 0, 2.0)
        message = CurrentReference(session=random.getrandbits(60) | 1, sample_period=1e-4)
        message.d, message.q = [50.0] * 5000, [0.0] * 5000
        message.header.stamp = self.graph.node.get_clock().now().to_msg()
        self.rivals[-1].publish(message)

    def un_appear(self) -> None:
        """Remove it."""
        while self.rivals:
            self.graph.node.destroy_publisher(self.rivals.pop())

    un_intrude = un_appear

    def overspeed(self) -> None:
        """Drive the shaft faster."""
        self.set(DRIVE, speeds=[1500.0])

    def un_overspeed(self) -> None:
        """Drive it as before."""
        self.set(DRIVE, speeds=[500.0])

    def die(self) -> None:
        """Send no heartbeats any more."""
        self.leased = False

    def _end(self, name: str) -> None:
        self.nodes.pop(name).end(signal.SIGKILL)
        self.graph.forget(name)

    def exchange(self) -> None:
        """Kill the drive, and start one of another machine in its place."""
        self._end(DRIVE)
        self.start_drive("spm")

    def un_exchange(self) -> None:
        """Put the first one back."""
        self._end(DRIVE)
        self.start_drive()

    def double(self) -> None:
        """Start a second drive on the same topics, and wait until everybody receives its blocks.

        On a busy computer, its messages reach this process first, and the publisher up to 2.5 s later: nothing of its
        own can tell the publisher of that drive before.
        """
        before = self.heard
        self._listeners.clear()
        self.start_drive("spm", RIVAL)
        everybody = self.graph.node.count_subscribers("/phase_currents")
        self.graph.wait(lambda: self.heard > before and self._listeners.get(f"/{RIVAL}", 0) >= everybody, _FOUND)

    def un_double(self) -> None:
        """End it."""
        self._end(RIVAL)

    def merged(self) -> str:
        """Return how a map of all that was heard is one of two drives; empty if it is not.

        As long as the second drive has not been heard, a map of the first one alone is right.
        """
        first = reply = self._mapped()
        end = time.monotonic() + _HEARD
        while reply.code == "ok" and time.monotonic() < end and {DRIVE, RIVAL} & set(self.nodes):
            self.graph.spin(0.2)
            reply = self._mapped()
        if reply.code == "ok" and {DRIVE, RIVAL} & set(self.nodes):
            return f"one map of two drives after {_HEARD:g} s: {reply.message}"
        before = self._mapped("before") if first.code == "ok" else first
        if before.code == "ok" and first.report.samples_read > before.report.samples_read:
            return f"one map of two drives: {first.message} Before the change, there were fewer: {before.message}"
        return ""

    def _mapped(self, part: str = "") -> Any:
        reply = self.graph.call(Identify, f"/{LISTENER}/identify", part=part)
        return Identify.Response(code="no answer") if reply is None else reply

    def suspend(self) -> None:
        """Hold up the publisher's process."""
        os.kill(self.nodes[PUBLISHER].popen.pid, signal.SIGSTOP)

    def un_suspend(self) -> None:
        """Let it go on."""
        os.kill(self.nodes[PUBLISHER].popen.pid, signal.SIGCONT)


def react(cell: Cell, name: str, allowance: float = 0.0) -> float:
    """Run one hazard, note findings, and return how long current flowed after it, s.

    It is repeated if the publisher trips for another reason: on a busy computer the simulated drive may be late.
    """
    hazard = HAZARDS[name]
    for _ in range(_ATTEMPTS):
        cell.peaks.clear()
        trouble = cell.begin()
        cell.graph.spin(random.uniform(0.1, 0.4))
        since = cell.inject(hazard)
        took = cell.rested(since)
        cell.undo(hazard)
        tripped = cell.graph.wait(lambda: not hazard.reason or cell.state == "tripped", 5.0)
        if hazard.reason in cell.reason:
            break
    else:
        cell.findings.append(f"{name}: the publisher is {cell.state} ({cell.reason})")
    if trouble or not tripped:
        cell.findings.append(f"{name}: {trouble or 'no trip'}")
    if took > hazard.stated + allowance:
        cell.findings.append(f"{name}: current flowed for {took:.3f} s")
    cell.graph.spin(QUIET)
    late = [peak for when, peak in cell.peaks if when > since + took + QUIET and peak > REST]
    if late:
        cell.findings.append(f"{name}: {max(late):.1f} A after it was put right")
    return took


def _makes_sense(cell: Cell, hazard: Hazard, done: dict[str, float]) -> bool:
    """Return whether a hazard can happen after what has been done, and when, and is one."""
    known = {name: (HAZARDS | OF_GOALS)[name] for name in done}
    over = [done[name] for name, one in known.items() if one.act in {"stop", "suspend"} or one.killed == PUBLISHER]
    if hazard.killed and hazard.killed not in cell.nodes:
        return False
    if hazard.act in {"stop", "press", "suspend"} and PUBLISHER not in cell.nodes:
        return False
    if (hazard.faults or hazard.act in {"overspeed", "exchange", "double"}) and DRIVE not in cell.nodes:
        return False
    if hazard.act == "intrude" and over:  # without a trip, or with nobody left who keeps others away
        return "drive restarts" not in done and time.monotonic() - min(over) < OWNED  # else the drive is free
    ends_publisher = hazard.act == "stop" or hazard.killed == PUBLISHER
    return not ("publisher stopped (SIGSTOP)" in done and ends_publisher)  # it does not answer


def _has_own_time(hazard: Hazard, done: dict[str, float]) -> bool:
    """Return whether current may flow for the time stated for a hazard, and not only for that of the first one.

    The publisher may not have acted upon the first one when it is killed or stopped, or the messages that tell of it
    are late; and a drive that is another one belongs to nobody: it follows an intruder until the publisher, which has
    tripped, brings it to zero.
    """
    free = bool(ANOTHER & set(done)) and hazard.act == "intrude"
    return len(done) == 1 or free or hazard.act == "suspend" or hazard.killed == PUBLISHER or "latency" in hazard.faults


def _can_be_told(done: Collection[str]) -> bool:
    """Return whether messages of another drive are heard: a restarted one loses its own, where all are lost."""
    return bool(ANOTHER & set(done) - ({"drive restarts"} if "all messages lost" in done else set()))


def script(cell: Cell, seed: int, number: int, allowance: float = 0.0) -> list[str]:
    """Run a random script: up to three hazards one shortly after the other, and return their names."""
    rng = random.Random(f"{seed} {number}")
    certain = sorted(name for name, hazard in HAZARDS.items() if not hazard.faults.items() & BY_CHANCE.items())
    names = rng.sample(certain, rng.choice((1, 1, 2, 3)))
    cell.peaks.clear()
    cell.lag = 0.0
    before = len(cell.findings)
    trouble = cell.begin()
    if LISTENER in cell.nodes:
        cell.graph.call(Command, f"/{LISTENER}/reset")
    cell.graph.spin(rng.uniform(0.0, 0.8))
    since, alive = time.monotonic(), set(cell.nodes)
    deadline = 0.0
    done: dict[str, float] = {}
    for name in names:
        hazard = HAZARDS[name]
        if not _makes_sense(cell, hazard, done):
            continue
        begin = done[name] = cell.inject(hazard)
        if _has_own_time(hazard, done):
            deadline = max(deadline, begin - since + hazard.stated)
        cell.graph.spin(rng.choice((0.0, 0.02, 0.1, 0.3)))
    cell.rested(since)
    if LISTENER in cell.nodes and _can_be_told(done) and (merged := cell.merged()):
        cell.findings.append(merged)
    for name in reversed(done):  # a node that was killed first
        cell.undo(HAZARDS[name])
    cell.graph.spin(QUIET)
    latest, last = max(((when - since, peak) for when, peak in cell.peaks if peak > REST), default=(0.0, 0.0))
    if latest > deadline + allowance:
        cell.findings.append(f"current flowed for {latest:.3f} s, more than {deadline:.3f} s: {last:.1f} A at last")
        cell.findings[-1] += f" (the drive published up to {cell.lag:.2f} s late)"
    if trouble:
        cell.findings.append(trouble)
    if not alive.issubset(cell.nodes):
        cell.findings.append("a node has died")
    cell.findings += [text for text in cell.graph.troubles() if text not in cell.findings]
    cell.findings[before:] = [f"{', '.join(done)}: {finding}" for finding in cell.findings[before:]]
    return list(done)


def goal(cell: Cell, seed: int, number: int, allowance: float = 0.0) -> str:
    """Run a random script during a goal; return its hazards and the code of the goal."""
    rng = random.Random(f"goal {seed} {number}")
    known = {name: hazard for name, hazard in (HAZARDS | OF_GOALS).items() if not hazard.act.startswith("overspeed")}
    names = rng.sample(sorted(known), rng.choice((1, 1, 2, 3)))
    before, phase = len(cell.findings), rng.choice(("waiting", *["trajectory"] * 4, "identifying"))
    if trouble := cell.begin():
        return f"{trouble} (not counted)"
    cell.stop()
    cell.rested(time.monotonic())
    cell.peaks.clear()
    handle = cell.send()
    if handle is None:
        cell.findings.append("nobody takes the goal")
        return ""
    over = handle.get_result_async()
    cell.graph.wait(lambda: over.done() or any(each.phase == phase for each in cell.feedback), 30.0)
    if phase == "trajectory":
        cell.graph.wait(lambda: over.done() or bool(cell.peaks and cell.peaks[-1][1] > 20.0), 10.0)
    cell.graph.spin(rng.uniform(0.0, 1.5))
    since, done = time.monotonic(), dict[str, float]()
    for name in names:
        unasked = known[name].act == "cancel" and CONDUCTOR not in cell.nodes
        free = known[name].act == "intrude" and phase != "trajectory"  # which follows anybody
        if _makes_sense(cell, known[name], done) and not unasked and not free:
            done[name] = cell.inject(known[name])
            cell.graph.spin(rng.choice((0.0, 0.02, 0.1, 0.3)))
    ended = cell.graph.wait(lambda: over.done() or CONDUCTOR not in cell.nodes, _ENDS + allowance)
    took = time.monotonic() - since
    result = over.result().result if over.done() else None
    code = "(killed)" if CONDUCTOR not in cell.nodes else result.code if result is not None else "none"
    if not ended or not code:
        cell.findings.append(f"no code within {took:.1f} s, last: {cell.feedback[-1:]}")
    rest = cell.rested(time.monotonic())
    if rest > max(known[name].stated for name in done or ["~/stop"]) + allowance:
        cell.findings.append(f"current flowed for {rest:.2f} s after the end of the goal")
    cell.findings += [] if result is None else _judged(result)
    for name in reversed(done):
        cell.undo(known[name])
    cell.leased = True
    cell.graph.spin(QUIET)
    cell.findings += [text for text in cell.graph.troubles() if text not in cell.findings]
    cell.findings[before:] = [f"{', '.join(done)}: {finding}" for finding in cell.findings[before:]]
    return f"{phase}, {', '.join(done)}: {code} after {took:.1f} s"


def _judged(result: Any) -> list[str]:
    """Return what is wrong with the bags of a goal, and with one that is said to be whole."""
    findings = []
    for uri in result.bags:
        with open_bag(Path(uri)) as bag:
            states = [message.data for message in bag.messages([f"/{PUBLISHER}/state"])]
            if not sum(1 for _ in bag.messages(bag.topics)):
                findings.append(f"{uri} is empty")
        if result.code == "ok" and not (states and deserialize_message(bytes(states[-1]), PublisherState).completed):
            findings.append(f"ok, but {uri} does not hold the end of the trajectory")
    if result.code == "ok" and (result.duration < _GOAL or not result.flux_map.inside or not result.output):
        findings.append(f"ok, but {result.duration:.2f} s were recorded, and the result is in '{result.output}'")
    return findings


def section(rounds: int) -> Section:
    """Run every hazard several times; the longest time counts, against the stated one."""
    with tempfile.TemporaryDirectory() as folder, Graph(Path(folder)) as graph:
        cell = Cell(graph)
        measured = {name: [react(cell, name) for _ in range(rounds)] for name in HAZARDS}
    rows = [
        Row(name, "", f"{max(times):.2f} s", "", "", f"≤ {HAZARDS[name].stated:g} s")
        for name, times in measured.items()
    ]
    text = (
        f"Time from the cause to zero measured current at {I_MAX:g} A, longest of {rounds}; 0.00 means that nothing\n"
        "was measured any more. What detects it, and what is done: [Hazards](safety_measured.md#hazards).\n"
        "Ten times each: `make safety`."
    )
    text += "".join(f"\n- Finding: {finding}" for finding in cell.findings)
    return Section("Reaction times", text, tuple(rows))


def main() -> int:
    """Print the table, run the scripts, and return 1 if there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=10, help="of each hazard")
    parser.add_argument("--scripts", type=int, default=0, help="random scripts")
    parser.add_argument("--goals", type=int, default=0, help="random scripts during goals of the node experiment")
    parser.add_argument("--seed", type=int, default=1, help="of the scripts")
    parser.add_argument("--replay", type=int, help=f"number of one script to run {_REPLAYS} times instead of all")
    parser.add_argument("--only", default="", help="hazards whose name contains this")
    parser.add_argument("--allowance", type=float, default=0.0, help="added to all stated times, s: for a busy machine")
    options = parser.parse_args()
    random.seed(options.seed)
    with tempfile.TemporaryDirectory() as folder, Graph(Path(folder)) as graph:
        cell = Cell(graph)
        if options.rounds:
            print("| hazard | stated, s | median, s | longest, s |\n|---|---|---|---|")
        for name, hazard in HAZARDS.items() if options.rounds else ():
            if options.only in name:
                times = [react(cell, name, options.allowance) for _ in range(options.rounds)]
                print(f"| {name} | {hazard.stated:g} | {np.median(times):.2f} | {max(times):.2f} |", flush=True)
        if options.scripts or options.replay is not None:
            cell.start_listener()
        numbers = range(options.scripts) if options.replay is None else [options.replay] * _REPLAYS
        for ran, number in enumerate(numbers, 1):
            found = len(cell.findings)
            done = script(cell, options.seed, number, options.allowance)
            for finding in cell.findings[found:]:
                print(f"script {number}: {finding}", flush=True)
            if ran % 20 == 0 or options.replay is not None:
                print(f"{ran} scripts, {len(cell.findings)} findings, last: {', '.join(done)}", flush=True)
        if options.goals:
            cell.start_nodes()
        for number in range(options.goals):
            found = len(cell.findings)
            print(f"goal {number}: {goal(cell, options.seed, number, options.allowance)}", flush=True)
            for finding in cell.findings[found:]:
                print(f"goal {number}: FINDING: {finding}", flush=True)
        print("\n".join(cell.findings) or "No findings.")
        return 1 if cell.findings else 0


if __name__ == "__main__":
    raise SystemExit(main())
