"""Every hazard of docs/engineering/safety_measured.md at process level, with the shipped parameter files.

Random scripts of several hazards are run by test_page_commands.py.
"""

from __future__ import annotations

import importlib
import re
import time
from pathlib import Path
from types import SimpleNamespace

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
    domain, lock = own_domain()
    with pytest.MonkeyPatch.context() as patch:
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
    """Return hazards and stated times of the table in docs/engineering/safety_measured.md."""
    text = (ROOT / "docs" / "engineering" / "safety_measured.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| ([^|]+) \|.*\| ([\d.]+) \| [\d.]+ \|$", text, re.MULTILINE)
    return {name: float(stated) for name, stated in found}


def test_the_table_states_the_times_that_are_checked(safety):
    assert rows() == {name: hazard.stated for name, hazard in safety.HAZARDS.items()}
    page = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    shown = {float(time) for time in re.findall(r"\| ([\d.]+) s \|$", page, re.MULTILINE)}
    assert shown == {hazard.stated for hazard in safety.HAZARDS.values()}


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


def bare_cell(safety, **attributes):
    cell = safety.Cell.__new__(safety.Cell)
    vars(cell).update(attributes)
    return cell


def test_a_late_block_counts_by_its_samples_also_where_two_drives_publish(safety):
    cell = bare_cell(safety, _zeros={}, behind=0.0, lag=0.0, heard=0)

    def when(first, published):
        return cell._sampled(SimpleNamespace(first_sample=first, a=[0.0] * 100, sample_period=1e-4), published)

    assert when(5000, 10.0) == pytest.approx(10.0)
    assert when(0, 10.0) == pytest.approx(10.0)
    assert when(5100, 10.31) == pytest.approx(10.01)  # 0.3 s late
    assert when(100, 10.21) == pytest.approx(10.01)
    assert cell.lag == pytest.approx(0.3)
    assert cell.heard == 2
    assert when(0, 20.0) == pytest.approx(20.0)  # restarted


@pytest.mark.parametrize(
    ("names", "own"),
    [
        (["drive restarts"], True),
        (["~/stop", "second publisher sends references"], False),
        (["drive restarts", "second publisher sends references"], True),  # the drive belongs to nobody
        (["drive restarts", "emergency stop"], False),
        (["emergency stop", "publisher killed"], True),
        (["samples of feedback frozen", "messages 0.4 s late"], True),
    ],
)
def test_which_hazards_of_a_script_have_a_time_of_their_own(safety, names, own):
    assert safety._has_own_time(safety.HAZARDS[names[-1]], dict.fromkeys(names, 0.0)) == own


def test_another_drive_is_told_by_its_messages_only(safety):
    assert safety._can_be_told(["drive restarts", "~/stop"])
    assert safety._can_be_told(["all messages lost", "second drive"])
    assert not safety._can_be_told(["all messages lost", "drive restarts"])
    assert not safety._can_be_told(["~/stop"])


@pytest.mark.parametrize(
    ("replies", "found"),
    [
        ([("drive_changed", 0)], ""),
        ([("ok", 7000), ("drive_changed", 0), ("ok", 7000)], ""),  # it had not heard the second drive yet
        ([("ok", 7000), ("drive_changed", 0), ("configuration", 0)], ""),  # too few came before
        ([("ok", 7100), ("drive_changed", 0), ("ok", 7000)], "Before the change, there were fewer"),
        ([("ok", 7000)] * 3, "one map of two drives after 0 s"),
    ],
)
@pytest.mark.slow  # the drives of a cell are made
def test_one_map_of_two_drives_is_a_finding(safety, monkeypatch, replies, found):
    from drive_id_msgs.srv import Identify

    queue = list(replies)

    def call(*_, **__):
        code, samples = queue.pop(0)
        reply = Identify.Response(code=code)
        reply.report.samples_read = samples
        return reply

    monkeypatch.setattr(safety, "_HEARD", 0.0 if found.endswith("0 s") else 20.0)
    graph = SimpleNamespace(call=call, spin=lambda _: None)
    said = bare_cell(safety, graph=graph, nodes={safety.DRIVE: None}).merged()
    assert found in said
    assert bool(found) == bool(said)
