"""docs/nodes.md: its reference is what the tool makes of the nodes and definitions, and its prose is short."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from ros_bench import own_domain, require_ros

ROOT = Path(__file__).parents[1]
TOOL = runpy.run_path(str(ROOT / "tools" / "nodes_page.py"))
PAGE = ROOT / "docs" / "nodes.md"
MOST_WORDS = 3000


def test_the_reference_is_what_the_tool_makes():
    """Else: python tools/nodes_page.py."""
    require_ros()
    domain, lock = own_domain()
    code = f"import runpy; print(runpy.run_path({str(ROOT / 'tools' / 'nodes_page.py')!r})['page'](), end='')"
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    made = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    lock.close()
    assert made.returncode == 0, made.stderr
    assert made.stdout == PAGE.read_text(encoding="utf-8")


def test_the_prose_is_short():
    assert len(PAGE.read_text(encoding="utf-8").partition(TOOL["BEGIN"])[0].split()) <= MOST_WORDS


def test_all_fields_words_and_states_are_in_the_reference():
    text = PAGE.read_text(encoding="utf-8").partition(TOOL["BEGIN"])[2]
    for found in TOOL["definitions"]():
        section = text.partition(f"### {found.name}\n")[2].partition("\n### ")[0]
        for entry in (entry for part in found.parts for entry in part):
            assert entry.comment != "-", found.name
            for name, _ in (*entry.fields, *entry.words):
                assert f"`{name}`" in section, (found.name, name)
        path = next((ROOT / "msg_defs").glob(f"*/{found.name}"))
        fields = re.findall(r"^[\w/\[\]]+ (\w+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
        read = [name for part in found.parts for entry in part for name, _ in entry.fields]
        assert read == fields, found.name


@pytest.mark.parametrize("name", TOOL["TRANSITIONS"])
def test_the_states_of_the_chart_are_those_of_the_definition(name):
    message, field = name.split(".")
    found = next(each for each in TOOL["definitions"]() if each.name.partition(".")[0] == message)
    if message == "Experiment":
        words = next(entry.words for entry in found.parts[2] if entry.fields[0][0] == field)
    else:
        path = ROOT / "msg_defs" / "msg" / f"{message}.msg"
        words = re.findall(r"^string [A-Z_]+=(\w+)()", path.read_text(encoding="utf-8"), re.MULTILINE)
    shown = {state for begin, _, end in TOOL["TRANSITIONS"][name] for state in (*begin.split(", "), end)}
    assert shown - {"any", "the result `ok`", "another result"} == {value for value, _ in words}


def test_the_json_of_the_page_is_json_of_a_goal():
    require_ros()
    from drive_id_msgs.action import Experiment

    text = PAGE.read_text(encoding="utf-8")
    shown = [
        json.loads(each) for each in re.findall(r'^    (\{"op".*?\})\n(?=    \{|\n)', text, re.MULTILINE | re.DOTALL)
    ]
    assert [each["op"] for each in shown] == ["advertise", "send_action_goal", "publish", "cancel_action_goal"]
    Experiment.Goal(**shown[1]["args"])
