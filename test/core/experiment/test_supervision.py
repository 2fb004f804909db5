"""An experiment runs only while its drive is in order, and says why it does not."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from drive_id.bench.reference_buffer import ReferenceBuffer
from drive_id.common.health import Health, Level
from drive_id.core.experiment.feedback import DriveStatus, SampleBlock
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.supervision import SupervisedExperiment
from drive_id.errors import ConfigurationError

SERVICES = Path(__file__).parents[3] / "msg_defs" / "srv"
MS = 1_000_000
T0 = 1_700_000_000 * 1000 * MS
SETTINGS = ExperimentSettings(
    i_max=10.0, frequency_d=3.0, frequency_q=1.0, duration=2.0, slew_rate=1000.0, sample_period=1e-3, lead_time=0.1,
    watch_timeout=0.2, speed_min=90.0, speed_max=110.0, current_limit=12.0,
)  # fmt: skip
EVERY = frozenset({"phase_currents", "resolver", "drive_status"})


def phase_currents(i_dq, angle):
    """Return the phase currents (3, N) of i_dq (N, 2), written out."""
    shifts = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])[:, None]
    return i_dq[:, 0] * np.cos(angle - shifts) - i_dq[:, 1] * np.sin(angle - shifts)


def plain(answer):
    return answer.success, answer.message


class Bench:
    """A watched experiment in time, with a drive that sends blocks of 10 samples every 10 ms unless told otherwise.

    It follows the references at once and exactly, at an angle that turns; what is wrong with it is set as attributes.
    """

    def __init__(self, **changes):
        self.watched = SupervisedExperiment(dataclasses.replace(SETTINGS, **changes))
        self.now, self.steady, self.count, self.statuses = T0, 100.0, 0, 0
        self.peak, self.speed, self.offset = None, 100.0, 0
        self.follows, self.status = True, {}
        self.sends = EVERY
        self.publishers = 1
        self.references = ReferenceBuffer(1000.0, 1000.0)
        self.blocks = []

    def send(self):
        """Send what was measured since the last tick."""
        clock = self.now + self.offset
        stamps = clock + np.arange(-10, 0) * MS
        i_dq = self.references.take(stamps, 1e-3) * self.follows
        angle = (0.1 * (self.count + np.arange(10)) + np.pi) % (2 * np.pi) - np.pi
        phases = phase_currents(i_dq, angle) if self.peak is None else np.full((3, 10), self.peak)
        phases, angle = phases.astype(np.float32), angle.astype(np.float32)
        ended = False
        if "phase_currents" in self.sends:
            block = SampleBlock(int(stamps[0]), self.count, 1e-3, tuple(phases))
            ended |= self.watched.currents(self.now, self.steady, block)
        if "resolver" in self.sends:
            block = SampleBlock(int(stamps[0]), self.count, 1e-3, (angle, np.full(10, self.speed, np.float32)))
            ended |= self.watched.resolver(self.now, self.steady, block)
        if "drive_status" in self.sends:
            said = {"session": self.references.session or 0, "applied": self.references.applied} | self.status
            ended |= self.watched.status(self.now, self.steady, DriveStatus(clock, self.statuses, **said))
        self.count += 10
        self.statuses += 1
        return ended

    def ticks(self, count, *, clock_stands=False):
        for _ in range(count):
            self.now += 0 if clock_stands else 10 * MS
            self.steady += 0.01
            if not clock_stands:
                self.send()
            self.obey(self.watched.advance(self.now, self.steady, self.publishers))

    def obey(self, blocks):
        for block in blocks:
            rest = {"session": block.session, "count": block.count, "safe": block.safe}
            self.references.add(block.stamp, block.sample_period, *block.i_dq.T, **rest)
        self.blocks += blocks

    def restart(self):
        self.count = self.statuses = 0
        self.references = ReferenceBuffer(1000.0, 1000.0)

    def start(self, **options):
        return plain(self.watched.start(self.now, self.steady, self.publishers, **options))

    def stop(self):
        return plain(self.watched.stop(self.now))

    def clear(self):
        return plain(self.watched.clear_fault(self.now, self.steady))

    def health(self):
        return self.watched.health(self.now, self.steady)

    def state(self):
        return self.health().values["state"]


def heard(sends=EVERY, status=None, **changes):
    """Return a bench whose drive has been heard for 30 ms: what it sends and says, and changes of SETTINGS."""
    bench = Bench(**changes)
    bench.sends, bench.status = sends, status or {}
    bench.ticks(3)
    return bench


@pytest.fixture
def bench():
    return heard()


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
    bench = Bench(watch=False)
    assert bench.start()[0]
    bench.sends = set()
    bench.ticks(100)
    assert bench.state() == "running"
    bench.sends, bench.peak = {"phase_currents"}, 13.0
    bench.ticks(1)
    assert bench.state() == "tripped"


def test_no_start_before_the_clock_runs(bench):
    bench.now = 0
    assert "use_sim_time" in bench.start()[1]


def test_no_second_start(running):
    assert running.start() == (False, "An experiment is under way (running): stop it, or wait for its end.")


def test_no_start_beside_another_publisher(bench):
    bench.publishers = 2
    assert bench.start()[1].startswith("Not started: Another node publishes current_reference")


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
    assert running.stop() == (True, "Stopping: the current ramps down to zero.")
    running.ticks(30)
    assert running.state() == "idle"
    assert running.health().message == "Stopped on request."
    assert np.all(running.blocks[-1].i_dq[-1] == 0.0)
    assert running.stop() == (True, "Nothing is running.")


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ({"sends": {"resolver"}}, "Nothing has arrived on phase_currents for 0.2"),
        ({"sends": {"phase_currents"}}, "Nothing has arrived on resolver for 0.2"),
        ({"speed": 111.0}, "The speed is 111 rad/s, above speed_max, 110 rad/s."),
        ({"speed": 89.0}, "The speed is 89 rad/s, below speed_min, 90 rad/s."),
        ({"speed": np.nan}, "Samples of resolver are NaN or infinite."),
        ({"peak": 12.5}, "The current of phase a is 12.5 A, above 12 A."),
        ({"peak": -np.inf}, "Samples of phase_currents are NaN or infinite."),
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
    done, sentence = running.stop()
    assert sentence.startswith(f"Nothing is running. It tripped: {reason}")
    done, sentence = running.clear()  # the cause persists
    assert not done
    assert sentence.startswith(f"Not cleared: {reason[:20]}")
    running.sends, running.speed, running.peak = EVERY, 100.0, None
    running.ticks(20)
    done, sentence = running.start()  # the cause is gone, but nobody has looked at it
    assert not done
    assert sentence.startswith(f"Not started: it tripped before. {reason[:20]}")
    done, sentence = running.clear()
    assert (done, sentence[:9]) == (True, "Cleared: ")
    assert running.start()[0]
    assert running.state() == "ramp_in"


@pytest.mark.parametrize(("fault", "jump"), [({"peak": 12.5}, True), ({"peak": np.nan}, True), ({"speed": 0.0}, False)])
def test_overcurrent_goes_to_zero_at_once_the_rest_ramps(running, fault, jump):
    running.blocks.clear()
    for name, value in fault.items():
        setattr(running, name, value)
    running.now += 10 * MS
    running.steady += 0.01
    assert running.send()
    blocks = running.watched.advance(running.now, running.steady)
    assert blocks[0].stamp - running.now <= 1 * MS
    assert bool(np.all(blocks[0].i_dq == 0.0)) is jump


def trips(bench, reason, within, **changes):
    """Change the drive, and wait until the experiment has tripped and the drive is at zero, each within a time, s."""
    for name, value in changes.items():
        setattr(bench, name, value)
    begin = bench.steady
    while not bench.watched.trip_reason:
        bench.ticks(1)
        assert bench.steady - begin <= within, "it does not trip"
    assert bench.watched.trip_reason.startswith(reason)
    for _ in range(4):  # 10 A at 1000 A/s, and up to two ticks
        bench.ticks(1)
    assert not np.any(bench.references.last)
    assert bench.state() == "tripped"


@pytest.mark.parametrize("offset", [-5000 * MS, -60 * MS, 60 * MS, 1000 * MS])
def test_a_clock_that_is_wrong_refuses_and_trips(bench, running, offset):
    """Wherever the drive's clock is, a stop acts on receipt: within 40 ms."""
    assert bench is running
    reason = "The stamps of phase_currents"
    trips(running, reason, 0.15, offset=offset)
    running.ticks(30)
    done, sentence = running.clear()
    assert not done
    assert "clock_offset, 0.05 s: synchronize" in sentence
    running.offset = 0
    running.ticks(30)
    assert running.clear()[0]


