"""A drive that restarts, a second one, closed terminals: as processes, the nodes as they are installed."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys

import pytest
from live_drive import LIGHT
from odd_drive import OddDrive
from ros_bench import DEADLINE, ros_bench

pytestmark = pytest.mark.process

CLEAR = [sys.executable, "-m", "drive_id.ros.characterize", "--clear-fault"]


@pytest.fixture
def ros():
    with ros_bench() as bench:
        yield bench


def test_a_drive_that_restarts_is_told_of_by_all_who_listen(ros, tmp_path):
    """Identification refuses one map, the recorder begins another recording, and both end on SIGHUP."""
    from drive_id_msgs.srv import Identify, StartRecording, StopRecording

    said = ros.diagnostics()
    own = {"data_directory": str(tmp_path), "i_max": 100.0, "method": "joint", "refit_share": 0.0}
    identification = ros.start(
        "drive_id.nodes.identification", parameters={**own, "output_directory": str(tmp_path / "out")}
    )
    recorder = ros.start("drive_id.nodes.recorder", parameters={"data_directory": str(tmp_path)})
    ros.wait(lambda: "Ready" in identification.output and "Ready" in recorder.output, "the nodes")
    drive = ros.start("drive_id.nodes.bench_simulator")
    assert ros.call(StartRecording, "/recorder/start", name="two").success

    def samples(node, key):
        return int(said.get(node, {}).get(key) or 0)

    ros.wait(lambda: samples("/identification", "samples") > 3000, "live samples")
    ros.wait(lambda: samples("/recorder", "samples") > 3000, "recorded samples")
    assert ros.set_parameters("/bench_simulator", restarts=1).successful
    ros.wait(lambda: "come from two drives" in said["/identification"]["message"], "the news of the restart")
    reply = ros.identify()
    assert (reply.success, reply.code) == (False, Identify.Response.CODE_DRIVE_CHANGED)
    assert "Ask for the part 'before'" in reply.message
    after = ros.identify(part=Identify.Request.PART_AFTER)
    assert after.code != Identify.Response.CODE_DRIVE_CHANGED
    stopped = ros.call(StopRecording, "/recorder/stop")
    assert stopped.success
    assert "The bag holds 2 recordings" in stopped.message
    assert "the drive was restarted or exchanged" in stopped.message
    for process in (identification, recorder, drive):
        assert process.interrupt(number=signal.SIGHUP)[0] == 0
    assert "Traceback" not in ros.outputs()


def test_a_closed_terminal_ramps_down_and_a_trip_is_cleared_by_what_is_installed(ros):
    """The terminal of the publisher is closed while current flows."""
    drive = OddDrive(ros, process=True)
    drive.runs()
    ros.wait(drive.is_driven, "current")
    drive.status |= {"fault": "The fan has stopped"}
    drive.trips("The fan has stopped")
    assert "clear it by characterize --clear-fault" in drive.call("stop_experiment").message
    persists = ros_run(ros, CLEAR)
    while "ramps down" in persists.stderr:  # on a busy machine, the stop is not over yet
        persists = ros_run(ros, CLEAR)
    assert persists.returncode == 1
    assert "Not cleared: The drive reports a fault: The fan has stopped." in persists.stderr
    drive.put_right()
    cleared = ros_run(ros, CLEAR)
    while cleared.returncode:  # this drive may be late on a busy machine
        cleared = ros_run(ros, CLEAR)
    assert cleared.stdout.splitlines()[-1] == "Cleared: The drive reports a fault: The fan has stopped."
    drive.runs()
    ros.wait(drive.is_driven, "current")
    assert drive.publisher.interrupt(number=signal.SIGHUP)[0] == 0
    ros.wait(lambda: not drive.is_driven(), "references of zero")


def ros_run(ros, command):
    """Run a program while the drive goes on."""
    process = subprocess.Popen(command, env=ros.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    ros.wait(lambda: process.poll() is not None, "its end")
    out, error = process.communicate(timeout=DEADLINE)
    return subprocess.CompletedProcess(command, process.returncode, out, error)


def test_a_terminal_that_is_gone_costs_no_clean_end(tmp_path):
    """The process leads the session of a terminal, whose other end is closed: writing to it fails from then on."""
    code = "import os; from drive_id.nodes.recorder import main; main()"
    child, master = pty.fork()
    if child == 0:  # pragma: no cover
        os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_LOG_DIR": str(tmp_path)}
        os.chdir(tmp_path)
        os.execv(sys.executable, [sys.executable, "-c", code])
    text = b""
    while b"Ready" not in text:
        text += os.read(master, 1000)
    os.close(master)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0


def test_a_second_clock_is_refused(ros):
    """The first simulator goes on."""
    from drive_id.nodes.bench_simulator import _DISCOVERY

    scaled = LIGHT | {"time_scale": 0.5}
    first = ros.start("drive_id.nodes.bench_simulator", parameters=scaled)
    ros.wait(lambda: "Ready" in first.output and ros.node.count_publishers("/clock") == 1, "the first one")
    ros.spin(_DISCOVERY)  # then the first one takes no other for earlier
    second = ros.start("drive_id.nodes.bench_simulator", parameters=scaled, namespace="/second")
    second.expected_to_fail = True
    ros.wait(lambda: second.popen.poll() is not None, "the end of the second one")
    assert second.popen.returncode == 1
    assert "Another node publishes /clock already" in second.output
    assert "Traceback" not in second.output
    assert first.popen.poll() is None
