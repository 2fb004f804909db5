"""Ends of nodes: told once or often, at any moment, the exit code is 0 and nobody dies of the middleware."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from live_drive import BENCH, PUBLISHER
from ros_bench import DEADLINE, ros_bench

from drive_id.nodes.support.middleware import fast_dds

CLIENT = "drive_id.ros.characterize"
VARIABLE = "FASTDDS_DEFAULT_PROFILES_FILE"


@pytest.fixture
def ros():
    with ros_bench() as bench:
        yield bench


def threads(process):
    """Return the names of a process's threads."""
    tasks = Path(f"/proc/{process.popen.pid}/task").iterdir()
    return {(task / "comm").read_text(encoding="utf-8").strip() for task in tasks}


def test_the_profile_is_there_while_a_node_is_made(monkeypatch, tmp_path):
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.chdir(tmp_path)
    with fast_dds():
        path = Path(os.environ[VARIABLE])
        assert "fastdds.type_propagation" in path.read_text(encoding="utf-8")
    assert VARIABLE not in os.environ
    assert not path.exists()


def test_profiles_of_the_users_own_are_kept(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(VARIABLE, "own.xml")
    with fast_dds():
        assert os.environ[VARIABLE] == "own.xml"
    assert os.environ[VARIABLE] == "own.xml"
    monkeypatch.delenv(VARIABLE)
    (tmp_path / "DEFAULT_FASTDDS_PROFILES.xml").touch()
    with fast_dds():
        assert VARIABLE not in os.environ


@pytest.mark.process
def test_a_signal_that_comes_again_and_again_does_no_harm(ros):
    process = ros.start(PUBLISHER)
    ros.wait(lambda: "Ready" in process.output, "the node")
    while process.popen.poll() is None:
        for number in (signal.SIGINT, signal.SIGTERM):
            process.popen.send_signal(number)
        time.sleep(1e-3)
    assert process.popen.returncode == 0, process.output
    assert "Traceback" not in process.output


TOLD_WHILE_STARTING = """
import os
import signal
from rclpy.node import Node
from drive_id.nodes.support.runtime import run

class Told(Node):
    def __init__(self):
        super().__init__("told")
        sorted(range(3), key=lambda _: os.kill(os.getpid(), signal.{number}) or 0)  # while compiled code calls Python
        print("made", flush=True)

    def close(self):
        print("closed", flush=True)

run(Told)
"""


@pytest.mark.process
@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_a_node_that_is_told_to_stop_while_it_starts_is_made_and_closed(tmp_path, number):
    ended = subprocess.run(
        [sys.executable, "-c", TOLD_WHILE_STARTING.replace("{number}", number)],
        env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_LOG_DIR": str(tmp_path)},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=DEADLINE, check=False,
    )  # fmt: skip
    assert (ended.returncode, ended.stdout) == (0, "made\nclosed\n")


@pytest.mark.process
def test_a_node_that_cannot_keep_up_ends_all_the_same(ros):
    """A bench that has always something to do, for its clock runs as fast as it can."""
    process = ros.start(BENCH, parameters={"time_scale": 100.0})
    ros.wait(lambda: "Ready" in process.output, "the bench")
    ros.wait(lambda: ros.node.count_publishers("/clock") == 1, "its clock")
    assert process.interrupt()[0] == 0, process.output


@pytest.mark.process
@pytest.mark.parametrize(
    ("module", "arguments", "sentence"),
    [
        (PUBLISHER, ["--params-file", "nowhere.yaml"], "TrajectoryPublisher: Invalid ROS arguments (Couldn't parse"),
        (CLIENT, ["-r", "__ns:=bad-name"], "characterize: Invalid ROS arguments (Couldn't parse"),
        (
            PUBLISHER,
            ["-p", "i_max:=300"],
            "type 'DOUBLE': i_max. A DOUBLE is written with a decimal point, as in 300.0.",
        ),
    ],
)
def test_a_wrong_start_is_told_in_a_sentence(tmp_path, module, arguments, sentence):
    ended = subprocess.run(
        [sys.executable, "-m", module, "--ros-args", *arguments],
        env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_LOG_DIR": str(tmp_path)},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=DEADLINE, check=False,
    )  # fmt: skip
    assert ended.returncode == 1
    *of_rcl, line = ended.stdout.splitlines()
    assert sentence in line
    assert all("[rcl]" in other for other in of_rcl), ended.stdout


def port(process):
    """Return the file of the port in shared memory at which a process hears its topics."""
    numbers = {name.rpartition(".")[2] for name in threads(process) if name.startswith("dds.shm.")}
    files = [path for path in Path("/dev/shm").glob("*_port*") if path.name.rpartition("_port")[2] in numbers]
    return max(files, key=lambda path: int(path.name.rpartition("_port")[2]))


def require_fast_dds():
    if os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp") != "rmw_fastrtps_cpp":
        pytest.skip("only Fast DDS")


@pytest.mark.process
def test_a_node_whose_port_was_replaced_ends_with_a_sentence(ros):
    """Fast DDS does so with a process that was held up, which would go on without hearing anybody."""
    require_fast_dds()
    process = ros.start("drive_id.nodes.recorder", parameters={"data_directory": str(ros.folder)})
    ros.wait(lambda: "Ready" in process.output, "the recorder")
    time.sleep(1.5)
    assert process.popen.poll() is None
    replaced = port(process)
    twin = replaced.with_name(replaced.name + "_twin")
    twin.write_bytes(replaced.read_bytes())
    twin.rename(replaced)
    process.expected_to_fail = True
    ros.wait(lambda: process.popen.poll() is not None, "its end")
    assert process.popen.returncode == 1
    assert process.output.splitlines()[-1] == (
        f"Recorder: Fast DDS has replaced the port {replaced} while the process was held up, so that it hears nobody "
        "any more: start it again."
    )
    assert "Traceback" not in process.output
    replaced.unlink()


@pytest.mark.process
@pytest.mark.parametrize(("module", "alone"), [(PUBLISHER, False), (BENCH, True)], ids=["LOCALHOST", "OFF"])
def test_publisher_and_drive_share_no_memory(ros, module, alone):
    """Whoever is stopped or killed while it holds a lock in shared memory blocks the other one.

    Nor do they have the type lookup service, whose thread crashes a process of Kilted at its end.
    """
    require_fast_dds()
    process = ros.start(module, alone=alone)
    ros.wait(lambda: "Ready" in process.output, module)
    names = threads(process)
    assert not any(name.startswith("dds.tls") for name in names), names
    if any("libfastrtps.so" in line for line in Path(f"/proc/{process.popen.pid}/maps").read_text().splitlines()):
        assert any(name.startswith("dds.udp.") for name in names), names
        assert not any(name.startswith("dds.shm.") for name in names), names
    assert process.interrupt()[0] == 0
