"""The set-up finds its Python and CMake, is never silent for long, and a command that fails shows why."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "tools" / "setup_environment.py"
FITTING = SCRIPT.with_name("fitting_python.sh")


@pytest.fixture
def setup():
    specification = importlib.util.spec_from_file_location("setup_environment", SCRIPT)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture
def environment(setup, tmp_path):
    lock = os.open(tmp_path, os.O_RDONLY)
    yield setup.Environment(tmp_path / "venv", "jazzy", lock)
    os.close(lock)


def test_a_slow_command_says_what_it_is_doing(setup, environment, monkeypatch, capfd):
    monkeypatch.setattr(setup, "HEARTBEAT", 0.3)
    environment.begin("Building: about a second")
    program = "import time; print('first'); time.sleep(0.6); print('second'); time.sleep(0.6)"
    environment.run([sys.executable, "-c", program], "It failed.")
    lines = capfd.readouterr().out.splitlines()
    assert lines[0] == "Building: about a second"
    said = [
        line.split()[2] for line in lines[1:] if len(line.split()) > 2
    ]  # after the seconds, the command's last line
    assert list(dict.fromkeys(said)) == ["first", "second"]


def test_a_quick_command_says_nothing(environment, capfd):
    environment.begin("Building")
    environment.run([sys.executable, "-c", "print('quick')"], "It failed.")
    assert capfd.readouterr().out == "Building\n"


def test_a_command_that_fails_shows_its_last_lines(environment, capfd):
    environment.begin("Building")
    program = "import sys; print(*range(100), sep='\\n'); sys.exit('the reason')"
    with pytest.raises(SystemExit) as end:
        environment.run([sys.executable, "-c", program], "It could not be built: see above.")
    assert end.value.code == 1
    shown = capfd.readouterr().err.splitlines()
    assert shown[-2:] == ["the reason", "drive_id: It could not be built: see above."]
    assert shown[0] == "76"


@pytest.fixture
def pythons(tmp_path):
    """Return what makes interpreters on a PATH of their own, and what then chooses one: code, output, errors."""
    shell = shutil.which("sh")

    def choose(versions, *named, **variables):
        for name, version in versions.items():
            program = f"#!/bin/sh\n{'exit 127' if version is None else f'echo {version}'}\n"
            (tmp_path / name).write_text(program)
            (tmp_path / name).chmod(0o755)
        ran = subprocess.run(
            [shell, str(FITTING), *named],
            capture_output=True,
            text=True,
            check=False,
            env={"PATH": str(tmp_path), **variables},
        )
        return ran.returncode, ran.stdout.strip(), ran.stderr.strip()

    return choose


@pytest.mark.parametrize(
    ("versions", "chosen"),
    [
        ({"python3": 11, "python3.13": 13}, "python3"),
        ({"python3": 14, "python3.12": 12, "python3.10": 10}, "python3.12"),
        ({"python3": 8, "python3.10": 10}, "python3.10"),
        ({"python3.11": 11}, "python3.11"),
        ({"python3": 14, "python3.13": None, "python3.12": 12}, "python3.12"),  # a shim of pyenv without its version
    ],
)
def test_a_python_with_wheels_is_found(pythons, versions, chosen):
    assert pythons(versions) == (0, chosen, "")


def test_without_one_it_is_said_what_to_install(pythons):
    code, out, said = pythons({})
    assert (code, out) == (1, "")
    assert "for Python 3.10 to 3.13, none of which is on the PATH: install one" in said
    code, out, said = pythons({"python3": 14})
    assert (code, out) == (1, "")
    assert "none of which is on the PATH (python3 is 3.14): install one with venv and headers" in said


def test_a_python_that_is_named_or_of_a_sourced_ros_is_taken(pythons):
    assert pythons({"python3": 14, "python3.12": 12}, "python3.12") == (0, "python3.12", "")
    assert pythons({}, ROS_DISTRO="lyrical") == (0, "python3", "")
    code, out, said = pythons({"old": 9}, "old")
    assert (code, out) == (1, "")
    assert said.startswith("drive_id: old is not a Python 3.10 or newer: install one, or name it")


def test_the_versions_are_those_of_the_wheels(setup):
    found = re.findall(r"^(?:OLDEST|NEWEST)=(\d+)", FITTING.read_text(), re.MULTILINE)
    assert [int(version) for version in found] == [setup.WHEELS_FOR[0], setup.WHEELS_FOR[-1]]
    names = re.search(r"for name in python3 (.*);", FITTING.read_text())[1].split()
    assert names == [f"python3.{minor}" for minor in reversed(setup.WHEELS_FOR)]


@pytest.mark.parametrize("there", [True, False])
def test_cmake_comes_from_the_index_where_there_is_none(setup, environment, monkeypatch, there):
    ran = []
    monkeypatch.setattr(environment, "run", lambda command, _trouble: ran.append(command))
    monkeypatch.setattr(environment, "sourced", False)
    monkeypatch.setattr(setup.shutil, "which", lambda name: "/usr/bin/cmake" if there or name != "cmake" else None)
    setup.check_prerequisites(environment)
    setup.install_packages(environment, [], [])
    assert (setup.CMAKE in ran[0]) is not there
