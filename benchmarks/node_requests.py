"""Many requests to the node ``identification``, valid, invalid and cancelled: tests replies and memory."""

from __future__ import annotations

import random
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drive_id_msgs.action import Identify as IdentifyAction
from drive_id_msgs.msg import PhaseCurrents, PhaseVoltages, Resolver
from drive_id_msgs.srv import Identify
from node_processes import Graph, NodeProcess, slope
from rclpy.action import ActionClient
from recordings import experiment

from drive_id.core.experiment.trajectories import Lissajous
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.writer import write_recording
from drive_id.nodes.support.qos import STREAM

TRAJECTORY = Lissajous(frequency_d=7.3, frequency_q=2.3)
"""A short recording covers it."""
TOPICS = {"/phase_currents": PhaseCurrents, "/phase_voltages": PhaseVoltages, "/resolver": Resolver}
SECONDS, LONGER = 2.0, 5.0
"""Lengths of the recordings, s; the longer one for method full."""
_EVERY = 10
"""Requests between two measurements of memory."""
_VALID = ("bag, joint", "bag, psm", "live, joint", "bag, full", "action")
_INVALID = ("no such bag", "outside", "not a bag", "damaged", "method", "long name", "many bags")
_WEIGHTS = {
    "bag, joint": 5,
    "bag, psm": 3,
    "live, joint": 5,
    "bag, full": 1,
    "action": 3,
    "cancel": 4,
    "two at once": 3,
}


@dataclass
class Answers:
    """Results of the requests."""

    sent: int = 0
    answered: int = 0
    codes: Counter[str] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)
    slowest: float = 0.0

    @property
    def growth(self) -> float:
        """Growth of the memory over the later two thirds, MB per 1000 requests."""
        return 1000 * slope(self.numbers, self.memory)


def many_requests(count: int, seed: int, folder: Path) -> Answers:
    """Send a number of requests.

    Parameters
    ----------
    count, seed : int
    folder : Path
        Scratch space.
    """
    data = folder / "data"
    data.mkdir(parents=True)
    _make_inputs(data)
    rng, answers = random.Random(seed), Answers()
    settings = {"data_directory": data, "output_directory": folder / "results", "results_count": 20, "i_max": 180.0}
    with Graph(folder) as graph:
        node = graph.start("identification", settings)
        _play(graph, data / "good")
        action = ActionClient(graph.node, IdentifyAction, "/identification/identify")
        graph.wait(action.server_is_ready)
        while answers.sent < count and node.alive:
            kinds = [*_WEIGHTS, *_INVALID]
            kind = rng.choices(kinds, [_WEIGHTS.get(each, 1) for each in kinds])[0]
            begin = time.monotonic()
            _one(graph, action, kind, rng, answers)
            answers.slowest = max(answers.slowest, time.monotonic() - begin)
            if answers.sent // _EVERY > len(answers.numbers) and node.alive:
                answers.numbers.append(answers.sent)
                answers.memory.append(node.memory)
                if len(answers.numbers) % 10 == 0:
                    print(f"{answers.sent} requests", file=sys.stderr, flush=True)
        action.destroy()
        _judge(graph, node, answers)
    return answers


def _make_inputs(data: Path) -> None:
    for name, seconds in (("good", SECONDS), ("longer", LONGER)):
        write_recording(data / name, experiment(seconds, trajectory=TRAJECTORY))
    file = next((data / "good").glob("*.mcap")).read_bytes()
    (data / "damaged.mcap").write_bytes(file[:20_000] + bytes(3000) + file[23_000:])
    (data / "text.txt").write_text("This is not a bag.\n", encoding="utf-8")


def _play(graph: Graph, bag: Path) -> None:
    """Publish a recording once, so that there are live samples."""
    publishers = {name: graph.node.create_publisher(kind, name, STREAM) for name, kind in TOPICS.items()}
    graph.wait(lambda: all(each.get_subscription_count() for each in publishers.values()))
    with open_bag(bag) as opened:
        for message in opened.messages(frozenset(TOPICS)):
            publishers[message.topic].publish(bytes(message.data))
            time.sleep(2e-3)
    graph.spin(1.0)


def _request(kind: str, rng: random.Random) -> dict[str, Any]:
    """Return the fields of a request."""
    return {
        "bag, joint": {"bags": ["good"], "method": "joint"},
        "bag, psm": {"bags": ["good"], "method": "psm"},
        "bag, full": {"bags": ["longer"], "method": "full"},
        "live, joint": {"bags": [], "method": "joint"},
        "no such bag": {"bags": [f"none_{rng.randrange(1000)}"], "method": "joint"},
        "outside": {"bags": [rng.choice(("../good", "/etc/passwd", "good/../../x", ""))], "method": ""},
        "not a bag": {"bags": ["text.txt"], "method": "joint"},
        "damaged": {"bags": ["damaged.mcap"], "method": "joint"},
        "method": {"bags": ["good"], "method": rng.choice(("FULL", "fulll", "static", "\n", "ä" * 50))},
        "long name": {"bags": ["x" * rng.randrange(200, 20_000)], "method": "joint"},
        "many bags": {"bags": ["good"] * rng.randrange(2, 9), "method": "joint"},
    }[kind]


def _one(graph: Graph, action: Any, kind: str, rng: random.Random, answers: Answers) -> None:
    """Send one request, or two at once, and record the replies."""
    if kind in ("action", "cancel"):
        answers.sent += 1
        _goal(graph, action, rng.random() * 0.6 if kind == "cancel" else None, answers)
        return
    names = rng.choices([*_VALID[:4], *_INVALID], k=2) if kind == "two at once" else [kind]
    futures = [graph.send(Identify, "/identification/identify", **_request(name, rng)) for name in names]
    for name, future in zip(names, futures, strict=True):
        answers.sent += 1
        if future is None or not graph.wait(future.done):
            answers.findings.append(f"{name}: no answer")
            continue
        _note(kind if len(names) > 1 else name, future.result(), answers)


def _goal(graph: Graph, action: Any, cancel_after: float | None, answers: Answers) -> None:
    """Send a goal, and cancel it after some time."""
    future = action.send_goal_async(IdentifyAction.Goal(bags=["good"], method="joint"), lambda _: None)
    if not graph.wait(future.done):
        answers.findings.append("action: no answer to the goal")
        return
    result = future.result().get_result_async()
    if cancel_after is not None:
        graph.spin(cancel_after)
        future.result().cancel_goal_async()
    if not graph.wait(result.done):
        answers.findings.append("action: no result")
        return
    _note("action" if cancel_after is None else "cancel", result.result().result, answers)


def _note(kind: str, reply: Any, answers: Answers) -> None:
    answers.answered += 1
    answers.codes[reply.code] += 1
    if kind in _VALID and not reply.success:
        answers.findings.append(f"{kind}: {reply.code}, {reply.message}")
    if kind in _INVALID and kind != "many bags" and reply.success:
        answers.findings.append(f"{kind}: succeeded")
    if not reply.message.endswith(".") or "Traceback" in reply.message or reply.code == "internal":
        answers.findings.append(f"{kind}: {reply.code}, not a sentence: {reply.message[:200]!r}")


def _judge(graph: Graph, node: NodeProcess, answers: Answers) -> None:
    if not node.alive:
        answers.findings.append(f"the node has ended: {node.text[-600:]}")
    answers.findings += graph.troubles()
