"""Every hazard of docs/safety.md at process level, with the shipped parameter files, and a few random scripts."""

from __future__ import annotations

import importlib
import random
import re
from pathlib import Path

import pytest
from ros_bench import own_domain, require_ros

ROOT = Path(__file__).parent.parent.parent
ALLOWANCE = 1.5
"""Added to all stated times, s: other tests keep this machine busy."""


@pytest.fixture(scope="module")
def safety():
    """The benchmark."""
    require_ros()
    domain, lock = own_domain(apart=37)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "benchmarks"))
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield importlib.import_module("safety")
    lock.close()


@pytest.fixture(scope="module")
def cell(safety, tmp_path_factory):
    with safety.Graph(tmp_path_factory.mktemp("safety")) as graph:
        yield safety.Cell(graph)


@pytest.fixture
def sound(cell):
    cell.findings.clear()
    yield cell
    assert cell.findings == []
    assert cell.graph.troubles() == []


def rows():
    """Return hazards and stated times of the table in docs/safety.md."""
    text = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| ([^|]+) \|.*\| ([\d.]+) \| [\d.]+ \|$", text, re.MULTILINE)
    return {name: float(stated) for name, stated in found}


def test_the_table_states_the_times_that_are_checked(safety):
    assert rows() == {name: hazard.stated for name, hazard in safety.HAZARDS.items()}


@pytest.mark.parametrize("name", rows())
def test_a_hazard_ends_at_zero_current(safety, sound, name):
    safety.react(sound, name, ALLOWANCE)


def test_random_scripts(safety, sound):
    rng = random.Random(7)
    for _ in range(8):
        safety.script(sound, rng, ALLOWANCE)
