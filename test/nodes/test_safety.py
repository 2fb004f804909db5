"""Every hazard of docs/safety.md at process level, with the shipped parameter files, and a few random scripts."""

from __future__ import annotations

import importlib
import re
import time
from pathlib import Path

import numpy as np
import pytest
from ros_bench import own_domain, require_ros
from simulated_time import stamp_of

ROOT = Path(__file__).parent.parent.parent
ALLOWANCE = 1.5
"""Added to all stated times, s: other tests keep this machine busy."""
HELD_UP = 3.0  # s


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


@pytest.mark.process
@pytest.mark.parametrize("name", rows())
def test_a_hazard_ends_at_zero_current(safety, sound, name):
    safety.react(sound, name, ALLOWANCE)


@pytest.mark.process
def test_a_publisher_held_up_for_3_s_sends_no_current_when_it_goes_on(safety, sound):
    """The drive has run out of set-points long before; what the process had in hand must not begin anew."""
    heard = []
    listener = sound.graph.node.create_subscription(safety.CurrentReference, "/current_reference", heard.append, 1000)
    assert sound.begin() == ""
    sound.graph.wait(lambda: any(any(block.d) for block in heard))
    sound.suspend()
    sound.graph.spin(HELD_UP)
    heard.clear()
    since, clock = time.monotonic(), time.time()
    sound.un_suspend()
    assert sound.graph.wait(lambda: sound.state == "tripped")
    sound.graph.spin(1.0)
    assert heard[-1].safe
    for block in heard:  # one may have been with the middleware when the process was stopped: it is long over
        over = stamp_of(block) * 1e-9 + len(block.d) * block.sample_period < clock - HELD_UP / 2
        assert over or (block.safe and not np.any(block.d) and not np.any(block.q))
    assert max(peak for when, peak in sound.peaks if when > since) < safety.REST
    assert sound.state == "tripped"
    assert re.search("too late|Nothing has arrived|no heartbeat|behind the clock|does not follow", sound.reason)
    sound.graph.node.destroy_subscription(listener)
    process = sound.nodes[safety.PUBLISHER]
    reply = sound.call("stop_experiment") if process.alive else None
    if reply is not None:
        assert "It tripped" in reply.message
        assert sound.call("start_experiment").code == "tripped"
    else:  # Fast DDS has made it deaf, which it finds within moments, perhaps after it was called
        assert sound.graph.wait(lambda: not process.alive)
        assert "hears nobody any more: start it again" in process.text


@pytest.mark.process
def test_random_scripts(safety, sound):
    for number in range(4):  # `make safety` tries as many as one likes
        safety.script(sound, 7, number, ALLOWANCE)
