"""All nodes together, as a supervisor drives them: trajectory, simulated bench, recorder, identification."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from ros_bench import DEADLINE, own_domain, require_ros
from simulated_time import SimulatedTime, end_of, stamp_of

from drive_id.files.read.several import read_recording

ROOT = Path(__file__).parent.parent.parent
NODES = "drive_id.nodes."
TOPICS = ("phase_currents", "phase_voltages", "resolver")
LISTENERS = {"phase_currents": "3", "phase_voltages": "2", "resolver": "4"}
"""Recorder and identification, of two also the trajectory publisher, of one this test."""
I_MAX = 100.0
SECONDS = 2.0
BLOCK = 10_001_000  # ns; a hundred samples at 10 kHz, and a bit for rounding


@pytest.mark.essential
@pytest.mark.slow  # a whole experiment through three nodes, fitted twice
def test_live_identification_equals_that_of_the_recording_made_beside_it(ros):
    from diagnostic_msgs.msg import DiagnosticArray
    from drive_id_msgs.msg import CurrentReference, Resolver
    from drive_id_msgs.srv import StartRecording, StopRecording
    from std_srvs.srv import Trigger

    data = ros.folder / "data"
    bench = {"machine": "ipm", "i_max": I_MAX, "speeds": [500.0], "current_noise": 0.001, "use_sim_time": True}
    bench |= {"log_scalars": ["dc_link_voltage", "winding_temperature"], "scalar_rate": 1000.0}
    trajectory = {
        "i_max": I_MAX, "frequency_d": 7.3, "frequency_q": 2.3, "duration": SECONDS, "lead_time": 0.8,
        "watch_timeout": 60.0, "use_sim_time": True,
    }  # fmt: skip
    ros.host(NODES + "recorder", parameters={"data_directory": str(data)})
    fit = {"data_directory": str(data), "output_directory": str(ros.folder / "results"), "i_max": I_MAX}
    fit["method"] = "joint"
    ros.host(NODES + "identification", parameters=fit)
    publisher = ros.host(NODES + "trajectory_publisher", parameters=trajectory)
    simulator = ros.host(NODES + "bench_simulator", parameters=bench)
    values, times, last = {}, {}, {"resolver": None, "current_reference": None}

    def note(message):
        for status in message.status:
            values[status.name] = {value.key: value.value for value in status.values}
            times[status.name] = stamp_of(message)

    def told(node, **wanted):
        said = values.get(f"/{node}", {})
        return all(said.get(key) == value for key, value in wanted.items())

    ros.node.create_subscription(DiagnosticArray, "/diagnostics", note, 100)
    for kind, name in ((Resolver, "resolver"), (CurrentReference, "current_reference")):
        ros.node.create_subscription(kind, name, partial(last.__setitem__, name), 1000)
    # What the bench publishes before it has found a listener, that one never gets; only the bench knows.
    listeners = {f"/{name}: listeners": count for name, count in LISTENERS.items()}
    ros.wait(lambda: told("bench_simulator", **listeners), "everybody listening to the bench")
    uri = ros.call(StartRecording, "/recorder/start", name="bag").uri
    assert uri == str(data / "bag")

    def attempt():
        reply = ros.call(Trigger, "/trajectory_publisher/start")
        if reply.success:
            ros.wait(lambda: last["current_reference"], "references")
        return reply if reply.success else None

    clock = SimulatedTime(ros)  # no sample before there is time
    clock.follow(
        partial(last.get, "resolver"), partial(last.get, "current_reference"), lambda: simulator, lambda: publisher
    )
    clock.start(attempt, lambda now: times.get("/trajectory_publisher") == now)
    ros.wait(lambda: told("trajectory_publisher", state="running"), "a trajectory that runs")
    ros.wait(lambda: told("trajectory_publisher", state="idle"), "the end of the trajectory")

    clock.stands = True
    ros.wait(lambda: clock.now - end_of(last["resolver"], last["resolver"].angle) < BLOCK, "all samples of the bench")
    samples = last["resolver"].first_sample + len(last["resolver"].angle)
    written = {f"/{name}: samples written": str(samples) for name in TOPICS}
    read = {f"/{name}: samples": str(samples) for name in TOPICS}
    ros.wait(lambda: told("recorder", **written) and told("identification", **read), f"{samples} samples everywhere")
    stopped = ros.call(StopRecording, "/recorder/stop")
    assert stopped.success, stopped.message
    assert (stopped.samples, stopped.dropped) == (samples, 0)
    kept = read_recording(data / "bag").samples
    np.testing.assert_array_equal(kept.dc_link_voltage, 400.0)
    np.testing.assert_array_equal(kept.winding_temperature, 20.0)
    assert kept.shaft_torque is None
    assert int(values["/identification"]["/dc_link_voltage: samples"]) >= samples // 10
    live = ros.identify()
    recorded = ros.identify(uri)
    assert live.success, live.message
    assert recorded.success, recorded.message
    assert live.report.samples_read == recorded.report.samples_read == samples > SECONDS * 1e4
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


@pytest.mark.process
@pytest.mark.skipif(shutil.which("bash") is None, reason="the demonstration is a bash script")
def test_the_demonstration_fails_loudly_when_a_node_cannot_start(tmp_path):
    """Its data directory is a file's: the bench cannot write the truth, and nothing may wait for it in vain."""
    require_ros()
    copy = tmp_path / "demo.sh"
    text = (ROOT / "examples" / "demo.sh").read_text(encoding="utf-8")
    assert "machine:=ipm" in text
    copy.write_text(text.replace("machine:=ipm", "machine:=none_of_ours"), encoding="utf-8")
    domain, lock = own_domain()
    environment = dict(os.environ) | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    with lock:
        done = subprocess.run(
            ["bash", str(copy), str(tmp_path / "out")], env=environment, capture_output=True, text=True,
            timeout=DEADLINE, check=False,
        )  # fmt: skip
    assert done.returncode != 0
    assert "a node has died" in done.stderr
    assert "none_of_ours" in done.stderr  # the log is shown
