"""The minimal drive of ``examples/`` keeps the contract: a whole experiment, and every way out of it."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from live_drive import LiveDrive
from ros_bench import ros_bench
from simulated_time import SECOND, SimulatedTime

EXAMPLES = Path(__file__).parent.parent.parent / "examples"
ON_RECEIPT = 1.5
"""Time of the drive, s, in which set-points that were published ahead would not yet have run out."""


@pytest.fixture(scope="module")
def drive():
    """The publisher with the example as its drive."""
    with ros_bench() as ros, pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXAMPLES))
        given = {"i_max": 40.0, "lead_time": 2.0, "watch_timeout": 5.0}
        yield LiveDrive(ros, publisher=given, clock=SimulatedTime(ros), simulator="minimal_drive")


@pytest.fixture
def ready(drive):
    drive.rest()
    drive.clear()
    assert drive.set_parameters(repeat=1).successful
    drive.forget()
    return drive


def test_a_whole_experiment(ready):
    ready.start()
    ready.wait_for_state("running")
    ready.wait_for_state("idle")
    stamps, wanted = ready.ended_at_zero()
    times, i_dq = ready.current()
    inside = (times >= stamps[0]) & (times <= stamps[-1])
    held = wanted[np.searchsorted(stamps, times[inside], side="right") - 1]
    assert inside.sum() > 9_000
    assert np.sqrt(np.mean((i_dq[inside] - held) ** 2)) < 3.0
    ready.wait_for_message("Waiting for a start.")


@contextmanager
def on_receipt(drive):
    """What is done here brings the drive to zero before its set-points run out, by the count of its samples."""
    begun = drive.last("phase_currents").first_sample
    yield
    drive.ros.wait(drive.is_at_zero, "zero current")
    assert (drive.last("phase_currents").first_sample - begun) * 1e-4 < ON_RECEIPT


def test_stop_acts_on_receipt(ready):
    ready.run_without_end(10.0)
    with on_receipt(ready):
        assert ready.trigger("stop").success


def test_the_emergency_stop(ready):
    from std_msgs.msg import Bool

    button = ready.ros.node.create_publisher(Bool, "/emergency_stop", 1)
    ready.run_without_end(10.0)
    ready.ros.wait(button.get_subscription_count, "somebody who listens to the emergency stop")
    with on_receipt(ready):
        button.publish(Bool(data=True))
    ready.wait_for_message("The emergency stop (/emergency_stop) is pressed.")
    button.publish(Bool(data=False))
    ready.refuses("it tripped before. The emergency stop")
    ready.clear()
    ready.start()


def rival_of(drive, **fields):
    """Return another publisher of references, and a block of 30 A for it."""
    from drive_id_msgs.msg import CurrentReference

    publisher = drive.ros.node.create_publisher(CurrentReference, "/current_reference", 10)
    drive.ros.wait(lambda: publisher.get_subscription_count() >= 2, "the drive and the test as listeners")
    return publisher, CurrentReference(d=[30.0] * 6000, q=[0.0] * 6000, **fields)


def publish_now(drive, publisher, block):
    block.header.stamp.sec, block.header.stamp.nanosec = divmod(drive.clock.now, SECOND)
    publisher.publish(block)


@pytest.mark.slow  # one of several hazards that end in the same way
def test_references_of_somebody_else(ready):
    """The drive itself notices that two sessions meet."""
    statuses = statuses_of(ready)
    ready.run_without_end(10.0)
    rival, block = rival_of(ready, session=4711 << 16, sample_period=1e-4)
    with on_receipt(ready):
        publish_now(ready, rival, block)
    ready.wait_for_state("tripped")
    assert not any(status.session == block.session for status in statuses)
    ready.ros.node.destroy_publisher(rival)
    ready.clear()


def statuses_of(drive):
    """Return a list to which what the drive says of itself is added."""
    from drive_id_msgs.msg import DriveStatus

    statuses = []
    drive.ros.node.create_subscription(DriveStatus, "/drive_status", statuses.append, 10)
    return statuses


def test_the_angle_of_the_encoder_is_taken_only_at_rest(ready):
    """Its machine needs none: an offset turns the angle on resolver by as much."""
    assert ready.set_parameters("minimal_drive", encoder_offset=0.5).successful
    assert ready.set_parameters("minimal_drive", encoder_offset=0.0).successful
    ready.run_without_end(10.0)
    assert "stop it first" in ready.set_parameters("minimal_drive", encoder_offset=0.5).reason
    with on_receipt(ready):
        ready.trigger("stop")


def test_references_in_the_stator_frame(ready):
    """As in the first start of a drive whose angle is not known: the phases stand still while the angle turns."""
    publisher, block = rival_of(ready, session=4712 << 16, sample_period=1e-3, stator_frame=True)
    publish_now(ready, publisher, block)
    ready.ros.wait(lambda: ready.is_driven(20.0), "current")
    count = len(ready.messages["phase_currents"])
    ready.ros.wait(lambda: len(ready.messages["phase_currents"]) > count + 20, "more than a revolution")
    last = ready.messages["phase_currents"][count + 5 :]
    phases = np.array([np.concatenate([getattr(block, name) for block in last]) for name in "abc"])
    assert np.ptp(phases, axis=1).max() < 0.1
    assert 25.0 < phases[0].mean() < 30.0  # the machine lags behind by 1 ms
    with on_receipt(ready):
        assert "does not go to zero current" in ready.trigger("stop").message  # it does not know yet what this sends
    ready.ros.node.destroy_publisher(publisher)
    until = ready.clock.now + 3 * SECOND // 2  # then the drive is free for the next publisher
    ready.ros.wait(lambda: ready.clock.now > until, "a while")


@pytest.mark.slow  # one of several hazards that end in the same way
def test_a_publisher_that_vanishes_leaves_no_current_behind_nor_a_drive_for_whoever_comes_first(ready):
    ready.run_without_end(10.0)
    ready.publisher.vanish()
    rival, block = rival_of(ready, session=4713 << 16, sample_period=1e-4)
    statuses = statuses_of(ready)
    ready.ros.wait(ready.is_at_zero, "zero current")
    for _ in range(3):
        block.session += 1
        publish_now(ready, rival, block)
        ready.ros.wait(lambda: "Two publishers" in statuses[-1].fault, "a refusal")
        assert ready.is_at_zero()
