"""The judgement of benchmarks/endurance.py: what must hold is found to hold, and what does not is found."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from ros_bench import require_ros

from drive_id.files.messages.block_codec import encode_block

if sys.platform != "linux":
    pytest.skip("the commands are measured by /proc", allow_module_level=True)


@pytest.mark.process
def test_no_worker_hangs_or_is_left():
    import interrupts

    tally = interrupts.rounds(len(interrupts.KINDS), seed=1)
    assert tally.findings == []


def test_a_hang_and_what_is_left_are_found(monkeypatch, tmp_path):
    import interrupts

    (tmp_path / "interrupts.py").write_text(
        "import subprocess, sys, time\n"
        "subprocess.Popen(['sleep', '3'], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)\n"
        "print('begun', flush=True)\n"
        "time.sleep(60 if sys.argv[1] == 'all good' else 0)\n"
    )
    monkeypatch.setattr(interrupts, "__file__", str(tmp_path / "interrupts.py"))
    monkeypatch.setattr(interrupts, "BOUND", 0.5)
    monkeypatch.setattr(interrupts, "_SHARED", tmp_path)
    found = interrupts.rounds(2, seed=1).findings
    assert [text.partition(": ")[2].split(":")[0] for text in found] == [
        "it hangs", "exit code -9", "exit code 0", "processes are left",
    ]  # fmt: skip


def test_growth_is_that_of_the_later_part():
    require_ros()
    from node_processes import slope

    times = list(np.arange(30.0))
    assert slope(times, [100.0] * 5 + [300.0] * 25) == pytest.approx(0.0, abs=1e-9)
    assert slope(times, [2.0 * time for time in times]) == pytest.approx(2.0)
    assert slope([0.0], [1.0]) == 0.0


def test_memory_and_replies_of_a_live_identification_are_judged():
    require_ros()
    from types import SimpleNamespace as Reply

    import live_watch
    from node_processes import Replies

    watched = live_watch.Watched(Replies())
    for number in range(31):  # every two minutes
        held = {"recorder": 80.0 + number, "identification": 300.0 if number < 4 else 500.0}
        watched.look(120.0 * number, held, {"recorder": 80.0 + number, "identification": 620.0})
    assert watched.row("identification") == ("300", "500", "620", "+0")
    assert watched.row("recorder") == ("80", "95", "110", "+30")
    for reply in (
        Reply(success=True, code="ok", message="Done."),
        Reply(success=False, code="coverage", message="Too small."),
        Reply(success=True, code="ok", message="Traceback (most recent call last)"),
        None,
    ):
        watched.replies.note("identify", reply, 3.0)
    assert watched.replies.codes == {"ok": 2, "coverage": 1, "no answer": 1}
    assert [said.split(": ", 1)[1].split(",")[0] for said in watched.replies.findings] == [
        "coverage",
        "ok",
        "no answer",
    ]
    assert watched.replies.slowest == 3.0


def test_the_most_memory_ever_held_is_not_forgotten():
    require_ros()
    import mmap
    import os

    from node_processes import highest, resident

    before = resident()
    with mmap.mmap(-1, 64_000_000) as held:  # pages of its own: the allocator would reuse what is resident already
        held[::4096] = b"x" * len(held[::4096])
    assert highest(os.getpid()) > before + 50.0


def test_what_was_heard_is_divided_where_its_node_was_started_again():
    require_ros()
    from node_kills import _runs

    def heard(*counts):
        values = [np.zeros(10, np.float32)] * 3
        return [(float(k), encode_block(0, count, 1e-4, values, "drive")) for k, count in enumerate(counts)]

    runs = _runs(heard(50, 60, 70, 0, 10, 5))
    assert [[when for when, _ in run] for run in runs] == [[0.0, 1.0, 2.0], [3.0, 4.0], [5.0]]


def test_only_the_end_of_a_killed_node_may_be_missing():
    require_ros()
    from node_kills import _cut

    assert _cut([True] * 50) == 0
    assert _cut([True] * 40 + [False] * 3) == 3
    assert _cut([True] * 40 + [False] * 6) == 0  # too many
    assert _cut([True] * 40 + [False] * 3 + [True]) == 0  # a hole
    assert _cut([True, False, True, False]) == 1