@pytest.mark.parametrize("offset", [-20 * MS, 20 * MS])
def test_a_small_offset_of_the_clock_does_no_harm(offset):
    bench = Bench()
    bench.offset = offset
    bench.ticks(3)
    assert bench.start()[0]
    bench.ticks(100)
    assert bench.state() == "running"


def test_a_clock_that_drifts_trips():
    bench = heard(repeat=0)
    assert bench.start()[0]
    ticks = 0
    while not bench.watched.trip_reason and ticks < 1000:
        bench.offset -= MS // 10
        bench.ticks(1)
        ticks += 1
    assert bench.watched.trip_reason.startswith("The stamps of")
    assert ticks == pytest.approx(500 + 10, abs=5)


def test_a_stalled_process_that_catches_up_does_not_trip(running):
    """Blocks that have waited for 80 ms are handled at once: none of them says that the clock is wrong."""
    waiting = []
    for _ in range(8):
        running.now += 10 * MS
        running.steady += 0.01
        waiting.append((running.now, running.count))
        running.count += 10
    for end, count in waiting:
        angle = np.zeros(10, np.float32)
        block = SampleBlock(end - 10 * MS, count, 1e-3, (angle, angle + np.float32(100.0)))
        assert not running.watched.resolver(running.now, running.steady, block)
    running.statuses += 1
    running.ticks(1)
    assert not running.watched.trip_reason


