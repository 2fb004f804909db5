"""The SROS2 policy grants the nodes what they use, and nothing besides."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from ros_bench import require_ros, ros_bench

POLICY = Path(__file__).parent.parent.parent / "config" / "sros2" / "drive_id.policy.xml"
NODES = ("trajectory_publisher", "recorder", "identification", "live_feed", "experiment")
CLIENTS = ("conductor", "bench_client")
FROM_TIME = {"/clock", "/parameter_events"}
"""Needed with use_sim_time, or of releases of rclpy that listen to parameter events."""
AT_TIMES = {"/resolver"}
"""What the conductor listens to while it waits for a speed."""


@pytest.fixture(scope="module")
def ros():
    require_ros()
    from drive_id_msgs.msg import DriveStatus

    from drive_id.ros.bench import Bench
    from drive_id.ros.conductor import Conductor

    with ros_bench() as bench, Conductor(), Bench():
        bench.node.create_publisher(DriveStatus, "drive_status", 1)  # else nobody records it
        for name in NODES:
            parameters = {"data_directory": str(bench.folder)} if name in {"recorder", "identification"} else {}
            if name == "identification":
                parameters |= {"output_directory": str(bench.folder / "out")}
            room = "ros" if name == "experiment" else "nodes"
            bench.host(f"drive_id.{room}.{name}", parameters=parameters)
        yield bench


def granted(node):
    """Return the names that the policy grants a node, by element and qualifier."""
    profile = next(each for each in ET.parse(POLICY).iter("profile") if each.get("node") == node)
    found = {}
    for group in profile:
        for right, value in group.attrib.items():
            assert value == "ALLOW"
            names = {resolved(expression.text, node) for expression in group}
            found.setdefault((group.tag, right), set()).update(names)
    return found


def resolved(name, node):
    return f"/{node}{name[1:]}" if name.startswith("~") else name if name.startswith("/") else f"/{name}"


@pytest.mark.parametrize("node", [*NODES, *CLIENTS])
def test_the_policy_grants_what_a_node_uses(ros, node):
    graph = ros.node
    rights = granted(node)
    actions = rights.get(("actions", "execute"), set()) | rights.get(("actions", "call"), set())

    def used(of):
        ours = tuple(f"{action}/_action/" for action in actions)
        return {name for name, _ in of(node, "/") if not name.startswith(ours or ("//",))}

    services = rights["services", "reply"]
    ros.wait(lambda: (node, "/") in graph.get_node_names_and_namespaces(), f"the node {node}")
    published = rights["topics", "publish"]
    subscribed = rights["topics", "subscribe"] - FROM_TIME - (AT_TIMES if node == "conductor" else set())
    for names, of in (
        (services, graph.get_service_names_and_types_by_node),
        (published, graph.get_publisher_names_and_types_by_node),
        (subscribed, graph.get_subscriber_names_and_types_by_node),
    ):
        for name in sorted(names):
            ros.wait(lambda name=name, of=of: name in used(of), f"{name} of {node}")
    assert used(graph.get_publisher_names_and_types_by_node) == published
    assert used(graph.get_subscriber_names_and_types_by_node) - FROM_TIME == subscribed
    assert used(graph.get_service_names_and_types_by_node) == services

    assert used(graph.get_client_names_and_types_by_node) == rights.get(("services", "request"), set())
