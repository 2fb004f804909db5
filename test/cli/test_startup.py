"""What a command loads before it answers: a shell's question must not wait for the numerics."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from drive_id.files.write.writer import write_recording

RUN = """
import contextlib, io, json, sys
from drive_id.cli.app import main
sys.argv = ["drive-id", *json.loads(sys.argv[1])]
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main()
print(json.dumps(sorted(sys.modules)))
"""


def loaded(*arguments: object) -> set[str]:
    """Run a command in a process of its own and return the names of all modules that it loaded."""
    words = json.dumps([str(argument) for argument in arguments])
    ran = subprocess.run([sys.executable, "-c", RUN, words], capture_output=True, text=True, timeout=600, check=True)
    modules = set(json.loads(ran.stdout.splitlines()[-1]))
    assert "drive_id.cli.app" in modules
    return modules


CONTAINERS = {"pandas", "pyarrow", "asammdf", "h5py", "nptdms"}


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["fit", "--help"], ["simulate", "--help"], ["check", "--help"]]
)
def test_help_needs_no_numerics(arguments):
    numerics = {"numba", "scipy", "matplotlib", "rosbags", "mcap", "yaml", "distributed"} | CONTAINERS
    assert not loaded(*arguments) & (numerics | ({"numpy"} if arguments[0] != "simulate" else set()))  # its settings


def test_info_reads_a_bag_without_numerics_and_message_definitions(bag):
    modules = loaded("info", bag)
    assert "drive_id.files.read.info" in modules
    assert not modules & {"numpy", "numba", "scipy", "matplotlib", "rosbags", "distributed"}


@pytest.mark.process
@pytest.mark.parametrize("method", ["joint", "full"])
def test_a_fit_does_not_load_what_it_has_no_use_for(simulation, tmp_path, method):
    write_recording(tmp_path / "bag", simulation.samples)  # as of a real drive, without the truth to compare with
    modules = loaded("fit", tmp_path / "bag", "--method", method, "--output", tmp_path / "fit", "--quiet")
    assert "drive_id.core.paper.regression" in modules
    unused = {f"scipy.{name}" for name in ("interpolate", "ndimage", "io", "special", "signal", "optimize", "stats")}
    unused |= {"asyncio", "matplotlib.pyplot", "distributed", "drive_id.bench.drive", "rosbags"}
    assert modules & unused == set()


def test_recovering_a_bag_needs_no_numerics(bag, tmp_path):
    modules = loaded("recover", bag, "--output", tmp_path / "recovered", "--quiet")
    assert "drive_id.files.write.recover" in modules
    assert not modules & {"numba", "scipy", "matplotlib", "distributed"}


@pytest.mark.parametrize("node", ["trajectory_publisher", "recorder"])
def test_nodes_that_do_not_fit_load_no_numerics(node):
    pytest.importorskip("rclpy")
    code = f"import sys, drive_id.nodes.{node}; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "numpy" in ran.stdout.split()
    assert not set(ran.stdout.split()) & {"numba", "llvmlite", "scipy", "matplotlib", "rosbags"}


def test_the_nodes_do_not_let_many_threads_wait_for_small_matrices():
    """Unless told otherwise, and before numpy is loaded, when it is too late to say so."""
    code = "import os, sys, drive_id.nodes; print(os.environ['OPENBLAS_NUM_THREADS'], 'numpy' in sys.modules)"
    for told, threads in ((None, "1"), ("3", "3")):
        environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
        environment |= {"OPENBLAS_NUM_THREADS": told} if told else {}
        ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert ran.stdout.split() == [threads, "False"]


def test_an_interrupt_while_a_library_is_loaded_is_one_sentence(monkeypatch, capsys):
    """A compiled library that is interrupted in its making says that it cannot be loaded."""
    from drive_id.cli import app

    def loading():
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as interrupt:
            raise ImportError("initialization failed") from interrupt

    monkeypatch.setattr(app, "app", loading)
    monkeypatch.setattr(app.atexit, "register", lambda *_: None)
    monkeypatch.setattr(app.gc, "set_threshold", lambda *_: None)
    monkeypatch.setenv("MPLBACKEND", "agg")  # which the program sets, and this restores
    with pytest.raises(SystemExit) as ended:
        app.main()
    assert ended.value.code == 130
    assert capsys.readouterr().err.splitlines() == ["drive-id: interrupted; no output was left behind."]
