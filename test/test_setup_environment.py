"""The set-up of the environment is never silent for long, and a command that fails shows why."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "tools" / "setup_environment.py"


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