def test_frozen_stamps_trip(running):
    """The count advances, the time does not."""
    running.sends = {"resolver", "drive_status"}
    stamp, reason = running.now, ""
    while not reason:
        running.ticks(1)
        phases = (np.zeros(10, np.float32),) * 3
        block = SampleBlock(stamp, running.count - 10, 1e-3, phases)
        running.watched.currents(running.now, running.steady, block)
        reason = running.watched.trip_reason
    assert reason.startswith("The stamps of phase_currents do not advance")


def test_a_current_that_does_not_follow_trips(running):
    trips(running, "The current does not follow the reference: on average", 0.2, follows=False)


def test_a_wrong_sense_of_rotation_trips(running):
    """The amplitude is right, the direction is not: two phases are exchanged."""
    take = running.watched.currents
    running.watched.currents = lambda now, steady, block: take(
        now, steady, dataclasses.replace(block, values=(block.values[0], block.values[2], block.values[1]))
    )
    trips(running, "The current does not follow the reference", 0.3)


def test_a_current_that_nobody_commands_refuses_a_start(bench):
    bench.peak = np.array([[4.0], [-2.0], [-2.0]])
    bench.ticks(50)
    assert "The current does not follow the reference" in bench.start()[1]


def test_a_stop_that_is_not_obeyed_is_told(running):
    running.obey = lambda _: None  # deaf, and it holds a current
    running.peak = np.array([[5.0], [-2.5], [-2.5]])
    running.watched.stop(running.now)
    running.ticks(100)
    done, sentence = running.stop()
    assert not done
    assert "does not go to zero current: use the emergency stop" in sentence


def test_a_restart_of_the_drive_trips(running):
    running.restart()
    trips(running, "The count of phase_currents fell from 330 to 0: the drive was restarted.", 0.02)


def test_two_drives_are_named_where_their_counts_mix(bench):
    """A second one that is silent does no harm; nodes that publish say which two they are."""
    bench.watched.count_drives(["/drive", "/rival", "/drive"])  # one of them was killed, and is still seen
    bench.ticks(3)
    assert bench.start()[0]
    bench.ticks(30)
    assert bench.state() == "running"
    bench.count += 50_000  # the other one has been running for longer
    bench.ticks(1)
    bench.restart()
    trips(bench, "Two drives publish phase_currents, /drive and /rival, and their counts mix: stop one.", 0.02)


