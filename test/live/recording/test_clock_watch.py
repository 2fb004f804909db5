"""A clock that stands still or is set back, recognized by a steady one."""

from __future__ import annotations

from drive_id.common.health import Level
from drive_id.live.recording.clock_watch import ClockWatch

SECOND = 10**9


def watched(times, every=0.25):
    """A watch that has looked at these times of the clock, s, every so many steady seconds."""
    watch = ClockWatch()
    for number, now in enumerate(times):
        watch.look(round(now * SECOND), number * every)
    return watch


def test_a_clock_that_runs_however_slowly_or_in_steps_is_none_of_it():
    for times in ([k * 0.25 for k in range(40)], [k * 1e-3 for k in range(40)], [k // 6 for k in range(40)]):
        watch = watched(times)
        assert watch.findings() == []
        assert watch.remark() == ""


def test_a_clock_that_stands_still_is_told_while_it_does_and_afterwards():
    watch = watched([1.0] * 13)
    ((level, said),) = watch.findings()
    assert level == Level.ERROR
    assert "stood still for 3.0 s" in said
    assert "stood still for 3.0 s of the recording" in watch.remark()
    watch.look(2 * SECOND, 3.25)
    assert watch.findings() == []
    assert "stood still for 3.0 s of the recording" in watch.remark()


def test_only_what_falls_into_the_recording_counts():
    watch = watched([1.0] * 13)
    watch.begin(3.0)
    assert watch.remark() == ""
    watch.look(SECOND, 4.0)
    assert watch.findings() == []  # not two seconds of this recording yet
    watch.look(SECOND, 6.0)
    assert "stood still for 3.0 s of" in watch.remark()
    watch.look(2 * SECOND, 6.1)
    watch.begin(6.1)
    assert watch.remark() == ""


def test_a_clock_that_is_set_back():
    watch = watched([5.0, 5.2, 3.7, 3.9])
    assert watch.findings() == []
    assert "set back by 1.500 s" in watch.remark()
