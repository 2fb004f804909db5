"""An experiment runs only while its drive is in order, and says why it does not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.supervision import SupervisedExperiment
from drive_id.health import Level

MS = 1_000_000
T0 = 1_700_000_000 * 1000 * MS
SETTINGS = ExperimentSettings(
    i_max=10.0, frequency_d=3.0, frequency_q=1.0, duration=2.0, slew_rate=1000.0, sample_period=1e-3, lead_time=0.1,
    watch_timeout=0.2, speed_min=90.0, speed_max=110.0, current_limit=12.0,
)  # fmt: skip


class Bench:
    """A watched experiment in time, with a drive that sends blocks of 10 samples every 10 ms unless told otherwise."""

    def __init__(self, settings=SETTINGS):
        self.watched = SupervisedExperiment(settings)
        self.now, self.steady, self.count = T0, 100.0, 0
        self.current, self.speed = 1.0, 100.0
        self.sends = {"phase_currents", "resolver"}
        self.blocks = []

    def send(self):
        phase = np.full(10, self.current, np.float32)
        ended = False
        if "phase_currents" in self.sends:
            ended |= self.watched.currents(self.now, self.steady, self.count, [phase, -phase, np.zeros_like(phase)])
        if "resolver" in self.sends:
            signals = [np.zeros(10, np.float32), np.full(10, self.speed, np.float32)]
            ended |= self.watched.resolver(self.now, self.steady, self.count, signals)
        self.count += 10
        return ended

    def ticks(self, count):
        for _ in range(count):
            self.now += 10 * MS
            self.steady += 0.01
            self.send()
            self.blocks += self.watched.advance(self.now, self.steady)

    def start(self):
        return self.watched.start(self.now, self.steady)

    def health(self):
        return self.watched.health(self.now, self.steady)

    def state(self):
        return self.health().values["state"]


@pytest.fixture
def bench():
    bench = Bench()
    bench.ticks(3)
    return bench


@pytest.fixture
def running(bench):
    done, sentence = bench.start()
    assert (done, sentence) == (True, "Started: lissajous within 10 A for 2 s.")
    bench.ticks(30)
    assert bench.state() == "running"
    return bench


def test_no_start_without_a_drive():
    bench = Bench()
    assert bench.health().level is Level.WARN
    assert bench.start() == (
        False,
        "Not started: Nothing has arrived on phase_currents: start the drive, or remap the topic.",
    )
    bench.sends = {"phase_currents"}
    bench.ticks(1)
    assert "Nothing has arrived on resolver" in bench.start()[1]


def test_without_watch_it_starts_blindly_but_heeds_what_it_hears():
    bench = Bench(dataclasses.replace(SETTINGS, watch=False))
    assert bench.start()[0]
    bench.sends = set()
    bench.ticks(100)
    assert bench.state() == "running"
    bench.sends, bench.current = {"phase_currents"}, 13.0
    bench.ticks(1)
    assert bench.state() == "tripped"


def test_no_start_before_the_clock_runs(bench):
    bench.now = 0
    assert "use_sim_time" in bench.start()[1]


def test_no_second_start(running):
    assert running.start() == (False, "An experiment is under way (running): stop it, or wait for its end.")


def test_no_start_beside_another_publisher(bench):
    assert "1 other nodes publish current_reference" in bench.watched.start(bench.now, bench.steady, 2)[1]


def test_the_course_in_diagnostics(running):
    health = running.health()
    assert health.level is Level.OK
    assert health.message.startswith("running: ")
    assert float(health.values["elapsed [s]"]) == pytest.approx(0.25, abs=0.02)
    assert 0 < float(health.values["coverage"]) < 1
    running.ticks(300)
    assert running.state() == "idle"
    assert running.health().level is Level.OK


def test_stop(running):
    assert running.watched.stop(running.now) == (True, "Stopping: the current ramps down to zero.")
    running.ticks(30)
    assert running.state() == "idle"
    assert running.health().message == "Stopped on request."
    assert np.all(running.blocks[-1].i_dq[-1] == 0.0)
    assert running.watched.stop(running.now) == (True, "Nothing is running.")


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ({"sends": {"resolver"}}, "Nothing has arrived on phase_currents for 0.2"),
        ({"sends": {"phase_currents"}}, "Nothing has arrived on resolver for 0.2"),
        ({"speed": 111.0}, "The speed is 111 rad/s, above speed_max, 110 rad/s."),
        ({"speed": 89.0}, "The speed is 89 rad/s, below speed_min, 90 rad/s."),
        ({"speed": np.nan}, "Samples of resolver are NaN or infinite."),
        ({"current": 12.5}, "The current of phase a is 12.5 A, above 12 A."),
        ({"current": -np.inf}, "Samples of phase_currents are NaN or infinite."),
    ],
)
def test_trips(running, fault, reason):
    for name, value in fault.items():
        setattr(running, name, value)
    running.ticks(22)
    assert running.health().level is Level.ERROR
    assert running.health().message.startswith(reason)
    running.ticks(50)
    assert np.all(running.blocks[-1].i_dq[-1] == 0.0)
    assert running.state() == "tripped"
    done, sentence = running.start()  # the cause persists
    assert not done
    assert sentence.startswith("Tripped before: ")
    assert sentence.count(reason[:20]) == 2
    running.sends, running.speed, running.current = {"phase_currents", "resolver"}, 100.0, 1.0
    running.ticks(1)
    assert running.start()[0]
    assert running.state() == "ramp_in"


@pytest.mark.parametrize(
    ("fault", "jump"), [({"current": 12.5}, True), ({"current": np.nan}, True), ({"speed": 0.0}, False)]
)
def test_overcurrent_goes_to_zero_at_once_the_rest_ramps(running, fault, jump):
    running.blocks.clear()
    for name, value in fault.items():
        setattr(running, name, value)
    assert running.send()
    blocks = running.watched.advance(running.now, running.steady)
    assert blocks[0].stamp - running.now <= 1 * MS
    assert bool(np.all(blocks[0].i_dq == 0.0)) is jump


def test_blocks_that_make_no_sense(running):
    odd = [np.zeros(3, np.float32), np.zeros(2, np.float32), np.zeros(3, np.float32)]
    assert running.watched.currents(running.now, running.steady, 0, odd)
    assert running.health().message == "A block of phase_currents has arrays of different lengths."


def test_empty_blocks_are_no_sign_of_life(running):
    running.sends = {"resolver"}
    for _ in range(25):
        running.ticks(1)
        running.watched.currents(running.now, running.steady, 0, [np.zeros(0, np.float32)] * 3)
    assert "Nothing has arrived on phase_currents" in running.health().message


def test_other_parameters_stop_first_and_hold_afterwards(running):
    changed = dataclasses.replace(SETTINGS, i_max=5.0, current_limit=6.0)
    running.current = 9.0  # within the old limit, which holds until the old trajectory has ended
    running.watched.change(running.now, changed)
    running.ticks(30)
    assert running.health().values["state"] == "idle"
    running.current = 1.0
    running.ticks(1)
    assert running.start() == (True, "Started: lissajous within 5 A for 2 s.")
    running.blocks.clear()
    running.ticks(100)
    assert max(np.hypot(*block.i_dq.T).max() for block in running.blocks) <= 5.0


def test_lost_samples_are_counted(running):
    running.count += 30
    running.ticks(1)
    assert running.health().values["lost samples of resolver"] == "30"


def test_the_end_of_the_process(running):
    blocks = running.watched.finish(running.now)
    assert np.all(blocks[-1].i_dq[-1] == 0.0)
    assert running.watched.finish(running.now) == []


def test_the_stair_describes_its_length():
    watched = SupervisedExperiment(dataclasses.replace(SETTINGS, trajectory="stair", repeat=0))
    assert watched.plan() == "stair within 10 A until it is stopped"
