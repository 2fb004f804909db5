"""A drive without load machine at process level: from wired to a map by one command, and trips."""

from __future__ import annotations

import re
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from ros_bench import DEADLINE, ros_bench

from drive_id.core.experiment.first_start import NoSwingError
from drive_id.core.validation.metrics import nrmse, true_flux
from drive_id.files.machines.ground_truth import decode_truth
from drive_id.fitting.result import load
from drive_id.fitting.sources import read_bag
from drive_id.ros import first_start

ROOT = Path(__file__).parents[2]
NODES = "drive_id.nodes."
I_MAX = 20.0
OFFSET = -2.0
SPEED_MAX = 420.0  # electrical, rad/s: 1340 rpm
DRIVE = {"machine": "spm", "free_shaft": True, "current_noise": 0.001, "resolver_offset": OFFSET}
PUBLISHER = {
    "i_max": I_MAX, "shaft_speed_max": SPEED_MAX, "duration": 6.0, "lead_time": 1.0, "watch_timeout": 30.0,
    "clock_offset": 30.0,
}  # fmt: skip


@pytest.fixture
def ros():
    with ros_bench() as bench:
        yield bench


@pytest.mark.process
@pytest.mark.slow  # a first start in real time
def test_a_new_drive_is_characterized_by_one_command(ros):
    """The demonstration of it, as ``make`` runs it."""
    output = ros.folder / "out"
    make = ["make", "-o", "setup", f"BIN={Path(sys.executable).parent}", "demo", f"OUT={output}"]
    done = subprocess.run(
        [*make, "ARGS=--free-shaft --seconds 4.0"],
        cwd=ROOT, env=ros.environment, capture_output=True, text=True, timeout=4 * DEADLINE, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    found = yaml.safe_load((output / "trajectory_publisher.yaml").read_text(encoding="utf-8"))["/**"]["ros__parameters"]
    drive = yaml.safe_load((output / "drive.yaml").read_text(encoding="utf-8"))["/**"]["ros__parameters"]
    assert found["angle_offset"] + drive["encoder_offset"] == pytest.approx(OFFSET, abs=0.006)
    assert (drive["encoder_direction"], drive["encoder_pole_pairs"]) == (1, 1)
    assert abs(found["angle_offset"]) < 0.02  # what is left
    for name in ("bag_first_start", "bag_verified", "bag_shake_1", "bag_shake_2", "bag"):
        samples = read_bag(output / name)
        assert np.abs(samples.i_abc).max() < 1.2 * I_MAX
        assert np.abs(samples.speed).max() < 1.2 * SPEED_MAX
    known, identified = decode_truth((output / "truth.npz").read_bytes(), ""), load(output / "recording")
    flux_map = identified.drive.flux_map
    i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
    inside = flux_map.inside & (np.hypot(i_d, i_q) <= known.i_max)
    psi = np.stack([flux_map.psi_d, flux_map.psi_q], axis=-1)[inside]
    assert max(nrmse(psi, true_flux(known, np.stack([i_d, i_q], axis=-1)[inside]))) < 1e-3
    assert identified.drive.resistance == pytest.approx(known.resistance, rel=0.01)
    mechanics = identified.mechanics
    assert mechanics is not None
    assert abs(mechanics.inertia / known.details["inertia"] - 1) < 0.005


@pytest.mark.process
@pytest.mark.slow  # a first start in real time
def test_a_first_start_is_a_service_and_an_action_that_can_be_cancelled(ros):
    from drive_id_msgs.action import FirstStart as Goal
    from drive_id_msgs.msg import PhaseCurrents
    from drive_id_msgs.srv import FirstStart
    from rclpy.action import ActionClient

    currents, stages = [], []
    ros.node.create_subscription(PhaseCurrents, "phase_currents", lambda m: currents.append(np.abs(m.a).max()), 1000)
    data = {"data_directory": str(ros.folder)}
    ros.start(NODES + "recorder", parameters=data)
    ros.start(NODES + "identification", parameters=data | {"i_max": I_MAX})
    ros.start(NODES + "trajectory_publisher", parameters=PUBLISHER | {"angle_offset": OFFSET})
    ros.start(NODES + "bench_simulator", parameters=DRIVE)
    folder = ros.folder / "first_starts"
    settings = {"output_directory": str(folder), "timeout": DEADLINE, "drive": "bench_simulator"}
    ros.start("drive_id.ros.commissioning", parameters=settings)

    reply = ros.call(FirstStart, "/commissioning/first_start", name="shaken", angle_known=True)
    assert (reply.success, reply.code) == (True, "ok"), reply.message
    assert np.isnan(reply.sigma_angle_offset)
    found = yaml.safe_load((folder / "shaken" / "trajectory_publisher.yaml").read_text())["/**"]["ros__parameters"]
    assert found["angle_offset"] == 0.0, "the drive took it"
    drive = yaml.safe_load((folder / "shaken" / "drive.yaml").read_text())["/**"]["ros__parameters"]
    assert drive["encoder_offset"] == OFFSET
    # SPM of 3 pole pairs: 4000 rad/s^2 by the largest torque, of which reluctance adds 5 %
    assert found["shaft_acceleration"] == pytest.approx(reply.shaft_acceleration) == pytest.approx(12_600, rel=0.05)
    assert set(yaml.safe_load((folder / "shaken" / "signals.yaml").read_text())) >= {"currents", "resolver"}
    assert ros.call(FirstStart, "/commissioning/first_start", name="shaken").code == "output"

    client = ActionClient(ros.node, Goal, "/commissioning/first_start")
    ros.wait(client.server_is_ready, "the action server")
    sent = client.send_goal_async(Goal.Goal(name="cut"), feedback_callback=lambda m: stages.append(m.feedback))
    ros.wait(sent.done, "the acceptance of the goal")
    ros.wait(lambda: max(currents[-50:], default=0.0) > 0.1 * I_MAX, "the current vector")
    assert ros.call(FirstStart, "/commissioning/first_start").code == "busy"
    sent.result().cancel_goal_async()
    result = sent.result().get_result_async()
    ros.wait(result.done, "the end of the goal")
    assert (result.result().status, result.result().result.code) == (5, "cancelled")
    assert {entry.stage for entry in stages} == {"Turning"}
    ros.wait(lambda: max(currents[-50:]) < 0.02 * I_MAX, "zero current")
    ros.wait(lambda: not (folder / "cut").exists(), "the end of the empty folder")
    client.destroy()


@pytest.mark.process
@pytest.mark.slow  # a first start in real time
def test_a_swing_beyond_its_band_trips_and_ends_at_zero_current(ros):
    from drive_id_msgs.msg import PhaseCurrents, PublisherState
    from std_srvs.srv import Trigger

    states, currents = [], []
    ros.node.create_subscription(PublisherState, "/trajectory_publisher/state", states.append, 1000)
    ros.node.create_subscription(PhaseCurrents, "phase_currents", lambda m: currents.append(np.abs(m.a).max()), 1000)
    too_heavy = {"trajectory": "free_shaft", "shaft_acceleration": 800.0, "slew_rate": 1e5}
    ros.start(NODES + "trajectory_publisher", parameters=PUBLISHER | too_heavy)
    ros.start(NODES + "bench_simulator", parameters=DRIVE | {"resolver_offset": 0.0})

    def started():
        return ros.call(Trigger, "/trajectory_publisher/start").success

    ros.wait(started, "the start")
    ros.wait(lambda: bool(states) and states[-1].state == "tripped", "the trip")
    trip = re.match(r"The speed is ([\d.]+) rad/s, above 1\.2 times shaft_speed_max", states[-1].reason)
    assert trip is not None, states[-1].reason
    # By the first block beyond, or the next one: 11 000 rad/s^2 for at most 20 ms
    assert float(trip[1]) < 1.2 * SPEED_MAX + 11_000.0 * 0.02
    running = [state for state in states if state.state == "running"]
    assert all(np.isfinite(state.bias) for state in running)
    ros.wait(lambda: bool(currents) and currents[-1] < 0.05 * I_MAX, "zero current")


@pytest.mark.parametrize("silent", [0, 1, 2, 3])
def test_a_shaft_that_does_not_swing_is_shaken_with_more_current(monkeypatch, silent):
    shares: list[float] = []

    def acceleration(*_):
        if len(shares) <= silent:
            raise NoSwingError("It does not swing.")
        return 40.0, 30.0

    monkeypatch.setattr(first_start, "swing_up", lambda _, **values: shares.append(values["amplitude"]))
    monkeypatch.setattr(first_start, "read_bag", lambda _: None)
    monkeypatch.setattr(first_start, "shaft_acceleration", acceleration)
    bench = SimpleNamespace(run_experiment=lambda name: SimpleNamespace(uri=name))
    shake = partial(first_start._shaken, bench, SimpleNamespace(angle_offset=0.0), "run", 20.0, 1e4, lambda *_: None)
    if silent == 3:
        with pytest.raises(NoSwingError):
            shake()
    else:
        assert shake() == (800.0, 600.0)
    assert shares == [*[0.2, 0.4, 0.8][: silent + 1], *([0.8] if silent < 3 else [])]
