"""The course of an experiment: every state, every way out of it, and what a drive sees of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_id.core.experiment import state_machine
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.state_machine import LARGEST_BLOCK, Experiment, ExperimentState
from drive_id.errors import ConfigurationError

MS = 1_000_000
T0 = 1_700_000_000 * 1000 * MS
PLAIN = ExperimentSettings(
    i_max=10.0, frequency_d=3.0, frequency_q=1.0, duration=0.5, slew_rate=1000.0, sample_period=1e-3, lead_time=0.1,
)  # fmt: skip


class Drive:
    """A slow, independent drive: keeps each set-point by its stamp, and lets a block replace what follows it."""

    def __init__(self):
        self.due = {}
        self.next = None
        self.blocks = []

    def take(self, blocks):
        for block in blocks:
            assert 0 < len(block.i_dq) <= LARGEST_BLOCK
            assert self.next is None or block.first_sample == self.next, "the running count has a gap"
            self.next = block.first_sample + len(block.i_dq)
            self.due = {stamp: value for stamp, value in self.due.items() if stamp < block.stamp}
            step = block.sample_period * 1e9
            self.due |= {block.stamp + round(k * step): value for k, value in enumerate(block.i_dq.astype(float))}
            self.blocks.append(block)

    def seen(self):
        """Return the set-points in the order in which they come due."""
        return np.array([self.due[stamp] for stamp in sorted(self.due)])

    def at(self, now):
        stamps = [stamp for stamp in self.due if stamp <= now]
        return self.due[max(stamps)] if stamps else np.zeros(2)


class Offset:
    """A trajectory that does not begin at zero current."""

    i_max = 10.0
    duration = 0.2
    slope = 0.0

    def __call__(self, t):
        return np.broadcast_to(np.array([6.0, -8.0]), (len(t), 2))


@pytest.fixture
def offset(monkeypatch):
    """Have all experiments follow a trajectory that does not begin at zero current."""
    monkeypatch.setattr(state_machine, "make_trajectory", lambda _: Offset())


class Run:
    """An experiment and its drive in time; one tick is 10 ms."""

    def __init__(self, chosen=PLAIN):
        self.experiment = Experiment(chosen)
        self.drive = Drive()
        self.now = T0
        self.states = []

    def start(self):
        self.experiment.start(self.now)
        self.advance()

    def advance(self):
        self.drive.take(self.experiment.advance(self.now))
        self.states.append(self.experiment.state(self.now))

    def ticks(self, count):
        for _ in range(count):
            self.now += 10 * MS
            self.advance()

    def until_idle(self, most=5000):
        for _ in range(most):
            if not self.experiment.active:
                return
            self.ticks(1)
        pytest.fail("it does not end")

    def to(self, state):
        while self.experiment.state(self.now) is not state:
            self.ticks(1)


def started(chosen=PLAIN, ticks=0, **changes):
    """Return a run that has been started this many ticks ago."""
    run = Run(dataclasses.replace(chosen, **changes))
    run.start()
    run.ticks(ticks)
    return run


def assert_smooth(seen, chosen):
    steps = np.hypot(*np.diff(seen, axis=0, prepend=np.zeros((1, 2))).T)
    assert steps.max() <= chosen.slew_rate * chosen.sample_period + 4e-7 * chosen.i_max


def ends_at_zero(seen, zeros):
    assert np.all(seen[-zeros:] == 0.0)


def test_nothing_happens_before_a_start():
    run = Run()
    run.ticks(10)
    assert (run.drive.blocks, set(run.states)) == ([], {ExperimentState.IDLE})


@pytest.mark.usefixtures("offset")
def test_the_whole_course():
    run = started(slew_rate=100.0, frequency_d=0.0, frequency_q=0.0)
    run.until_idle()
    order = list(dict.fromkeys(run.states))
    assert order == [ExperimentState.RAMP_IN, ExperimentState.RUNNING, ExperimentState.RAMP_OUT, ExperimentState.IDLE]
    seen = run.drive.seen()
    assert_smooth(seen, run.experiment.settings)
    ends_at_zero(seen, 100)
    there = np.all(np.isclose(seen, [6.0, -8.0], atol=1e-4), axis=1)
    assert there.sum() == 201  # the end of the ramp, and 0.2 s; inside the rim by a hair
    assert len(seen) == 100 + 200 + 100 + 100  # ramps of 10 A at 100 A/s, the trajectory, the final zeros
    assert run.experiment.stop_reason == ""


def test_set_points_are_those_of_the_trajectory_at_their_time():
    run = started(ticks=17)
    run.now += 3 * MS + 12345  # a tick that comes when it likes
    run.advance()
    run.ticks(10)
    seen = run.drive.seen()
    count = min(len(seen), 300)
    expected = run.experiment._trajectory(np.arange(count) * 1e-3)
    np.testing.assert_allclose(seen[:count], expected, atol=1e-5)
    assert np.all(np.diff(sorted(run.drive.due)) == MS)


def test_set_points_reach_ahead_by_the_lead_time():
    run = started()
    for _ in range(20):
        run.ticks(1)
        assert 98 * MS < max(run.drive.due) - run.now <= 100 * MS


@pytest.mark.parametrize("repeat", [1, 3])
def test_repetitions(repeat):
    run = started(trajectory="spiral", spiral_turns=2.0, repeat=repeat)
    run.until_idle()
    assert len(run.drive.seen()) == pytest.approx(repeat * 500 + 100, abs=2)


def test_without_end_until_stopped():
    run = started(ticks=1000, repeat=0)
    assert run.experiment.state(run.now) is ExperimentState.RUNNING
    run.experiment.stop(run.now, "enough")
    run.until_idle()
    assert run.experiment.stop_reason == "enough"


def test_a_stop_takes_back_what_was_published_ahead():
    run = started(ticks=30)
    before = run.drive.at(run.now)
    assert np.hypot(*before) > 1.0
    run.experiment.stop(run.now, "stop")
    run.advance()
    assert run.experiment.state(run.now + 2 * MS) is ExperimentState.RAMP_OUT
    assert_smooth(run.drive.seen(), PLAIN)
    run.until_idle()
    seen = run.drive.seen()
    assert_smooth(seen, PLAIN)
    ends_at_zero(seen, 100)
    assert np.all(run.drive.at(run.now) == 0.0)
    assert (max(run.drive.due) - T0) * 1e-9 < 0.3 + 0.01 + 0.1 + 0.02


@pytest.mark.parametrize("state", [ExperimentState.RAMP_IN, ExperimentState.RUNNING, ExperimentState.RAMP_OUT])
@pytest.mark.parametrize("how", ["stop", "trip", "cut", "finish", "stop, trip", "stop, cut", "trip, cut", "cut, cut"])
@pytest.mark.usefixtures("offset")
def test_every_way_out_of_every_state(state, how):
    chosen = dataclasses.replace(PLAIN, slew_rate=50.0, frequency_d=0.0, frequency_q=0.0)
    run = started(chosen)
    run.to(state)
    run.ticks(3)
    jumps = "cut" in how
    for action in how.split(", "):
        if action == "stop":
            run.experiment.stop(run.now, "stopped")
        elif action == "finish":
            run.drive.take(run.experiment.finish(run.now, "finished"))
            assert not run.experiment.active
            break
        else:
            run.experiment.trip(run.now, action, immediate=action == "cut")
        run.advance()
        run.now += MS // 2
    if jumps:
        assert np.all(run.drive.at(run.now + MS) == 0.0)
    run.until_idle()
    seen = run.drive.seen()
    ends_at_zero(seen, 95)
    if not jumps:
        assert_smooth(seen, chosen)
    tripped = [action for action in how.split(", ") if action in {"trip", "cut"}]
    assert run.experiment.trip_reason == (tripped[0] if tripped else "")
    assert run.experiment.state(run.now) is (ExperimentState.TRIPPED if tripped else ExperimentState.IDLE)
    assert len(run.drive.due) == len(seen)


def test_a_fault_that_lasts_does_not_flood_the_topic():
    run = started(ticks=30)
    for _ in range(50):
        run.experiment.trip(run.now, "overcurrent", immediate=True)
        run.advance()
        run.now += 5 * MS
    assert not run.experiment.active
    assert run.drive.next < 300 + 50 + 100 + 110


@pytest.mark.parametrize("held_up", [0, 100 * MS])
def test_two_overrides_within_one_sample_do_not_jump(held_up):
    """Also where the last set-point that was published is due."""
    run = started(ticks=30)
    run.now += held_up
    due = run.drive.at(run.now)
    run.experiment.stop(run.now, "stop")
    np.testing.assert_allclose(run.experiment.current(run.now), due, atol=1e-6)
    assert run.experiment.state(run.now) is ExperimentState.RUNNING  # until the next set-point is due
    run.advance()
    run.experiment.trip(run.now + 1000, "trip", immediate=False)
    run.advance()
    run.until_idle()
    assert_smooth(run.drive.seen(), PLAIN)


@pytest.mark.parametrize("how", ["stop", "trip", "cut"])
@pytest.mark.parametrize("delay", [0, 1, 1_500_000, 20_000_000])
def test_what_is_published_after_a_stop_may_come_a_little_later(how, delay):
    """As it does in a node, which reads the clock again."""
    run = started(ticks=30)
    if how == "stop":
        run.experiment.stop(run.now, "stop")
    else:
        run.experiment.trip(run.now, "trip", immediate=how == "cut")
    run.now += delay
    run.advance()
    assert run.drive.blocks[-1].stamp <= run.now + MS
    run.until_idle()
    ends_at_zero(run.drive.seen(), 100)
    assert run.experiment.trip_reason == ("" if how == "stop" else "trip")


def test_a_trip_stays_until_the_next_start():
    run = started(ticks=20)
    run.experiment.trip(run.now, "first", immediate=False)
    run.experiment.trip(run.now, "second", immediate=False)
    run.until_idle()
    run.ticks(100)
    assert (run.experiment.state(run.now), run.experiment.trip_reason) == (ExperimentState.TRIPPED, "first")
    run.start()
    run.ticks(20)
    assert (run.experiment.state(run.now), run.experiment.trip_reason) == (ExperimentState.RUNNING, "")
    run.until_idle()
    ends_at_zero(run.drive.seen(), 100)


def test_nothing_trips_what_is_not_running():
    run = Run()
    run.experiment.trip(run.now, "no", immediate=True)
    run.experiment.stop(run.now, "no")
    assert run.experiment.finish(run.now, "no") == []
    assert run.experiment.state(run.now) is ExperimentState.IDLE


def test_held_up_too_long():
    """The drive has run out of set-points and is at zero: going on would be a jump."""
    run = started(ticks=30)
    run.now += 150 * MS
    run.advance()
    assert "0.05 s too late" in run.experiment.trip_reason.replace("0.050", "0.05").replace("0.049", "0.05")
    assert np.all(run.drive.at(run.now + MS) == 0.0)
    assert np.all(run.experiment.current(run.now) == 0.0)
    run.until_idle()
    ends_at_zero(run.drive.seen(), 100)


@pytest.mark.parametrize("held_up", [60 * MS, 150 * MS, 3000 * MS])
@pytest.mark.usefixtures("offset")
def test_held_up_between_a_start_and_its_first_block(held_up):
    """The first set-points were due after half of lead_time, so the ramp would begin somewhere in its midst."""
    run = Run()
    run.experiment.start(run.now)
    run.now += held_up
    run.advance()
    run.until_idle()
    assert "too late to publish ahead" in run.experiment.trip_reason
    assert run.drive.blocks[0].safe
    assert not run.drive.seen().any()


def test_held_up_between_a_block_and_its_publication():
    run = started(ticks=30)
    run.now += 10 * MS
    (block,) = run.experiment.advance(run.now)
    assert block.i_dq.any()
    assert not run.experiment.withhold(run.now + 89 * MS, block)
    assert run.experiment.trip_reason == ""
    run.now += 3000 * MS
    assert run.experiment.withhold(run.now, block)
    assert "too late to publish ahead" in run.experiment.trip_reason
    after = run.experiment.advance(run.now)
    assert all(block.safe and not block.i_dq.any() for block in after)
    assert not any(run.experiment.withhold(run.now + 3000 * MS, block) for block in after)  # a way to zero never is


def test_held_up_less_than_the_lead_time_does_not_matter():
    run = started()
    for _ in range(8):
        run.now += 95 * MS
        run.advance()
    run.until_idle()
    assert run.experiment.trip_reason == ""
    assert_smooth(run.drive.seen(), PLAIN)


def test_the_clock_is_set_back():
    run = started(ticks=30)
    run.now -= 3_600_000 * MS
    blocks = run.experiment.advance(run.now)
    assert run.experiment.trip_reason == "The clock was set back by 3600.000 s."
    assert blocks
    assert all(np.all(block.i_dq == 0.0) for block in blocks)
    assert abs(blocks[0].stamp - run.now) <= 2 * MS
    while run.experiment.active:
        run.now += 10 * MS
        run.experiment.advance(run.now)


def test_the_clock_stands_still():
    run = started(ticks=30)
    count = run.drive.next
    for _ in range(100):
        run.advance()
    assert run.drive.next == count
    run.ticks(5)
    assert run.experiment.state(run.now) is ExperimentState.RUNNING


def test_coverage_grows_with_the_experiment():
    run = started(ticks=50, sample_period=1e-4, duration=3.0, frequency_d=7.3, frequency_q=2.3)
    early = run.experiment.coverage
    run.until_idle()
    assert 0.1 < early < 0.8
    assert run.experiment.coverage > 0.85


def test_coverage_counts_what_has_come_due_not_what_is_published_ahead():
    """With 3 s published ahead, half of the disc was "visited" before the first set-point was due."""
    chosen = dataclasses.replace(PLAIN, sample_period=1e-3, duration=5.0, lead_time=3.0)
    run = started(chosen)
    assert len(run.drive.due) > 1000
    assert run.experiment.coverage == 0.0
    run.ticks(100)  # 1 s; the first set-point was due after half of lead_time
    assert run.experiment.state(run.now) is ExperimentState.RAMP_IN
    assert run.experiment.coverage == 0.0
    run.ticks(250)
    due = np.array([value for stamp, value in sorted(run.drive.due.items()) if stamp <= run.now])
    cells = {tuple(cell) for cell in np.rint(due / (2 * chosen.i_max / 20)).astype(int)}  # 21 nodes along each axis
    axis = np.linspace(-chosen.i_max, chosen.i_max, 201)
    disc = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    disc = disc[np.hypot(*disc.T) <= chosen.i_max]
    visited = np.mean([tuple(cell) in cells for cell in np.rint(disc / (2 * chosen.i_max / 20)).astype(int)])
    assert run.experiment.coverage == pytest.approx(visited, abs=0.1)
    assert 0.2 < visited < 0.9
    before = run.experiment.coverage
    run.experiment.stop(run.now, "enough")  # takes back what was published ahead
    run.until_idle()
    assert run.experiment.coverage == pytest.approx(before, abs=0.05)


chosen_settings = st.builds(
    dict,
    trajectory=st.sampled_from(["lissajous", "stair", "spiral"]),
    i_max=st.floats(1e-3, 1e5),
    frequency_d=st.floats(0.0, 20.0),
    frequency_q=st.floats(0.0, 20.0),
    form=st.sampled_from(["smooth", "printed"]),
    duration=st.floats(0.01, 2.0),
    stair_points=st.integers(3, 9),
    dwell_time=st.floats(1e-3, 0.05),
    spiral_turns=st.floats(0.5, 20.0),
    repeat=st.integers(0, 2),
    slew_rate=st.floats(1.0, 1e7),
    sample_period=st.floats(5e-4, 5e-3),
    lead_time=st.floats(0.05, 0.5),
)
actions = st.lists(st.tuples(st.sampled_from(["tick", "stop", "trip"]), st.integers(0, 45 * MS)), max_size=40)


@settings(max_examples=150, deadline=None)
@given(chosen_settings, actions)
def test_whatever_the_parameters_and_whatever_happens(values, course):
    try:
        chosen = ExperimentSettings(**values)
    except ConfigurationError:
        return
    run = started(chosen)
    for action, pause in course:
        run.now += pause
        if action == "stop":
            run.experiment.stop(run.now, "stop")
        elif action == "trip":
            run.experiment.trip(run.now, "trip", immediate=False)
        run.advance()
    for block in run.drive.blocks:
        d, q = block.i_dq.astype(np.longdouble).T
        assert np.all(d * d + q * q <= np.longdouble(chosen.i_max) ** 2)
    run.drive.take(run.experiment.finish(run.now, "end"))
    seen = run.drive.seen()
    assert_smooth(seen, chosen)
    if run.experiment.stop_reason == "end":
        ends_at_zero(seen, 10)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"speed_min": 10.0, "speed_max": 5.0}, "the band must not be empty"),
        ({"current_limit": 50.0}, "below i_max, 100 A"),
        ({"lead_time": 0.03}, "at least two intervals"),
        ({"lead_time": 0.05, "sample_period": 0.01}, "at least ten sample periods"),
        ({"lead_time": 5.0, "sample_period": 1e-6}, "at most 100000 sample periods"),
        ({"slew_rate": 5.0, "frequency_d": 0.0, "frequency_q": 0.0}, "to zero within 10 s"),
        ({"slew_rate": 1000.0}, "needs up to 2425 A/s where slew_rate allows 1000 A/s"),
        ({"trajectory": "spiral", "duration": 0.1}, "needs up to 1.257e\\+05 A/s"),
        ({"trajectory": "circle"}, "one of lissajous, stair, spiral"),
    ],
)
def test_settings_that_make_no_sense_together(values, message):
    with pytest.raises(ConfigurationError, match=message):
        ExperimentSettings(**values)