def test_the_progress_of_a_first_start_is_that_of_its_course():
    bench = heard(trajectory="first_start")
    assert bench.start()[0]
    bench.ticks(60)
    assert re.fullmatch(r"running: 0\.\d of \d+\.\d s\.", bench.health().message), bench.health().message
    assert bench.health().values["coverage"] == ""


def test_a_further_warning_stands_beside_what_a_node_says():
    fine, ill = Health(Level.OK, "Waiting."), Health(Level.ERROR, "Tripped.", {"state": "tripped"})
    assert fine.with_warning("Two.") == Health(Level.WARN, "Waiting. Two.")
    assert ill.with_warning("Two.") == Health(Level.ERROR, "Tripped.", {"state": "tripped", "also 1": "Two."})


def test_a_restart_that_only_the_status_tells_trips(running):
    trips(running, "The count of drive_status fell from 33 to 0", 0.02, statuses=0)


def test_stragglers_do_no_harm(running):
    take = running.watched.currents
    for _ in range(5):  # a block that comes after the next one
        kept = []
        running.watched.currents = lambda *given, kept=kept: bool(kept.append(given[2]))
        running.ticks(1)
        running.watched.currents = take
        running.ticks(1)
        assert not take(running.now, running.steady, kept[0])
        running.ticks(2)
    assert running.state() == "running"


def test_another_publisher_trips_at_any_time(running):
    trips(running, "Another node publishes current_reference", 0.02, publishers=2)
    running.ticks(30)
    assert running.clear()[1].startswith("Not cleared: Another node")


@pytest.mark.parametrize(
    ("status", "reason", "within"),
    [
        ({"fault": "Overvoltage"}, "The drive reports a fault: Overvoltage.", 0.02),
        ({"enabled": False}, "The drive is not enabled.", 0.02),
        ({"session": 7}, "The drive follows the references of somebody else", 0.15),
        ({"session": 0}, "The drive does not follow the references: it reports no session.", 0.15),
        ({"speed_limit": 99.0}, "The speed is 100 rad/s, above speed_max, 99 rad/s.", 0.03),
        ({"winding_temperature": 151.0, "winding_temperature_limit": 150.0}, "The winding has 151 degC, above", 0.02),
        ({"dc_link_voltage": 801.0, "dc_link_voltage_limit": 800.0}, "The DC link has 801 V, outside of", 0.02),
    ],
)
def test_what_the_drive_says_of_itself_trips(running, status, reason, within):
    trips(running, reason, within, status=status)


def test_limits_of_the_settings_are_tighter_than_those_of_the_drive():
    for status, reason in (
        ({"magnet_temperature": 81.0}, "The magnet has 81 degC, above temperature_max, 80 degC."),
        ({"dc_link_voltage": 299.0}, "The DC link has 299 V, outside of 300 to inf V."),
    ):
        bench = heard(status=status, temperature_max=80.0, dc_link_voltage_min=300.0)
        assert bench.start() == (False, f"Not started: {reason}")


def test_the_status_is_needed_unless_the_drive_has_none():
    bench = heard({"phase_currents", "resolver"})
    assert "Nothing has arrived on drive_status" in bench.start()[1]
    bench = heard({"phase_currents", "resolver"}, require_status=False)
    assert bench.start()[0]
    bench.sends = EVERY  # it has one after all
    bench.ticks(10)
    bench.sends = {"phase_currents", "resolver"}
    bench.ticks(30)
    assert bench.watched.trip_reason.startswith("Nothing has arrived on drive_status for 0.2")


def test_the_largest_speed_is_asked_for():
    bench = heard(speed_min=None, speed_max=None)
    assert "speed_max is not set, and the drive reports no speed_limit" in bench.start()[1]
    bench.status = {"speed_limit": 120.0}
    bench.ticks(1)
    assert bench.start()[0]
    bench.ticks(1)
    bench.speed = -121.0  # in both directions
    bench.ticks(1)
    assert bench.watched.trip_reason == "The speed is -121 rad/s, below speed_min, -120 rad/s."


