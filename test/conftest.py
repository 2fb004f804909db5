"""The recording and the fit that many tests share, and how parallel workers divide the tests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

if "PYTEST_XDIST_WORKER" in os.environ:  # workers share the cores: more threads of BLAS only wait
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded

import hypothesis
import pytest
from drive_bags import TRAJECTORY

import drive_id
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.planning import planner
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.simulated import run_experiment
from drive_id.fitting.sources import Sources

FIRST = ("test/nodes/",)
"""The longest work, which must not be left to one worker at the end."""
LAST = ("test/fitting/test_full_accuracy.py",)
"""Long tests without a common fixture: each one runs on whichever worker is free."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background of a shell; tests interrupt processes
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests are not timed: the machine may be busy. The examples are the same each time, so that a push is judged by what it
# changed; to look for others: DRIVE_ID_EXPLORE=1 make test ARGS="-m hypothesis"
hypothesis.settings.register_profile("drive_id", deadline=None, derandomize="DRIVE_ID_EXPLORE" not in os.environ)
hypothesis.settings.load_profile("drive_id")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config):
    """Compile the kernels before the workers start, once after each change: not in each worker and node at a time."""
    cache = getattr(config, "cache", None)  # with -p no:cacheprovider there is none
    changed = max(file.stat().st_mtime_ns for file in Path(drive_id.__file__).parent.rglob("*.py"))
    if cache is not None and cache.get("drive_id/compiled", None) == changed:
        return
    config.get_terminal_writer().line("Compiling the kernels (up to a minute)")
    script = Path(__file__).parent / "support" / "compile_kernels.py"
    if subprocess.run([sys.executable, script], check=False).returncode == 0 and cache is not None:
        cache.set("drive_id/compiled", changed)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep a file's tests on one worker, with its fixtures, and so all tests of nodes, which have deadlines."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            if nodeid.startswith(LAST):
                return nodeid
            return "test/nodes" if nodeid.startswith("test/nodes/") else nodeid.partition("::")[0]

    config.option.loadscopereorder = False  # as sorted below, where a worker starts
    return Scheduling(config, log)


def pytest_collection_modifyitems(config, items):
    """Put the longest work first and what divides best last, where workers share the tests."""
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: item.nodeid.startswith(LAST) - item.nodeid.startswith(FIRST))


@pytest.fixture(scope="session")
def simulation():
    """The ipm machine for 2 s at 10 kHz and 500 rpm, with harmonics, noise and an uncompensated inverter."""
    return run_experiment(machine_map("ipm"), SimulationSettings(current_noise=1e-3), TRAJECTORY, seconds=2.0)


@pytest.fixture(scope="session")
def bag(simulation, tmp_path_factory):
    """Its recording; read only."""
    path = tmp_path_factory.mktemp("recorded") / "bag"
    write_recording(path, simulation.samples, simulation.truth)
    return path


@pytest.fixture
def coarse_plans(monkeypatch):
    """Predict experiments with fewer cells and windows, which is faster by far."""
    monkeypatch.setattr(planner, "_FINE", (8, 2000))
    monkeypatch.setattr(planner, "_MIDDLE", (6, 1000))


@pytest.fixture(scope="session")
def fitted(bag):
    """Its fit, nothing written."""
    return fit_bags(Sources([bag]), None, FitSettings(method="joint"))
