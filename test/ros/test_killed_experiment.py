"""A node ``experiment`` that is killed, with all nodes as processes: neither current nor a recording is left behind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from action_goal import experiment
from ros_bench import require_ros, ros_bench
from test_experiment import I_MAX, Suite

from drive_id.fitting.sources import read_bag


@pytest.mark.process
@pytest.mark.slow  # an experiment in real time
def test_a_killed_experiment_leaves_neither_current_nor_a_recording():
    require_ros()
    with ros_bench() as bench:
        _kill_an_experiment(Suite(bench, bench.start))


def _kill_an_experiment(suite):
    from drive_id_msgs.srv import StartRecording, StopRecording

    with suite.connected() as client:
        suite.ros._wait_until_known("/experiment")
        experiment(suite.ros, client, name="killed", duration=60.0).wait_for("trajectory")
        suite.ros.wait(lambda: not suite.at_zero(), "current")
        suite.experiment.popen.kill()
        suite.ros.wait(lambda: suite.states[-1].state == "tripped", "the trip")
        suite.ros.wait(lambda: suite.recording().state == "failed", "the end of the recording")
    state = suite.recording()
    assert "no heartbeat" in state.error
    assert state.uri == str(suite.data / "killed")
    assert state.dropped == 0
    recorded = read_bag(Path(state.uri))
    assert np.abs(recorded.i_abc).max() > 0.5 * I_MAX
    assert np.abs(recorded.i_abc[-100:]).max() < 0.05 * I_MAX, "the ramp is in the bag"
    suite.clear()
    again = suite.ros.call(StartRecording, "/recorder/start", name="after")
    assert again.success
    assert "The recording before it was cut short: The client that records" in again.message
    assert suite.ros.call(StopRecording, "/recorder/stop").uri == again.uri
