"""Trajectory publisher and simulated bench over DDS: the current follows, and whatever stops it brings it to zero."""

from __future__ import annotations

import re
import signal

import numpy as np
import pytest
from live_drive import SETTINGS, LiveDrive, assert_contiguous
from ros_bench import ros_bench
from simulated_time import SimulatedTime

from drive_id.bench.machines import machine_map
from drive_id.errors import DriveIdError
from drive_id.files.machines.ground_truth import decode_truth


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """One pair of nodes for all tests that leave them alive, in a namespace."""
    with ros_bench() as ros:
        truth = tmp_path_factory.mktemp("truth") / "truth.npz"
        bench = {"truth_file": str(truth), "block_size": 200, "current_noise": 1e-3}
        drive = LiveDrive(ros, "/cell", bench=bench, clock=SimulatedTime(ros))
        drive.truth = truth
        yield drive


@pytest.fixture
def drive(shared):
    """The pair, at rest and with the parameters of the beginning."""
    shared.ros.wait(lambda: shared.messages["resolver"], "the bench")
    assert shared.set_parameters("bench_simulator", speeds=[500.0]).successful
    shared.rest()
    nothing = float("nan")
    given = {
        "speed_min": nothing,
        "speed_max": nothing,
        "current_limit": nothing,
        "repeat": 1,
        "dry_run": False,
    } | SETTINGS
    assert shared.set_parameters(**given, trajectory="lissajous").successful
    shared.ros.wait(lambda: shared.state() in {"idle", "tripped"}, "rest")
    shared.clear()
    shared.forget()
    return shared


def assert_smooth(wanted):
    steps = np.hypot(*np.diff(wanted, axis=0).T)
    assert steps.max() <= SETTINGS["slew_rate"] * 1e-4 + 4e-5
    assert np.hypot(*wanted.T).max() <= SETTINGS["i_max"]


def test_the_current_follows_the_references(drive):
    assert drive.start().message == "Started: lissajous within 100 A for 1 s."
    drive.wait_for_state("running")
    drive.wait_for_state("idle")
    stamps, wanted = drive.ended_at_zero()
    assert np.hypot(*wanted.T).max() > 99.9
    assert_smooth(wanted)
    times, i_dq = drive.current()
    inside = (times >= stamps[0]) & (times <= stamps[-1])
    held = wanted[np.searchsorted(stamps, times[inside], side="right") - 1]
    assert inside.sum() > 9000
    assert np.sqrt(np.mean((i_dq[inside] - held) ** 2)) < 6.0
    for name, field in (("phase_currents", "a"), ("phase_voltages", "a"), ("resolver", "angle")):
        assert_contiguous(drive.messages[name], field)
        assert {len(getattr(message, field)) for message in drive.messages[name]} == {200}
        assert {message.header.frame_id for message in drive.messages[name]} == {"drive"}
    assert_contiguous(drive.messages["current_reference"], "d")


@pytest.mark.slow  # one of several hazards that end in the same way
def test_a_change_of_parameters_stops(drive):
    drive.run_without_end()
    assert drive.set_parameters(i_max=50.0).successful
    _, wanted = drive.ended_at_zero()
    assert_smooth(wanted)
    drive.wait_for_message("Stopped, because parameters were changed.")
    drive.forget()
    drive.start()
    drive.ros.wait(drive.is_driven, "current")
    assert np.hypot(*drive.references()[1].T).max() <= 50.0


def test_the_current_exceeds_its_limit(drive):
    """A drive overshoots; a limit at the rim of the disc is too tight."""
    assert drive.set_parameters(current_limit=100.0, repeat=0).successful
    drive.start()
    assert ", above 100 A." in drive.wait_for_state("tripped").reason
    _, wanted = drive.ended_at_zero()
    assert np.hypot(*np.diff(wanted, axis=0).T).max() > 50.0  # at once, not by a ramp
    drive.clear()
    drive.start()


@pytest.mark.slow  # one of several hazards that end in the same way
def test_a_clock_that_is_paused_trips(drive):
    """Neither side has time, so the references never come due: what runs no more must not be said to run."""
    assert drive.set_parameters(watch_timeout=3.0).successful
    drive.run_without_end()
    drive.clock.stands = True
    try:
        reason = drive.wait_for_state("tripped").reason  # the drive is silent for as long: whichever is noticed first
        assert re.search(r"clock of this node has stood still|Nothing has arrived on", reason)
    finally:
        drive.clock.stands = False
    drive.ended_at_zero()
    drive.clear()


@pytest.mark.cases
@pytest.mark.parametrize("step", [1.5, -1.5])
def test_a_step_of_the_clock_trips(drive, step):
    """That of publisher and drive, by more than lead_time: what was published ahead is over, or far ahead."""
    drive.run_without_end()
    drive.clock.now += round(step * 1e9)
    reason = drive.wait_for_state("tripped").reason
    assert re.search("too late|set back|the clock of this node|does not follow", reason), reason
    drive.ended_at_zero()
    drive.clear()