def test_a_radius_above_the_limit_of_the_drive_is_refused(bench):
    bench.status = {"current_limit": 9.0}
    bench.ticks(1)
    assert bench.start()[1] == "Not started: i_max is 10 A, above the current_limit of the drive, 9 A."


@pytest.mark.parametrize(
    ("current_limit", "peak", "limit"),
    [(None, 12.4, np.inf), (None, 12.6, 12.5), (12.0, 12.1, 12.0), (None, 11.1, np.inf), (15.0, 11.6, 11.55)],
)
def test_the_limit_of_the_drive_bounds_the_measured_current(current_limit, peak, limit):
    """By default 1.25 i_max; the drive of 10.5 A trips at 1.1 times that, whatever the parameter allows."""
    bench = heard(status={"current_limit": np.nan if peak > 12.0 else 10.5}, current_limit=current_limit)
    bench.start()
    bench.ticks(1)
    bench.peak = peak
    bench.ticks(1)
    why = ", 1.1 times the current_limit of the drive: lower i_max" if limit == 11.55 else ""
    wanted = f"The current of phase a is {peak:g} A, above {limit:g} A{why}."
    assert bench.watched.trip_reason == ("" if np.isinf(limit) else wanted)


def test_nothing_exceeds_the_ceiling():
    with pytest.raises(ConfigurationError, match="i_max is 10 A, above current_ceiling, 9 A"):
        dataclasses.replace(SETTINGS, current_ceiling=9.0)
    with pytest.raises(ConfigurationError, match="current_limit is 12 A, above current_ceiling, 11 A"):
        dataclasses.replace(SETTINGS, current_ceiling=11.0)
    assert dataclasses.replace(SETTINGS, current_ceiling=11.0, current_limit=None).largest_phase_current == 11.0


def test_the_emergency_stop_is_latched(running):
    assert running.watched.emergency_stop(running.now, running.steady, pressed=True)
    trips(running, "The emergency stop (emergency_stop) is pressed.", 0.02)
    running.ticks(30)
    assert running.clear()[1] == "Not cleared: The emergency stop (emergency_stop) is pressed."
    running.watched.emergency_stop(running.now, running.steady, pressed=False)
    assert not running.start()[0]
    assert running.clear()[0]
    assert running.start()[0]


def test_a_press_while_nothing_runs_is_latched_too(bench):
    for pressed in (True, False):
        bench.watched.emergency_stop(bench.now, bench.steady, pressed=pressed)
    assert bench.start()[1] == (
        "Not started: The emergency stop (emergency_stop) was pressed: clear it by characterize --clear-fault, or call "
        "~/clear_fault."
    )
    assert bench.clear()[0]
    assert bench.start()[0]


def test_an_emergency_stop_that_is_silent_is_one():
    bench = heard(emergency_stop_timeout=0.1)
    assert "The emergency stop (emergency_stop) is silent" in bench.start()[1]
    bench.watched.emergency_stop(bench.now, bench.steady, pressed=False)
    assert bench.start()[0]
    trips(bench, "The emergency stop (emergency_stop) is silent, longer than 0.1 s.", 0.12)


def two_buttons(**values):
    """Return a bench with two emergency stops, both of them released, and what presses or releases one."""
    bench = Bench(emergency_stops=("left", "right"), **values)

    def say(button, *, pressed):
        return bench.watched.emergency_stop(bench.now, bench.steady, pressed, button)

    say("left", pressed=False)
    say("right", pressed=False)
    bench.ticks(3)
    return bench, say


@pytest.mark.parametrize(("pressed", "other"), [("left", "right"), ("right", "left")])
def test_no_emergency_stop_releases_another(pressed, other):
    bench, say = two_buttons()
    assert bench.start()[0]
    assert say(pressed, pressed=True)
    say(other, pressed=False)
    bench.ticks(30)
    assert bench.clear()[1] == f"Not cleared: The emergency stop ({pressed}) is pressed."
    say(other, pressed=True)
    say(pressed, pressed=False)
    assert bench.clear()[1] == f"Not cleared: The emergency stop ({other}) is pressed."
    say(other, pressed=False)
    bench.ticks(30)
    assert bench.clear()[0]


