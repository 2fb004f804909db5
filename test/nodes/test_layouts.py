"""The layouts for displays show what the nodes publish, and are whole.

Checked against what files of both tools have in common: neither is installed here.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from ros_bench import require_ros

CONFIG = Path(__file__).parent.parent.parent / "config"


@pytest.fixture(scope="module", autouse=True)
def _ros_or_skip():
    require_ros()


def operating_point_fields():
    from drive_id_msgs.msg import OperatingPoint

    return set(OperatingPoint.get_fields_and_field_types()) - {"header"}


def test_plotjuggler():
    root = ET.parse(CONFIG / "plotjuggler_layout.xml").getroot()
    (widget,) = root.findall("tabbed_widget")
    shown = set()
    for tab in widget.findall("Tab"):
        assert int(tab.get("containers")) == len(tab.findall("Container"))
    for splitter in widget.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.get("sizes").split(";")]
        assert len(sizes) == int(splitter.get("count")) == len(list(splitter))
        assert sum(sizes) == pytest.approx(1)
        assert splitter.get("orientation") in {"|", "-"}
    plots = list(widget.iter("plot"))
    assert len(plots) == len(list(widget.iter("DockArea")))
    for plot in plots:
        curves = plot.findall("curve")
        assert curves
        for curve in curves:
            names = ["curve_x", "curve_y"] if plot.get("mode") == "XYPlot" else ["name"]
            shown |= {curve.get(name) for name in names}
    assert shown == {f"/operating_point/{field}" for field in operating_point_fields()}


def leaves(tree):
    if isinstance(tree, str):
        return [tree]
    assert set(tree) == {"direction", "first", "second", "splitPercentage"}
    assert tree["direction"] in {"row", "column"}
    return [*leaves(tree["first"]), *leaves(tree["second"])]


def test_foxglove():
    from drive_id.nodes.support.replies import FIELDS

    layout = json.loads((CONFIG / "foxglove_layout.json").read_text())
    panels = layout["configById"]
    assert sorted(leaves(layout["layout"])) == sorted(panels)
    assert {name.partition("!")[0] for name in panels} == {"3D", "Plot", "DiagnosticSummary"}
    shown = set()
    for name, panel in panels.items():
        if name.startswith("Plot!"):
            paths = [*panel["paths"], *([panel["xAxisPath"]] if panel["xAxisVal"] == "custom" else [])]
            assert all(path["timestampMethod"] == "headerStamp" for path in paths)
            shown |= {path["value"] for path in paths}
    assert shown == {f"/operating_point.{field}" for field in operating_point_fields()}
    ((topic, look),) = panels["3D!drive_id_map"]["topics"].items()
    assert topic == "/flux_map_points"
    assert look["colorField"] in FIELDS
    assert {"x", "y", "z"} <= set(FIELDS)  # without them the panel shows nothing