def test_a_dry_run_publishes_nothing(drive):
    assert drive.set_parameters(dry_run=True, repeat=0).successful
    drive.ask("start", lambda reply: "published to nobody" in reply.message, "a start")
    drive.wait_for_state("running")
    assert drive.trigger("stop").success
    drive.wait_for_state("idle")
    assert drive.messages["current_reference"] == []
    assert drive.set_parameters(dry_run=False).successful


def test_the_state_is_there_for_late_subscribers(drive):
    from drive_id_msgs.msg import PublisherState

    from drive_id.nodes.support.qos import LATCHED

    heard = []

    def subscribe():
        topic = f"{drive.namespace}/trajectory_publisher/state"
        drive.ros.node.create_subscription(PublisherState, topic, heard.append, LATCHED)

    subscribe()
    drive.ros.wait(lambda: heard and heard[-1].state == PublisherState.IDLE, "the state at rest")
    drive.run_without_end()
    drive.ros.wait(lambda: heard[-1].state == PublisherState.RUNNING, "the state of a run")
    assert heard[-1].session == drive.last("current_reference").session != 0
    assert drive.trigger("stop").success
    drive.ros.wait(lambda: heard[-1].state == PublisherState.IDLE, "the end")
    assert heard[-1].reason == "Stopped on request."


def test_parameters_are_refused_with_the_reason(drive):
    """Those of one kind and range: test_parameters.py has the others, test_state_machine.py what fits together."""
    drive.run_without_end()
    for values, reason in (
        ({"slew_rate": 1000.0}, "needs up to 4809 A/s where slew_rate allows 1000 A/s"),
        ({"publish_rate": 20.0}, "read-only"),
        ({"watch": False}, "read-only"),
        ({"require_status": False}, "read-only"),
        ({"current_ceiling": 1e3}, "read-only"),
        ({"frequency": 20.0}, "declared"),
    ):
        result = drive.set_parameters(**values)
        assert not result.successful, values
        assert reason in result.reason
    assert "under way (running)" in drive.trigger("start").message
    assert "read-only" in drive.set_parameters("bench_simulator", machine="spm").reason
    assert "one new speed" in drive.set_parameters("bench_simulator", speeds=[1.0, 2.0]).reason


def test_the_truth_is_in_its_file_and_in_no_topic(drive):
    truth = decode_truth(drive.truth.read_bytes(), "the file")
    assert (truth.machine, truth.resistance) == ("ipm", machine_map("ipm").resistance)
    topics = {name for name, _ in drive.ros.node.get_topic_names_and_types() if name.startswith("/cell")}
    own = ("current_reference", "phase_currents", "phase_voltages", "resolver", "drive_status", "emergency_stop")
    own += tuple(f"trajectory_publisher/{name}" for name in ("transition_event", "state", "heartbeat"))
    assert topics == {f"/cell/{name}" for name in own}
    publishers = drive.ros.node.get_publishers_info_by_topic("/rosout")
    assert "bench_simulator" not in {publisher.node_name for publisher in publishers}
    status = drive.ros.wait(lambda: drive.status("bench_simulator"), "diagnostics")
    assert "ipm" not in status.message + "".join(value.value for value in status.values)


@pytest.mark.process
def test_signals_end_the_publisher_with_zero_current():
    with ros_bench() as ros:
        drive = LiveDrive(ros, clock=SimulatedTime(ros), process=True)
        drive.run_without_end()
        assert drive.publisher.interrupt(number=signal.SIGTERM)[0] == 0
        _, wanted = drive.ended_at_zero()
        assert_smooth(wanted)  # ramped down, not cut off
        assert drive.bench.interrupt()[0] == 0
        assert "Traceback" not in ros.outputs()


def test_a_wrong_start_is_one_sentence():
    wrong = [
        ("bench_simulator", {"machine": "dc"}, "There is no machine 'dc'"),
        ("bench_simulator", {"time_scale": 2.0, "use_sim_time": True}, "do not set use_sim_time"),
        ("bench_simulator", {"truth_file": "/nowhere/truth.npz"}, "The truth cannot be written to /nowhere/truth.npz"),
        ("trajectory_publisher", {"slew_rate": 1000.0}, "slew_rate"),
        (
            "trajectory_publisher",
            {"i_max": 100.0, "current_ceiling": 90.0},
            "i_max is 100 A, above current_ceiling, 90 A",
        ),
    ]
    with ros_bench() as ros:
        from rclpy.exceptions import ParameterException

        for module, parameters, reason in wrong:
            with pytest.raises((DriveIdError, ParameterException), match=reason) as told:
                ros.host(f"drive_id.nodes.{module}", parameters=parameters)
            assert "\n" not in str(told.value)