@pytest.mark.parametrize("silent", ["left", "right"])
def test_the_silence_of_each_emergency_stop_is_noticed(silent):
    bench, say = two_buttons(emergency_stop_timeout=0.1)
    assert bench.start()[0]
    for _ in range(12):
        bench.ticks(1)
        say("right" if silent == "left" else "left", pressed=False)
    assert bench.watched.trip_reason == f"The emergency stop ({silent}) is silent, longer than 0.1 s."


def test_a_release_by_one_of_two_on_a_topic_does_not_count(running):
    """Nobody can tell who said it: only when one is left does its word hold again."""
    running.watched.count_buttons({"emergency_stop": 2})
    for pressed in (True, False):
        running.watched.emergency_stop(running.now, running.steady, pressed=pressed)
    running.ticks(30)
    why = "The emergency stop (emergency_stop) is pressed, and a release by one of the 2 nodes that publish it does not"
    assert why in running.clear()[1]
    running.watched.count_buttons({"emergency_stop": 1})
    assert running.clear()[1] == "Not cleared: The emergency stop (emergency_stop) is pressed."
    running.watched.emergency_stop(running.now, running.steady, pressed=False)
    assert running.clear()[0]


def test_two_on_a_topic_cannot_be_watched_for_silence():
    bench, _ = two_buttons(emergency_stop_timeout=10.0)
    assert bench.start()[0]
    bench.watched.count_buttons({"left": 2, "right": 1})
    bench.ticks(1)
    assert "2 nodes publish the emergency stop (left), so the silence of one would not be" in bench.watched.trip_reason


def test_a_client_that_dies_brings_the_current_to_zero():
    bench = heard(lease_time=0.2, repeat=0)
    bench.watched.heartbeat(bench.steady)
    assert bench.start()[0]
    for _ in range(10):
        bench.ticks(10)
        bench.watched.heartbeat(bench.steady)
    assert bench.state() == "running"
    trips(bench, "The client that started has sent no heartbeat for 0.2", 0.22)


def test_the_first_heartbeat_may_come_after_the_start():
    bench = heard(lease_time=0.2, repeat=0)
    assert bench.start()[0]
    bench.watched.heartbeat(bench.steady)
    bench.ticks(10)
    assert bench.state() == "running"
    trips(bench, "The client that started has sent no heartbeat for 0.2", 0.12)


def test_a_start_by_hand_needs_no_heartbeat_unless_it_is_required(bench):
    assert bench.start()[0]
    bench.ticks(30)
    assert bench.state() == "running"
    bench = heard(require_lease=True)
    assert bench.start()[1] == "Not started: require_lease is set, and nobody sends heartbeats on ~/heartbeat."


def test_a_clock_that_stands_still_trips(running):
    running.ticks(21, clock_stands=True)
    assert running.watched.trip_reason.startswith("The clock of this node has stood still for 0.2")
    assert any(block.safe for block in running.blocks)


def test_a_dry_run_publishes_nothing_and_supervises():
    bench = heard(dry_run=True)
    assert bench.start()[1] == "Started: lissajous within 10 A for 2 s, published to nobody (dry_run)."
    bench.ticks(30)
    assert (bench.blocks, bench.state()) == ([], "running")
    bench.speed = 111.0
    bench.ticks(1)
    assert bench.state() == "tripped"
    assert bench.watched.finish(bench.now) == []


def test_a_dry_run_that_is_switched_on_meanwhile_does_not_leave_the_current_alone(running):
    running.watched.change(running.now, dataclasses.replace(SETTINGS, dry_run=True))
    running.ticks(30)
    assert not np.any(running.references.last)
    assert running.state() == "idle"


def test_a_start_may_ask_for_a_dry_run(bench):
    assert "published to nobody" in bench.start(dry_run=True)[1]
    bench.ticks(30)
    assert (bench.blocks, bench.state()) == ([], "running")
    assert bench.watched.report(bench.now, bench.steady).dry_run
    bench.stop()
    bench.ticks(40)
    assert (bench.blocks, bench.state()) == ([], "idle")
    assert not bench.watched.report(bench.now, bench.steady).dry_run
    assert bench.start() == (True, "Started: lissajous within 10 A for 2 s.")
    bench.ticks(30)
    assert (bench.blocks[0].first_sample, bench.blocks[0].count) == (0, 0)  # nothing was lost before
    assert bench.blocks[-1].first_sample == sum(len(block.i_dq) for block in bench.blocks[:-1])


