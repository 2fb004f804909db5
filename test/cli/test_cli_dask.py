"""Recordings are read by a Dask cluster with the same result, also when one of its workers is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from drive_bags import TRAJECTORY
from same_bits import assert_same_bits
from test_cli import JOINT, assert_one_sentence

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, WorkerError
from drive_id.fitting.dask_cluster import on_dask
from drive_id.fitting.simulated import simulate_bag
from drive_id.fitting.sources import Sources, accumulate_sources

RADIUS = FitSettings(method="joint", i_max=300.0)
NOBODY = "tcp://127.0.0.1:1"
"""An address at which nothing listens: port 1 needs the rights of the administrator."""


def test_without_the_extra_it_is_named(run, bag, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    for command in ("fit", "accumulate"):
        ran = run(command, bag, "--dask", NOBODY, "--output", "out", *JOINT)
        assert_one_sentence(ran, "--dask needs the package distributed: pip install 'drive_id[dask]'.")
    assert not Path("out").exists()


class LostError(Exception):
    """What distributed raises when all workers died at a task."""


class Client:
    """Stands for a connection with a cluster of three threads."""

    lacking = ""

    def __init__(self, *_args, **_options):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        return None

    def nthreads(self):
        return {"one": 2, "two": 1}

    def run(self, _work, _text):
        if self.lacking:
            raise ModuleNotFoundError(name=self.lacking)

    def get_executor(self):
        return "the executor"


def place():
    with on_dask(Sources([Path("bag")]), "here") as placed:
        assert (placed.workers, placed.executor) == (3, "the executor")
        raise LostError("A task killed 4 workers.")


def test_what_the_cluster_says_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(Client=Client, KilledWorker=LostError))
    with pytest.raises(WorkerError, match=r"at here has given up: A task killed 4 workers\."):
        place()
    monkeypatch.setattr(Client, "lacking", "drive_id")
    with pytest.raises(ConfigurationError, match="at here has no drive_id: install drive_id there"):
        place()


@pytest.fixture(scope="module")
def bags(bag, tmp_path_factory):
    """Three recordings of one drive; read only."""
    folder = tmp_path_factory.mktemp("recorded")
    for seed, seconds in enumerate((0.71, 1.2)):
        settings = SimulationSettings(current_noise=1e-3, seed=seed)
        simulate_bag(machine_map("ipm"), settings, folder / str(seed), TRAJECTORY, seconds)
    return [bag, folder / "0", folder / "1"]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The address of a scheduler with two workers of one thread each, which must be able to import this module."""
    pytest.importorskip("distributed", reason="the extra dask is not installed")
    folder = tmp_path_factory.mktemp("cluster")
    where = [str(Path(__file__).parents[2]), *filter(None, sys.path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(where)}
    started = []

    def start(*arguments):
        command = [sys.executable, "-m", "dask", *arguments, "--no-dashboard"]
        with (folder / f"{len(started)}.log").open("w") as log:
            started.append(subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log))

    try:
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", "scheduler.json")
        for number in range(2):
            options = ("--nthreads", "1", "--no-nanny", "--local-directory", str(folder / f"of_{number}"))
            start("worker", "--scheduler-file", "scheduler.json", *options)
        yield _address(folder / "scheduler.json")
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.wait()


def _address(file):
    """Return the address of the scheduler when both workers are there."""
    import distributed

    until = time.monotonic() + 60
    while not file.exists() and time.monotonic() < until:
        time.sleep(0.05)
    with distributed.Client(scheduler_file=str(file), set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        return client.scheduler.address


@pytest.mark.process
def test_the_command_gives_the_same(cluster, run, bags):
    results = []
    for options in ((), ("--dask", cluster)):
        ran = run("accumulate", *bags, "--output", f"{len(results)}.info", "-q", *options, *JOINT)
        assert (ran.code, ran.err) == (0, "")
        with np.load(f"{len(results)}.info") as arrays:
            results.append({name: array for name, array in arrays.items() if name != "header"})  # it names paths
    assert set(results[0]) == set(results[1])
    for name, array in results[0].items():
        np.testing.assert_array_equal(array, results[1][name], err_msg=name)


def dying_once(marker, work, *args):
    """Die amid the work where nobody did before."""
    try:
        os.close(os.open(marker, os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return work(*args)
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError("killed")


class Deadly(Executor):
    """Another executor, of which one worker dies."""

    def __init__(self, executor, marker):
        self.executor, self.marker = executor, marker

    def submit(self, work, /, *args):
        return self.executor.submit(dying_once, self.marker, work, *args)


@pytest.mark.process
def test_a_worker_that_is_killed_changes_nothing(cluster, bags, tmp_path):
    """The last test of this cluster, which has one worker less then."""
    with on_dask(Sources(bags), cluster) as placed:
        assert placed.workers == 2
        marker = tmp_path / "died"
        found = accumulate_sources(replace(placed, executor=Deadly(placed.executor, marker)), RADIUS)
        assert marker.exists()
        assert len(placed.executor._client.nthreads()) == 1
    assert_same_bits(found, accumulate_sources(Sources(bags), RADIUS))


@pytest.mark.process
def test_an_address_that_does_not_answer_is_told(monkeypatch):
    pytest.importorskip("distributed", reason="the extra dask is not installed")
    monkeypatch.setattr("drive_id.fitting.dask_cluster._PATIENCE", 0.3)
    for address in (NOBODY, "nonsense", "nothing://here:1"):
        with (
            pytest.raises(ConfigurationError, match=f"No Dask scheduler answers at {address} within 0.3 s: check"),
            on_dask(Sources([Path("bag")]), address),
        ):
            raise AssertionError("it answered")
