"""``characterize``: it says what it waits for, and refuses before anything is started."""

from __future__ import annotations

import importlib
import re
import signal
import sys
from types import SimpleNamespace

import pytest
from rich.console import Console
from ros_bench import own_domain, require_ros

MODULE = "drive_id.ros.characterize"


@pytest.fixture(scope="module")
def characterize():
    """The module."""
    require_ros()
    return importlib.import_module(MODULE)


@pytest.fixture
def run(characterize, monkeypatch, capsys):
    """Return a function that runs the command in a domain without any node, and gives code, output and complaint."""
    domain, lock = own_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}

    def command(*arguments):
        monkeypatch.setattr(sys, "argv", [MODULE, *arguments])
        with pytest.raises(SystemExit) as end:
            characterize.main()
        return SimpleNamespace(returncode=end.value.code, **capsys.readouterr()._asdict())

    yield command
    for number, handler in handlers.items():
        signal.signal(number, handler)
    lock.close()


def test_an_output_that_cannot_be_made_is_refused_at_once(run, tmp_path):
    """It was noticed after the whole experiment, by a traceback."""
    (tmp_path / "file").touch()
    done = run("--output", str(tmp_path / "file" / "out"))
    assert done.returncode == 1
    assert done.out == ""  # nothing was waited for
    assert done.err.startswith("characterize: ")
    assert len(done.err.splitlines()) == 1
    assert "cannot be made a folder (Not a directory): give another --output." in done.err


def test_an_output_that_holds_results_is_refused_at_once(run, tmp_path):
    (tmp_path / "recording").mkdir()
    done = run("--output", str(tmp_path))
    assert done.returncode == 1
    assert done.err == (
        f"characterize: {tmp_path / 'recording'} exists already: remove it, or give another --output.\n"
    )


def test_a_missing_output_is_made(characterize, tmp_path):
    characterize.prepare_output(tmp_path / "new" / "out", {})
    assert (tmp_path / "new" / "out").is_dir()


def test_a_missing_truth_is_one_sentence(characterize, tmp_path):
    with pytest.raises(
        characterize.ExperimentError, match=r"cannot be read \(No such file or directory\): give another"
    ):
        characterize.read_truth(tmp_path / "truth.npz")


def test_it_says_what_it_waits_for(run):
    done = run("--start-up", "10")  # told after 5 s, or as soon as a busy machine comes to it
    assert done.returncode == 1
    waiting = "waiting for experiment and identification and recorder and trajectory_publisher (the first start "
    assert re.match(rf"1\. The nodes are started\.\n     [5-9] s  {re.escape(waiting)}", done.out)
    assert done.err.startswith(f"characterize: After 10 s, still {waiting}")
    assert len(done.err.splitlines()) == 1


@pytest.mark.parametrize("columns", ["40", "200"])
def test_the_table_does_not_depend_on_the_terminal(characterize, monkeypatch, capsys, columns):
    monkeypatch.setenv("COLUMNS", columns)
    flux_map = SimpleNamespace(
        resistance=0.01, sigma_resistance=1.1e-5, voltage_error=3.98, sigma_voltage_error=0.021,
        inverter_current=[-1.0, 1.0], method="full",
    )  # fmt: skip
    report = SimpleNamespace(
        mad_d=0.1, mad_q=0.2, coverage=1.0, samples_used=100, samples_read=200, inertia=float("nan")
    )
    results = {title: SimpleNamespace(flux_map=flux_map, report=report) for title in characterize.COMPARED}
    Console(width=characterize._WIDTH).print(characterize.comparison(results, None))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].strip() == "The drive, identified through the services"
    assert len({len(line) for line in lines[1:]}) == 1
    assert "100 of 200" in lines[-2]
    assert sum("10.000 ± 0.011 mΩ" in line for line in lines) == 1
    assert sum("3.980 ± 0.021 V" in line for line in lines) == 1