def test_the_end_of_the_process_publishes_nothing_of_a_dry_run(bench):
    bench.start(dry_run=True)
    bench.ticks(30)
    assert bench.watched.finish(bench.now) == []


def test_a_start_may_ask_for_heartbeats(bench):
    ask = {"require_lease": True}
    assert not bench.start(**ask)[0]
    bench.watched.heartbeat(bench.steady)
    assert bench.start(**ask)[0]


def codes(name):
    """Return the codes that a service defines."""
    return set(re.findall(r"^string CODE_\w+=(\w+)", (SERVICES / f"{name}.srv").read_text("utf-8"), re.MULTILINE))


def test_every_answer_has_its_code(bench):
    """All of StartExperiment but that of a node that is not active, and likewise of Command those of the publisher."""
    found = {"start": [], "stop": [], "clear_fault": []}

    def ask(what, *further, **options):
        found[what].append(getattr(bench.watched, what)(bench.now, *further, **options).code)
        return found[what][-1]

    def start(**options):
        return ask("start", bench.steady, bench.publishers, **options)

    assert bench.watched.start(0, bench.steady).code == "no_clock"
    assert start(require_lease=True) == "no_heartbeat"
    bench.publishers = 2
    assert start() == "fault"
    bench.publishers, bench.status = 1, {"current_limit": 5.0}
    bench.ticks(3)
    assert start() == "limit"
    bench.status = {}
    bench.ticks(3)
    assert start(run={"trajectory": "zigzag"}) == "configuration"
    assert start() == "ok"
    bench.ticks(10)
    assert start() == "busy"
    assert ask("clear_fault", bench.steady) == "busy"
    bench.speed = 111.0
    bench.ticks(70)
    assert start() == "tripped"
    assert ask("clear_fault", bench.steady) == "fault"
    bench.speed = 100.0
    bench.ticks(3)
    assert ask("clear_fault", bench.steady) == "ok"
    assert ask("stop") == "ok"
    bench.obey, bench.peak = lambda _: None, np.array([[5.0], [-2.5], [-2.5]])
    bench.ticks(100)
    assert ask("stop") == "current_flows"
    assert {*found["start"], "no_clock", "inactive"} == codes("StartExperiment")
    assert {*found["stop"], *found["clear_fault"], "inactive", "not_recording"} == codes("Command")


def test_a_stop_at_rest_brings_others_to_zero(bench):
    """Whoever drives: the safe block is sent whether or not this node has an experiment."""
    bench.references.add(bench.now, 1e-3, *np.full((2, 100), 3, np.float32), session=7)
    bench.ticks(2)
    bench.watched.stop(bench.now)
    bench.ticks(2)
    assert [block.safe for block in bench.blocks] == [True]
    assert not np.any(bench.references.last)


def test_after_a_trip_nobody_else_drives_until_it_is_cleared(running):
    trips(running, "Another node publishes current_reference", 0.02, publishers=2)
    running.ticks(30)
    for _ in range(10):
        running.references.add(running.now, 1e-3, *np.full((2, 100), 3, np.float32), session=7)
        running.ticks(3)
        assert not np.any(running.references.last)
    running.publishers = 1
    running.ticks(2)
    running.blocks.clear()
    running.ticks(20)
    assert running.blocks == []
    assert running.clear()[0]


def test_every_run_is_a_session_of_its_own(running):
    first = {block.session for block in running.blocks}
    running.ticks(400)
    running.blocks.clear()
    running.start()
    running.ticks(10)
    second = {block.session for block in running.blocks}
    assert len(first) == len(second) == 1
    assert first.isdisjoint(second)
    assert running.blocks[0].count == 0 < running.blocks[0].first_sample


def test_blocks_that_make_no_sense(running):
    odd = tuple(np.zeros(length, np.float32) for length in (3, 2, 3))
    assert running.watched.currents(running.now, running.steady, SampleBlock(running.now, 0, 1e-3, odd))
    assert running.health().message.startswith("A block of phase_currents has arrays of different lengths.")


