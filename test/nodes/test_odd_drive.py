"""What a drive says of itself, and two emergency stops, reach the supervision: test_supervision.py has its rules."""

from __future__ import annotations

import time

import pytest
from odd_drive import OddDrive
from ros_bench import ros_bench

FIRST, SECOND = "emergency_stop", "second_stop"
ALLOWANCE = 1.5
"""Added to a stated time, s: other tests keep this machine busy."""


@pytest.fixture(scope="module")
def shared():
    with ros_bench() as ros:
        yield OddDrive(ros, emergency_stops=[FIRST, SECOND])


@pytest.fixture
def drive(shared):
    shared.asks("clear_fault", lambda reply: reply.success, "a sound drive")
    yield shared
    shared.put_right()
    shared.call("stop_experiment")


def test_a_start_beyond_the_limit_of_the_drive_is_refused(drive):
    drive.status["current_limit"] = 40.0
    drive.refuses("limit", "i_max is 50 A, above the current_limit of the drive, 40 A.")


@pytest.mark.cases
@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"winding_temperature": 130.0}, "The winding has 130 degC, above temperature_max, 120 degC."),
        ({"dc_link_voltage": 420.0}, "The DC link has 420 V, outside of -inf to 400 V."),
        ({"speed_limit": 150.0}, "The speed is 200 rad/s, above speed_max, 150 rad/s."),
    ],
)
def test_a_limit_that_the_status_exceeds_trips(drive, wrong, reason):
    drive.runs()
    drive.status |= wrong
    drive.trips(reason)
    drive.asks("clear_fault", lambda reply: reply.message == f"Not cleared: {reason}", "a refusal")


class Button:
    """An emergency stop that repeats its state every 50 ms while the test waits, until it falls silent."""

    def __init__(self, ros, topic):
        from std_msgs.msg import Bool

        self.ros, self.pressed, self.message = ros, False, Bool
        self.publisher = ros.node.create_publisher(Bool, f"/{topic}", 10)
        self.timer = ros.node.create_timer(0.05, self.say)
        ros.wait(lambda: self.publisher.get_subscription_count() >= 2, "the subscriptions")

    def say(self):
        self.publisher.publish(self.message(data=self.pressed))

    def fall_silent(self):
        self.timer.cancel()

    def leave(self):
        self.ros.node.destroy_timer(self.timer)
        self.ros.node.destroy_publisher(self.publisher)


@pytest.fixture
def buttons(drive):
    made = [Button(drive.ros, topic) for topic in (FIRST, SECOND)]
    yield made
    for button in made:
        button.leave()


@pytest.mark.slow  # two are a special case of one, which test_minimal_drive.py has
def test_of_two_emergency_stops_each_trips_and_none_releases_the_other(drive, buttons):
    for one in buttons:
        drive.runs()
        one.pressed = True
        drive.trips(f"The emergency stop ({one.publisher.topic_name}) is pressed.")
        drive.ros.spin(0.3)  # the other one says false meanwhile
        drive.asks("clear_fault", lambda reply: reply.code == "fault", "an end of the run")
        assert drive.call("clear_fault").message.endswith(f"({one.publisher.topic_name}) is pressed.")
        one.pressed = False
        drive.clear()


def test_of_two_on_one_topic_a_press_counts_and_a_release_only_of_the_last_one(drive, buttons):
    """Nothing in rclpy tells who has sent a message."""
    button, other = buttons[0], Button(drive.ros, FIRST)
    drive.runs()
    other.pressed = True
    drive.trips("The emergency stop (/emergency_stop) is pressed")
    other.fall_silent()
    drive.ros.spin(0.3)
    why = "a release by one of the 2 nodes that publish it does not count"
    drive.asks("clear_fault", lambda reply: reply.code == "fault", "an end of the run")
    assert why in drive.call("clear_fault").message
    button.fall_silent()
    drive.ros.spin(0.3)  # a release that is under way would count after the other one has left
    other.leave()
    drive.asks("clear_fault", lambda reply: reply.message.endswith("is pressed."), "the end of the other one")
    button.timer.reset()
    drive.clear()


@pytest.mark.process
def test_a_killed_characterize_leaves_no_current_behind(drive, tmp_path):
    """The node ``experiment`` gets no heartbeat any more, and ramps down; if that dies, the publisher trips."""
    hosted = [
        drive.ros.host(f"drive_id.nodes.{name}", parameters={"data_directory": str(tmp_path)} | further)
        for name, further in (("recorder", {}), ("identification", {"output_directory": str(tmp_path / "results")}))
    ]
    experiment = drive.ros.start("drive_id.ros.experiment")

    def run():
        client = drive.ros.start("drive_id.ros.characterize", arguments=["--", "--duration", "100.0", "--repeat", "1"])
        drive.ros.wait(lambda: drive.state.state == "running" and drive.is_driven(), "a run")
        return client

    client = run()
    killed = time.monotonic()
    client.popen.kill()
    drive.ros.wait(lambda: drive.state.state in {"idle", "tripped"}, "the end of the goal")
    assert drive.at_zero_since - killed < 3.0 + ALLOWANCE
    drive.clear()  # a busy thread may follow the ramp too late
    client = run()
    begun = time.monotonic()
    drive.ros.wait(lambda: drive.heartbeat > begun, "a heartbeat that this test receives, too")
    experiment.popen.kill()
    drive.trips("The client that started has sent no heartbeat for")
    flowed = drive.at_zero_since - drive.heartbeat
    assert 1.0 < flowed < 2.4 + ALLOWANCE  # the publisher may have heard the last one before this test
    client.popen.kill()
    for node in hosted:
        node.end()
