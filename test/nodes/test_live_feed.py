"""``live_feed`` prints what topics tell, of its own drive only, and ends when nobody reads."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest


def test_it_prints_what_the_topics_of_its_drive_tell(ros, capsys):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from drive_id_msgs.msg import DriveStatus, OperatingPoint, PublisherState
    from rclpy.qos import DurabilityPolicy, QoSProfile

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    state = ros.node.create_publisher(PublisherState, "/one/trajectory_publisher/state", latched)
    state.publish(PublisherState(state="tripped", reason="Why.", duration=float("inf")))  # before the feed is there
    feed, lines = ros.host("drive_id.nodes.live_feed", namespace="/one"), []
    points = ros.node.create_publisher(OperatingPoint, "/one/operating_point", 10)
    others = ros.node.create_publisher(OperatingPoint, "/two/operating_point", 10)
    status = ros.node.create_publisher(DriveStatus, "/one/drive_status", 10)
    health = ros.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    values = {"fit: samples": "5000", "fit: resistance [ohm]": "0.02", "fit: sigma of resistance [ohm]": "0.0001"}
    entries = [KeyValue(key=key, value=value) for key, value in values.items()]
    names = {"/one/identification": "/one", "/two/identification": "/two"}
    statuses = [DiagnosticStatus(name=n, hardware_id=h, level=b"\1", values=entries) for n, h in names.items()]

    def told(name):
        points.publish(OperatingPoint(i_d=1.0, i_q=2.0, speed=3.0))
        others.publish(OperatingPoint(i_d=7.0, i_q=7.0))
        status.publish(DriveStatus(enabled=True, fault="", speed=3.0, dc_link_voltage=float("nan")))
        health.publish(DiagnosticArray(status=statuses))
        lines.extend(json.loads(line) for line in capsys.readouterr().out.splitlines())
        return next((line[name] for line in lines if name in line), None)

    for name, expected in (
        ("publisher", {"state": "tripped", "reason": "Why.", "duration": None}),
        ("drive", {"enabled": True, "fault": "", "dc_link_voltage": None}),
        ("resistance", {"estimates": [[5000, 20.0, 0.1]], "forecast": "R is within 0.98 % (95 %)."}),
    ):
        ros.wait(lambda name=name: told(name) is not None, name)
        found = told(name)
        assert {key: found[key] for key in expected} == expected
    ros.wait(lambda: told("points") is not None, "points")
    assert {tuple(point) for line in lines for point in line.get("points", [])} == {(1.0, 2.0)}
    assert {name for line in lines for name in line.get("nodes", {})} == {"/one/identification"}
    feed.end()


@pytest.mark.process
def test_it_ends_when_nobody_reads(ros):
    assert ros.node
    nobody_speaks = ("--ros-args", "-r", "__ns:=/alone")
    feed = subprocess.Popen([sys.executable, "-m", "drive_id.nodes.live_feed", *nobody_speaks], stdout=subprocess.PIPE)
    assert feed.stdout.readline() == b"{}\n"
    feed.stdout.close()
    assert feed.wait(60) == 0
