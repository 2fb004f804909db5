"""Many requests to the node ``identification``, valid, invalid and cancelled: tests replies and memory."""

from __future__ import annotations

import random
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drive_id_msgs.action import Identify as IdentifyAction
from drive_id_msgs.srv import Identify
from node_processes import TOPICS, Graph, slope
from rclpy.action import ActionClient
from recordings import experiment

from drive_id.core.experiment.trajectories import Lissajous
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.writer import write_recording
from drive_id.nodes.support.qos import STREAM

TRAJECTORY = Lissajous(frequency_d=7.3, frequency_q=2.3)
"""A recording of 2 s covers it."""
_EVERY = 10
"""Requests between two measurements of memory."""
_VALID = {"bag, joint": 5, "bag, psm": 3, "live, joint": 5, "action": 3, "cancel": 4, "two at once": 3}
_INVALID = ("no such bag", "outside", "not a bag", "damaged", "method", "long name", "many bags")
_WEIGHTS = {**_VALID, **dict.fromkeys(_INVALID, 1)}
"""Kinds of requests, and how often each comes."""


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

    def note(self, kind: str, reply: Any) -> None:
        """Judge one reply; None: there was none."""
        if reply is None:
            self.findings.append(f"{kind}: no answer")
            return
        self.answered += 1
        self.codes[reply.code] += 1
        if kind in _VALID and kind not in ("cancel", "two at once") and not reply.success:
            self.findings.append(f"{kind}: {reply.code}, {reply.message}")
        if kind in _INVALID and kind != "many bags" and reply.success:
            self.findings.append(f"{kind}: succeeded")
        if not reply.message.endswith(".") or "Traceback" in reply.message or reply.code == "internal":
            self.findings.append(f"{kind}: {reply.code}, not a sentence: {reply.message[:200]!r}")


def many_requests(count: int, seed: int, folder: Path) -> Answers:
    """Send so many requests, which the seed determines; ``folder`` is scratch space."""
    data = folder / "data"
    data.mkdir(parents=True)
    write_recording(data / "good", experiment(2.0, trajectory=TRAJECTORY))
    file = next((data / "good").glob("*.mcap")).read_bytes()
    (data / "damaged.mcap").write_bytes(file[:20_000] + bytes(3000) + file[23_000:])
    (data / "text.txt").write_text("This is not a bag.\n", encoding="utf-8")
    rng, answers = random.Random(seed), Answers()
    settings = {"data_directory": data, "output_directory": folder / "results", "results_count": 20, "i_max": 180.0}
    with Graph(folder) as graph:
        node = graph.start("identification", settings)
        _play(graph, data / "good")
        action = ActionClient(graph.node, IdentifyAction, "/identification/identify")
        graph.wait(action.server_is_ready)
        while answers.sent < count and node.alive:
            kind = rng.choices(list(_WEIGHTS), list(_WEIGHTS.values()))[0]
            begin = time.monotonic()
            _one(graph, action, kind, rng, answers)
            answers.slowest = max(answers.slowest, time.monotonic() - begin)
            if answers.sent // _EVERY > len(answers.numbers) and node.alive:
                answers.numbers.append(answers.sent)
                answers.memory.append(node.memory)
        action.destroy()
        if not node.alive:
            answers.findings.append(f"the node has ended: {node.text[-600:]}")
        answers.findings += graph.troubles()
    return answers


def _play(graph: Graph, bag: Path) -> None:
    """Publish a recording once, so that there are live samples."""
    names = [name for name in TOPICS if name != "/current_reference"]
    publishers = {name: graph.node.create_publisher(TOPICS[name], name, STREAM) for name in names}
    graph.wait(lambda: all(each.get_subscription_count() for each in publishers.values()))
    with open_bag(bag) as opened:
        for message in opened.messages(frozenset(names)):
            publishers[message.topic].publish(bytes(message.data))
            time.sleep(2e-3)
    graph.spin(1.0)


def _request(kind: str, rng: random.Random) -> dict[str, Any]:
    """Return the fields of a request."""
    bags = {
        "live, joint": [],
        "no such bag": [f"none_{rng.randrange(1000)}"],
        "outside": [rng.choice(("../good", "/etc/passwd", "good/../../x", ""))],
        "not a bag": ["text.txt"],
        "damaged": ["damaged.mcap"],
        "long name": ["x" * rng.randrange(200, 20_000)],
        "many bags": ["good"] * rng.randrange(2, 9),
    }.get(kind, ["good"])
    odd = rng.choice(("FULL", "fulll", "static", "\n", "ä" * 50))
    return {"bags": bags, "method": {"bag, psm": "psm", "method": odd}.get(kind, "joint")}


def _one(graph: Graph, action: Any, kind: str, rng: random.Random, answers: Answers) -> None:
    """Send one request, or two at once, or a goal, which may be cancelled, and judge the replies."""
    if kind in ("action", "cancel"):
        answers.sent += 1
        sent = action.send_goal_async(IdentifyAction.Goal(bags=["good"], method="joint"), lambda _: None)
        result = sent.result().get_result_async() if graph.wait(sent.done) else None
        if result is not None and kind == "cancel":
            graph.spin(rng.random() * 0.6)
            sent.result().cancel_goal_async()
        answers.note(kind, result.result().result if result is not None and graph.wait(result.done) else None)
        return
    single = [name for name in _WEIGHTS if name not in ("action", "cancel", "two at once")]
    names = rng.choices(single, k=2) if kind == "two at once" else [kind]
    futures = [graph.send(Identify, "/identification/identify", **_request(name, rng)) for name in names]
    for name, future in zip(names, futures, strict=True):
        answers.sent += 1
        reply = future.result() if future is not None and graph.wait(future.done) else None
        answers.note(kind if len(names) > 1 else name, reply)
