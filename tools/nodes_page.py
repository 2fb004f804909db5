"""Write the reference of docs/nodes.md: what the nodes publish, subscribe to and serve, all fields, words and codes.

    python tools/nodes_page.py

Names and types are those of the running nodes, fields and codes those of msg_defs/. Run it when one of them changes.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "nodes.md"
BEGIN, END = "<!-- Written by tools/nodes_page.py -->\n", "<!-- End -->\n"
SCALARS = ("dc_link_voltage", "winding_temperature", "magnet_temperature", "shaft_torque")
TRANSITIONS = {
    "PublisherState.state": (
        ("idle", "a start", "ramp_in"),
        ("ramp_in", "the first point of the trajectory", "running"),
        ("running", "the end of the trajectory, or a stop", "ramp_out"),
        ("ramp_in", "a stop", "ramp_out"),
        ("ramp_out", "zero current; `completed` tells whether the end was reached", "idle"),
        ("ramp_in, running, ramp_out", "a trip: zero current", "tripped"),
        ("tripped", "`~/clear_fault`, when the cause is gone", "idle"),
    ),
    "Experiment.phase": (
        ("waiting", "nodes and drive are ready, and the shaft turns at the speed", "trajectory"),
        ("trajectory", "its end", "stopping"),
        ("stopping", "the bag is complete, and there is a further speed", "waiting"),
        ("stopping", "the bag of the last speed is complete", "identifying"),
        ("identifying", "the result is written", "the result `ok`"),
        ("any", "cancel, trip, stop, silence, refusal: zero current, and the bag is kept", "another result"),
    ),
    "RecorderState.state": (
        ("idle", "`~/start`", "recording"),
        ("recording", "`~/pause`, and back by `~/resume`", "paused"),
        ("recording, paused", "`~/stop`", "completing"),
        ("completing", "the bag is complete", "idle"),
        ("recording, paused", "the disk refuses, the bag is gone, or heartbeats cease", "failed"),
        ("failed", "`~/stop`, or a new `~/start`", "idle"),
    ),
}
"""State, what happens, and the next state."""
CHART = """\
    goal ──► waiting ──► trajectory ───────────────────► stopping ──► identifying ──► ok
                ▲        idle ► ramp_in ► running ► ramp_out │
                └──────────── next speed ────────────────────┘
    at any time: cancelled, tripped, ... ──► zero current, bag kept ──► the goal ends with its code
