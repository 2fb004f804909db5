"""The first start of fresh nodes with the parameters as shipped, in real time."""

from __future__ import annotations

from pathlib import Path

import pytest
from live_drive import LIGHT

CONFIG = Path(__file__).parent.parent.parent / "config"


@pytest.fixture(scope="module")
def statuses(ros):
    """A bench that everybody finds, and what all nodes say in their diagnostics."""
    found = ros.diagnostics()
    ros.host("drive_id.nodes.bench_simulator", files=[CONFIG / "bench_simulator.yaml"], parameters=LIGHT)
    return found


@pytest.mark.process
def test_a_fresh_publisher_runs_at_its_first_start(ros, statuses):
    """One that is held up, by whatever it loads or compiles in a callback, trips for being too late.

    The simulated drive lags behind the time where other tests keep this machine busy: the times allow for that.
    """
    from std_srvs.srv import Trigger

    name = "trajectory_publisher"
    publisher = ros.start(
        "drive_id.nodes.trajectory_publisher",
        files=[CONFIG / "trajectory_publisher.yaml"],
        parameters={"lead_time": 3.0, "watch_timeout": 10.0, "clock_offset": 10.0, "follow_band": 200.0},
    )
    ros.wait(lambda: "Ready" in publisher.output, "the publisher says that it is ready")

    def started():
        reply = ros.call(Trigger, f"/{name}/start")
        assert reply.success or "Nothing has arrived" in reply.message, reply.message
        return reply.success

    ros.wait(started, "the first start")
    ros.wait(lambda: float(statuses.get(f"/{name}", {}).get("elapsed [s]", 0)) > 1.0, "a second of the trajectory")
    assert statuses[f"/{name}"]["state"] == "running", publisher.output
    assert "Tripped" not in publisher.output
    loaded = Path(f"/proc/{publisher.popen.pid}/maps").read_text()
    assert "llvmlite" not in loaded, "a compiler has no place in a node that adds sines"
    assert publisher.interrupt()[0] == 0
