"""Each field of a goal of ``~/experiment`` is judged at its acceptance, before any other node is asked."""

from __future__ import annotations

import math
from functools import partial

import pytest
from action_goal import experiment
from ros_bench import require_ros, ros_bench

ABORTED = 6  # action_msgs/msg/GoalStatus
FIELDS = {
    "method is 'FULL': it must be one of": {"method": "FULL"},
    "temperatures has 2 entries for 1 recording": {"temperatures": [20.0, 30.0]},
    "temperatures has 1 entry for 2 recordings": {"temperatures": [20.0], "speeds": [100.0, 200.0]},
    "temperatures is 1000000000.0 degC: it must be": {"temperatures": [1e9]},
    "u_dc is -5.0 V": {"u_dc": [-5.0]},
    "u_dc is nan": {"u_dc": [math.nan]},
    "i_max is nan": {"i_max": math.nan},
    "i_max is -1.0 A": {"i_max": -1.0},
    "speeds is nan": {"speeds": [math.nan]},
    "speeds is 1000000000.0 rad/s": {"speeds": [1e9]},
    "lease_time is nan": {"lease_time": math.nan},
    "lease_time is -1.0 s": {"lease_time": -1.0},
    "lease_time is inf": {"lease_time": math.inf},
    "is not a name for a recording": {"name": "../elsewhere"},
}


@pytest.fixture(scope="module")
def alone():
    """The node ``experiment`` without the nodes that it conducts, and a client."""
    require_ros()
    from drive_id_msgs.action import Experiment
    from rclpy.action import ActionClient

    with ros_bench() as bench:
        bench.host("drive_id.ros.experiment")
        client = ActionClient(bench.node, Experiment, "/experiment/experiment")
        yield partial(experiment, bench, client)
        client.destroy()


@pytest.mark.parametrize(("said", "fields"), FIELDS.items())
def test_a_field_that_is_not_possible_is_told_at_once(alone, said, fields):
    status, result = alone(**fields).wait(5.0)
    assert (status, result.code) == (ABORTED, "configuration"), result.message
    assert said in result.message
