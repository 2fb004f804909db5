"""The recording and the fit that many tests share, and how parallel workers divide the tests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

if "PYTEST_XDIST_WORKER" in os.environ:  # workers share the cores: more threads of a fit or of BLAS only wait
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy is loaded

import hypothesis
import pytest
from drive_bags import TRAJECTORY
from processor_time import ProcessorTime
from store import open_store

import drive_id
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.cli import app as cli
from drive_id.core.fit_settings import FitSettings
from drive_id.core.planning import planner
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.simulated import run_experiment, simulate_bag
from drive_id.fitting.sources import Sources

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup, the nodes that are hung up on would rightly go on

DRIVES = ("test/ros/", *(f"test/nodes/test_{name}" for name in ("first", "identif", "live")))
GROUPS = dict.fromkeys(DRIVES, "drives") | {"test/nodes/": "nodes"}
"""Tests that run one after another on one worker, as they have deadlines; they mostly wait, so they come first.

Both groups take about as long.
"""
NODES_TIMEOUT = 120  # s for a test of these that is not marked as long: what hangs, waits for what never comes
LAST = (
    "test/fitting/test_full_accuracy.py",
    "test/fitting/test_full_with_rests.py",
    "test/fitting/test_real_drives.py",
    "test/test_population.py",
)
"""Long tests without a common fixture: each one runs on whichever worker is free."""

APART = ("test/test_page_commands.py",)
"""Files whose test functions share no fixture and are long: each function runs on whichever worker is free, early."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background of a shell; tests interrupt processes
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _sigint():
    """Take SIGINT back from a command that was interrupted, which ignores it from its last word on."""
    handler = signal.getsignal(signal.SIGINT)
    yield
    if signal.getsignal(signal.SIGINT) is not handler:
        signal.signal(signal.SIGINT, handler)


# Tests are not timed: the machine may be busy. The examples are the same each time, so that a push is judged by what it
# changed; to look for others: DRIVE_ID_EXPLORE=1 make test ARGS="-m hypothesis"
hypothesis.settings.register_profile("drive_id", deadline=None, derandomize="DRIVE_ID_EXPLORE" not in os.environ)
hypothesis.settings.load_profile("drive_id")


class Kernels:
    """Compiles the kernels while the workers collect, once after each change: not in each worker and node at a time."""

    def __init__(self, config):
        self.cache = getattr(config, "cache", None)  # with -p no:cacheprovider there is none
        self.changed = max(file.stat().st_mtime_ns for file in Path(drive_id.__file__).parent.rglob("*.py"))
        self.process = None
        if self.cache is None or self.cache.get("drive_id/compiled", None) != self.changed:
            config.get_terminal_writer().line("Compiling the kernels (up to half a minute)")
            self.process = subprocess.Popen([sys.executable, "-m", "drive_id.fitting.kernels"])

    def wait(self):
        if self.process is not None and self.process.wait() == 0 and self.cache is not None:
            self.cache.set("drive_id/compiled", self.changed)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep a file's tests on one worker, with its fixtures, and so the tests of each group."""
    from xdist.scheduler import LoadScopeScheduling

    kernels = Kernels(config)

    class Scheduling(LoadScopeScheduling):
        def schedule(self):
            kernels.wait()
            super().schedule()

        def _split_scope(self, nodeid):
            if nodeid.startswith(APART):
                return nodeid.partition("[")[0]
            return nodeid if nodeid.startswith(LAST) else group_of(nodeid) or nodeid.partition("::")[0]

    config.option.loadscopereorder = False  # as sorted below, where a worker starts
    return Scheduling(config, log)


def pytest_configure(config):
    os.environ |= {"COLUMNS": "80", "TERM": "dumb"}  # whatever terminal "make test" is called in
    for name in ("FORCE_COLOR", "NO_COLOR"):
        os.environ.pop(name, None)
    config.pluginmanager.register(ProcessorTime())
    if cache := getattr(config, "cache", None):
        open_store(cache.mkdir("drive_id_store"))


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(config, items):
    """Mark further cases, and put the longest work first and what divides best last, where workers share the tests."""
    first = set()
    for item in items:
        if item.get_closest_marker("cases"):
            name = item.nodeid.partition("[")[0]
            if name in first:
                item.add_marker("slow")
            first.add(name)
        if group_of(item.nodeid) and not any(map(item.get_closest_marker, ("process", "slow", "timeout"))):
            item.add_marker(pytest.mark.timeout(NODES_TIMEOUT))
    if hasattr(config, "workerinput"):
        order = [*dict.fromkeys(GROUPS.values()), ""]
        items.sort(key=lambda item: (order.index(group_of(item.nodeid)), place_of(item.nodeid)))


def place_of(nodeid):
    """Return 0 for what is long and cannot be divided, 2 for what divides best, and 1 for all others."""
    return 0 if nodeid.startswith(APART) else 2 if nodeid.startswith(LAST) else 1


def group_of(nodeid):
    return next((group for start, group in GROUPS.items() if nodeid.startswith(start)), "")


class Ran(NamedTuple):
    """What a command ended with and printed."""

    code: int
    out: str
    err: str


@pytest.fixture
def run(monkeypatch, capfd, tmp_path):
    """Run the command line in this process, from an empty folder."""
    (tmp_path / "system_tmp").mkdir()
    (tmp_path / "work").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "system_tmp"))
    monkeypatch.chdir(tmp_path / "work")

    def run(*arguments: object) -> Ran:
        monkeypatch.setattr(sys, "argv", ["drive-id", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return Ran(int(ended.value.code or 0), *capfd.readouterr())

    return run


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


@pytest.fixture(scope="session")
def other_bag(tmp_path_factory):
    """A shorter recording of the same drive; read only."""
    path = tmp_path_factory.mktemp("recorded") / "other"
    simulate_bag(machine_map("ipm"), SimulationSettings(current_noise=1e-3, seed=1), path, TRAJECTORY, 0.71)
    return path


@pytest.fixture
def coarse_plans(monkeypatch):
    """Predict experiments with fewer cells and windows, which is faster by far."""
    for name, size in (("_COARSE", (6, 1000)), ("_MIDDLE", (5, 600)), ("_FINE", (6, 1000))):
        monkeypatch.setattr(planner, name, size)


@pytest.fixture
def plain_reports(monkeypatch):
    """Leave the pictures out of reports, which take half of their time: test_report_page.py looks at whole ones."""
    monkeypatch.setattr("drive_id.reporting.page.report.figures_of", lambda *_: {})


@pytest.fixture(scope="session")
def fitted(bag):
    """Its fit, nothing written."""
    return fit_bags(Sources([bag]), None, FitSettings(method="joint"))