def test_empty_blocks_are_no_sign_of_life(running):
    running.sends = {"resolver"}
    for _ in range(25):
        running.ticks(1)
        empty = (np.zeros(0, np.float32),) * 3
        running.watched.currents(running.now, running.steady, SampleBlock(running.now, 0, 1e-3, empty))
    assert "Nothing has arrived on phase_currents" in running.health().message


def test_other_parameters_stop_first_and_hold_afterwards(running):
    changed = dataclasses.replace(SETTINGS, i_max=5.0, current_limit=6.0)
    running.peak = 9.0  # within the old limit, which holds until the old trajectory has ended
    running.watched.change(running.now, changed)
    running.peak = None
    running.ticks(30)
    assert running.health().values["state"] == "idle"
    assert running.start() == (True, "Started: lissajous within 5 A for 2 s.")
    running.blocks.clear()
    running.ticks(100)
    assert max(np.hypot(*block.i_dq.T).max() for block in running.blocks) <= 5.0


def test_a_run_has_settings_of_its_own(bench):
    run = {"trajectory": "spiral", "i_max": 4.0, "duration": 1.0}
    assert bench.start(run=run) == (True, "Started: spiral within 4 A for 1 s.")
    bench.ticks(30)
    report = bench.watched.report(bench.now, bench.steady)
    assert (report.duration, report.completed, bench.health().values["trajectory"]) == (1.0, False, "spiral")
    bench.ticks(120)
    assert bench.state() == "idle"
    assert 3.9 < max(np.hypot(*block.i_dq.T).max() for block in bench.blocks) <= 4.0
    report = bench.watched.report(bench.now, bench.steady)
    assert report.completed
    assert report.coverage > 0.1, "that of the run, until the next start"
    assert bench.start() == (True, "Started: lissajous within 10 A for 2 s.")


def test_a_run_cannot_exceed_the_limits_of_the_node(bench):
    refused = (False, "Not started: i_max is 10.1 A, more than the parameter of trajectory_publisher, 10 A.")
    assert bench.start(run={"i_max": 10.1}) == refused
    bench.status = {"current_limit": 5.0}
    bench.ticks(3)
    assert "above the current_limit of the drive" in bench.start()[1]
    assert bench.start(run={"i_max": 3.0})[0], "smaller than what the drive can do, though the node's own is not"
    bench.watched.stop(bench.now)
    bench.ticks(30)
    assert not bench.watched.report(bench.now, bench.steady).completed
    assert "above the current_limit of the drive" in bench.start()[1], "the run's radius went with the run"


def test_a_refused_run_leaves_no_trace(bench):
    bench.status = {"current_limit": 8.0}
    bench.ticks(3)
    before = bench.health(), bench.watched.report(bench.now, bench.steady)
    assert before[0].values["refused for"] == "limit", "the drive is in order: whoever runs within limits need not wait"
    for run in ({"i_max": 500.0}, {"i_max": 9.0}, {"trajectory": "zigzag"}, {"i_max": np.nan}, {"duration": 9.0}):
        assert not bench.start(run=run)[0]
        assert (bench.health(), bench.watched.report(bench.now, bench.steady).duration) == (
            before[0],
            before[1].duration,
        )
    assert bench.start(run={"i_max": 7.0}) == (True, "Started: lissajous within 7 A for 2 s.")
    bench.ticks(3)
    bench.stop()
    bench.ticks(30)
    before = bench.health()
    assert "above the current_limit of the drive, 8 A." in bench.start(run={"i_max": 9.0})[1]
    assert bench.health() == before
    assert bench.start(run={"i_max": 7.0})[0]


def test_a_drive_that_may_yet_state_its_limits_is_waited_for():
    bench = heard({"phase_currents", "resolver"}, speed_min=None, speed_max=None, require_status=False)
    assert (bench.health().level, bench.health().values.get("refused for")) == (Level.WARN, None)
    bench.sends |= {"drive_status"}
    bench.ticks(3)
    assert bench.health().values["refused for"] == "limit"


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
