"""All nodes together, as a supervisor drives them: trajectory, simulated bench, recorder, identification."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from ros_bench import require_ros, ros_bench

ROOT = Path(__file__).parent.parent.parent
NODES = "drive_id.nodes."
TOPICS = ("phase_currents", "phase_voltages", "resolver")
LISTENERS = {"phase_currents": 3, "phase_voltages": 2, "resolver": 3}  # recorder, identification, trajectory publisher
I_MAX = 100.0
SECONDS = 4.0


@pytest.fixture(scope="module")
def ros():
    with ros_bench() as bench:
        yield bench


class SimulatedTime:
    """Publishes /clock at the pace of real time while it is asked to; the bench stands still in between."""

    def __init__(self, ros):
        from rosgraph_msgs.msg import Clock

        self.ros, self.kind = ros, Clock
        self.publisher = ros.node.create_publisher(Clock, "/clock", 10)
        self.now = 1_700_000_000_000_000_000

    def run_until(self, condition, what):
        last = time.monotonic_ns()

        def tick():
            nonlocal last
            now = time.monotonic_ns()
            self.now += min(now - last, 20_000_000)  # a busy machine makes the drive slower, not jumpy
            last = now
            message = self.kind()
            message.clock.sec, message.clock.nanosec = divmod(self.now, 10**9)
            self.publisher.publish(message)
            return condition()

        return self.ros.wait(tick, what)


def test_live_identification_equals_that_of_the_recording_made_beside_it(ros):
    from diagnostic_msgs.msg import DiagnosticArray
    from drive_id_msgs.srv import Identify, StartRecording, StopRecording
    from std_srvs.srv import Trigger

    data = ros.folder / "data"
    bench = {"machine": "ipm", "i_max": I_MAX, "speeds": [500.0], "current_noise": 0.001, "use_sim_time": True}
    trajectory = {
        "i_max": I_MAX, "frequency_d": 7.3, "frequency_q": 2.3, "duration": SECONDS, "lead_time": 0.8,
        "watch_timeout": 5.0, "use_sim_time": True,
    }  # fmt: skip
    ros.start(NODES + "recorder", parameters={"data_directory": str(data)})
    fit = {"data_directory": str(data), "output_directory": str(ros.folder / "results"), "i_max": I_MAX}
    ros.start(NODES + "identification", parameters=fit)
    ros.start(NODES + "trajectory_publisher", parameters=trajectory)
    ros.start(NODES + "bench_simulator", parameters=bench)
    states = []

    def note(message):
        for status in message.status:
            if status.name == "/trajectory_publisher":
                states.append({value.key: value.value for value in status.values}["state"])  # noqa: PERF401

    ros.node.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
    clock = SimulatedTime(ros)
    for name, count in LISTENERS.items():
        ros.wait(lambda n=name, c=count: ros.node.count_subscribers(n) == c, f"{count} listeners of {name}")
        ros.wait(lambda n=name: ros.node.count_publishers(n) == 1, f"a publisher of {name}")
    uri = ros.call(StartRecording, "/recorder/start", name="bag").uri
    assert uri == str(data / "bag")

    answers = []
    client = ros.node.create_client(Trigger, "/trajectory_publisher/start")
    ros.wait(client.service_is_ready, "the trajectory publisher")

    def started():
        if not answers or (answers[-1].done() and not answers[-1].result().success):
            answers.append(client.call_async(Trigger.Request()))
        return answers[-1].done() and answers[-1].result().success

    clock.run_until(started, "the start of the trajectory")
    clock.run_until(lambda: "running" in states, "a trajectory that runs")
    clock.run_until(lambda: states[-1] == "idle", "the end of the trajectory")

    counts = []

    def all_there():
        """The bench stands still; samples under way arrive."""
        counts.append(ros.call(Identify, "/identification/identify").report.samples_read)
        return len(counts) > 2 and counts[-1] == counts[-2] == counts[-3]

    ros.wait(all_there, "live samples that are at rest")
    stopped = ros.call(StopRecording, "/recorder/stop")
    assert stopped.success, stopped.message
    assert stopped.dropped == 0
    live = ros.call(Identify, "/identification/identify")
    recorded = ros.call(Identify, "/identification/identify", bags=[uri])
    assert live.success, live.message
    assert recorded.success, recorded.message
    assert live.report.samples_read == recorded.report.samples_read == stopped.samples > SECONDS * 1e4
    assert (live.report.gaps, recorded.report.gaps) == (0, 0)
    assert live.report.rows == recorded.report.rows
    for name in ("psi_d", "psi_q"):
        one, other = (np.array(getattr(reply.flux_map, name)) for reply in (live, recorded))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(other).max())
    for name in ("resistance", "voltage_error"):
        one, other = (getattr(reply.flux_map, name) for reply in (live, recorded))
        assert one == pytest.approx(other, rel=1e-9), name
    assert live.flux_map.inside == recorded.flux_map.inside
    assert live.flux_map.header.stamp == recorded.flux_map.header.stamp
    assert 0 < live.flux_map.voltage_error < 10
    for process in ros.processes:
        code, _ = process.interrupt()
        assert code == 0, process.output
        assert "Traceback" not in process.output


@pytest.mark.skipif(shutil.which("bash") is None, reason="the demonstration is a bash script")
def test_the_demonstration_fails_loudly_when_a_node_cannot_start(tmp_path):
    """Its data directory is a file's: the bench cannot write the truth, and nothing may wait for it in vain."""
    require_ros()
    copy = tmp_path / "demo.sh"
    text = (ROOT / "examples" / "demo.sh").read_text(encoding="utf-8")
    assert "machine:=ipm" in text
    copy.write_text(text.replace("machine:=ipm", "machine:=none_of_ours"), encoding="utf-8")
    shutil.copy(ROOT / "examples" / "supervisor.py", tmp_path)
    environment = dict(os.environ) | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "ROS_DOMAIN_ID": str(1 + (os.getpid() + 50) % 101),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    done = subprocess.run(
        ["bash", str(copy), str(tmp_path / "out")], env=environment, capture_output=True, text=True, timeout=120,
        check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert "a node has died" in done.stderr
    assert "none_of_ours" in done.stderr  # the log is shown
