"""Many requests to the node ``identification``, valid, invalid and cancelled: tests replies and memory."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drive_id_msgs.action import Identify as IdentifyAction
from drive_id_msgs.srv import Identify
from node_processes import TOPICS, Graph, Replies, slope
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
_OPEN = ("cancel", "two at once", "many bags")
_SUCCESS = {kind: None if kind in _OPEN else kind in _VALID for kind in _WEIGHTS}
"""Whether a request of a kind must succeed, or must not; None: both is right."""


@dataclass
class Requests:
    """The replies to requests, and the memory of the node, MB, after some numbers of them."""

    replies: Replies
    sent: int = 0
    memory: list[float] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)

    @property
    def growth(self) -> float:
        """Growth of the memory over the later two thirds, MB per 1000 requests."""
        return 1000 * slope(self.numbers, self.memory)


def many_requests(count: int, seed: int, folder: Path) -> Requests:
    """Send so many requests, which the seed determines; ``folder`` is scratch space."""
    data = folder / "data"
    data.mkdir(parents=True)
    write_recording(data / "good", experiment(2.0, trajectory=TRAJECTORY))
    file = next((data / "good").glob("*.mcap")).read_bytes()
    (data / "damaged.mcap").write_bytes(file[:20_000] + bytes(3000) + file[23_000:])
    (data / "text.txt").write_text("This is not a bag.\n", encoding="utf-8")
    rng = random.Random(seed)
    settings = {"data_directory": data, "output_directory": folder / "results", "results_count": 20, "i_max": 180.0}
    with Graph(folder) as graph:
        requests = Requests(graph.replies)
        node = graph.start("identification", settings)
        _play(graph, data / "good")
        action = ActionClient(graph.node, IdentifyAction, "/identification/identify")
        graph.wait(action.server_is_ready)
        while requests.sent < count and node.alive:
            kind = rng.choices(list(_WEIGHTS), list(_WEIGHTS.values()))[0]
            requests.sent += _one(graph, action, kind, rng)
            if requests.sent // _EVERY > len(requests.numbers) and node.alive:
                requests.numbers.append(requests.sent)
                requests.memory.append(node.memory)
        action.destroy()
        if not node.alive:
            graph.replies.findings.append(f"the node has ended: {node.text[-600:]}")
        graph.replies.findings += graph.troubles()
    return requests


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


def _one(graph: Graph, action: Any, kind: str, rng: random.Random) -> int:
    """Send a request, or two at once, or a goal, which may be cancelled; judge the replies, and return their number."""
    begin = time.monotonic()
    if kind in ("action", "cancel"):
        sent = action.send_goal_async(IdentifyAction.Goal(bags=["good"], method="joint"), lambda _: None)
        result = sent.result().get_result_async() if graph.wait(sent.done) else None
        if result is not None and kind == "cancel":
            graph.spin(rng.random() * 0.6)
            sent.result().cancel_goal_async()
        reply = result.result().result if result is not None and graph.wait(result.done) else None
        graph.replies.note(kind, reply, time.monotonic() - begin, success=_SUCCESS[kind])
        return 1
    single = [name for name in _WEIGHTS if name not in ("action", "cancel", "two at once")]
    names = rng.choices(single, k=2) if kind == "two at once" else [kind]
    futures = [graph.send(Identify, "/identification/identify", **_request(name, rng)) for name in names]
    for name, future in zip(names, futures, strict=True):
        reply = future.result() if future is not None and graph.wait(future.done) else None
        graph.replies.note(name, reply, time.monotonic() - begin, success=_SUCCESS[name if len(names) == 1 else kind])
    return len(names)