"""


@dataclass
class Entry:
    """Fields that share a comment, and the words that they may hold."""

    comment: str
    fields: list[tuple[str, str]] = field(default_factory=list)
    words: list[tuple[str, str]] = field(default_factory=list)  # value, comment


@dataclass
class Definition:
    """A file of msg_defs/: its comment, and the entries of each part."""

    name: str
    comment: str
    parts: list[list[Entry]]


def read(path: Path) -> Definition:
    """Read a definition."""
    parts: list[list[Entry]] = [[]]
    comment, above, head, fresh = "", "", "", True
    before = ""
    for line in [*path.read_text(encoding="utf-8").splitlines(), "---"]:
        if line.startswith("#"):
            comment = f"{comment if before.startswith('#') else ''} {line[1:].strip()}".strip()
        elif not line.strip() or line == "---":
            head = head or (comment if fresh and len(parts) == 1 and not parts[0] else "")
            comment, above, fresh = "", "", False
            if line == "---":
                parts.append([])
        else:
            if not above:
                parts[-1].append(Entry(comment))
            above, own = comment or above or "-", comment
            comment = "" if "=" not in line else comment
            text, _, said = line.partition("#")
            kind, _, name = text.strip().partition(" ")
            entry = parts[-1][-1]
            if "=" in name:
                entry.words.append(
                    (name.partition("=")[2].strip(), said.strip() or (own if own != entry.comment else ""))
                )
                comment = own
            else:
                if entry.fields and own:
                    parts[-1].append(entry := Entry(own))
                entry.fields.append((name.strip(), kind))
        before = line
    return Definition(path.name, head, parts[:-1])


def definitions() -> list[Definition]:
    """Return all definitions."""
    return [
        read(path) for folder in ("msg", "srv", "action") for path in sorted((ROOT / "msg_defs" / folder).iterdir())
    ]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |\n" for line in lines)


def fields_of(found: Definition) -> str:
    """Return the table of the fields of a definition."""
    names = {1: ("",), 2: ("request", "reply"), 3: ("goal", "result", "feedback")}[len(found.parts)]
    rows = []
    for name, entries in zip(names, found.parts, strict=True):
        for entry in entries:
            words = ", ".join(f"`{value}`" for value, _ in entry.words)
            kinds = dict.fromkeys(kind for _, kind in entry.fields)
            shown = [", ".join(f"`{each}`" for each, _ in entry.fields), ", ".join(f"`{kind}`" for kind in kinds)]
            rows.append([*([name] if name else []), *shown, f"{entry.comment}{f' Words: {words}.' if words else ''}"])
    head = ["part"] if len(names) > 1 else []
    return f"### {found.name}\n\n{found.comment}\n\n{table([*head, 'field', 'type', 'meaning'], rows)}\n"


def codes(found: Sequence[Definition]) -> str:
    """Return the table of all codes."""
    rows: dict[str, tuple[list[str], list[str]]] = {}
    for each in found:
        for value, said in (word for part in each.parts for entry in part for word in code_words(entry)):
            where, meanings = rows.setdefault(value, ([], []))
            where.append(each.name.partition(".")[0])
            meanings.append(said)
    shown = [
        [f"`{value}`", ", ".join(dict.fromkeys(where)), "; ".join(dict.fromkeys(filter(None, said)))]
        for value, (where, said) in sorted(rows.items())
    ]
    return table(("code", "of", "meaning"), shown)


def code_words(entry: Entry) -> list[tuple[str, str]]:
    """Return the codes of an entry, with what is said of them."""
    return entry.words if [name for name, _ in entry.fields] == ["code"] else []


def interfaces() -> str:
    """Return the tables of topics, services and actions, by the nodes themselves."""
    import rclpy  # noqa: PLC0415  # once the environment is set
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415
    from rclpy.qos import DurabilityPolicy  # noqa: PLC0415

    from drive_id.nodes.bench_simulator import BenchSimulator  # noqa: PLC0415
    from drive_id.nodes.identification import IdentificationNode  # noqa: PLC0415
    from drive_id.nodes.recorder import Recorder  # noqa: PLC0415
    from drive_id.nodes.support.middleware import fast_dds  # noqa: PLC0415
    from drive_id.nodes.trajectory_publisher import TrajectoryPublisher  # noqa: PLC0415
    from drive_id.ros.commissioning import Commissioning  # noqa: PLC0415
    from drive_id.ros.experiment import ExperimentNode  # noqa: PLC0415

    with fast_dds():
        scalars = f"bench_simulator:log_scalars:=[{', '.join(SCALARS)}]"
        rclpy.init(args=["--ros-args", "--log-level", "error", "-p", scalars])
        kinds: tuple[Any, ...] = (
            TrajectoryPublisher, Recorder, IdentificationNode, ExperimentNode, Commissioning, BenchSimulator,
        )  # fmt: skip
        nodes = [kind() for kind in kinds]
    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    for _ in range(300):  # what is subscribed to when somebody publishes it
        executor.spin_once(timeout_sec=0.01)
    topics: dict[str, tuple[str, set[str], set[str]]] = {}
    services, latched = [], set[str]()
    own = {node.get_name() for node in nodes}
    for node in nodes:
        name = node.get_name()
        for which, ask in enumerate(
            (node.get_publisher_names_and_types_by_node, node.get_subscriber_names_and_types_by_node)
        ):
            for topic, (kind, *_) in ask(name, "/"):
                topics.setdefault(topic, (kind, set(), set()))[1 + which].add(name)  # type: ignore[union-attr]
                infos = node.get_publishers_info_by_topic(topic)
                if any(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in infos):
                    latched.add(topic)
        services += node.get_service_names_and_types_by_node(name, "/")
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()
    return _listed(topics, latched, services, own)


def _listed(
    topics: dict[str, tuple[str, set[str], set[str]]], latched: set[str], services: list[Any], own: set[str]
) -> str:
    def plain(name: str) -> str:
        return f"`{name[1:] if name.count('/') == 1 and name != '/diagnostics' else name}`"

    hidden = ("/rosout", "/parameter_events", "/clock")
    shown = [
        [
            f"{plain(name)}{' (latched)' if name in latched else ''}", f"`{kind.replace('/msg/', '/')}`",
            ", ".join(sorted(publishers)), ", ".join(sorted(listeners)),
        ]
        for name, (kind, publishers, listeners) in sorted(topics.items())
        if name not in hidden and "/_action/" not in name and not name.endswith("/transition_event")
    ]  # fmt: skip
    of_rclpy = re.compile(r"(parameter|_state|_transition|_type_description|_states)")
    asked = {name: kind for name, (kind, *_) in services}
    actions = {name.partition("/_action/")[0]: kind for name, kind in asked.items() if name.endswith("send_goal")}
    served = {name: kind for name, kind in asked.items() if "/_action/" not in name and not of_rclpy.search(name)}
    assert own == {name.split("/")[1] for name in asked}, "each node was there"
    rows = [[f"`{name}`", f"`{kind.replace('/srv/', '/')}`"] for name, kind in sorted(served.items())]
    done = [
        [f"`{name}`", f"`{kind.replace('/action/', '/').removesuffix('_SendGoal')}`"]
        for name, kind in sorted(actions.items())
    ]
    return (
        f"### Topics\n\n{table(('topic', 'type', 'published by', 'subscribed to by'), shown)}\n"
        f"### Actions\n\n{table(('action', 'type'), done)}\n### Services\n\n{table(('service', 'type'), rows)}\n"
    )


def states() -> Iterator[str]:
    """Yield the tables of states."""
    for name, transitions in TRANSITIONS.items():
        yield f"`{name}`:\n\n{table(('state', 'when', 'next'), transitions)}\n"


def reference() -> str:
    """Return the generated part of the page."""
    found = definitions()
    everything = "".join(map(fields_of, found))
    return (
        f"### States\n\n{CHART}\n{''.join(states())}{interfaces()}### Codes\n\n{codes(found)}\n"
        f"## Fields of all messages\n\n{everything}"
    )


def page() -> str:
    """Return the page with its generated part made anew."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    assert end, f"{PAGE} has no place for the reference"
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            made = reference()
        finally:
            os.chdir(here)
    return f"{before}{BEGIN}\n{made.rstrip()}\n\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
