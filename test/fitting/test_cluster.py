"""Bags on a Dask cluster: the same result on any cluster, also when a worker dies, and errors in one sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dask_processes import own_cluster
from drive_bags import TRAJECTORY

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ClusterError, ConfigurationError, DriveIdError
from drive_id.files.write.writer import write_recording
from drive_id.fitting.cluster import accumulate_on_cluster
from drive_id.fitting.fit import accumulate_bags, fit_bags
from drive_id.fitting.simulated import run_experiment
from drive_id.fitting.sources import Sources, accumulate_sources

pytest.importorskip("distributed", reason="the extra 'fleet' is not installed")

JOINT = FitSettings(method="joint")
RADIUS = replace(JOINT, i_max=300.0)


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Five recordings of one drive; read only."""
    folder = tmp_path_factory.mktemp("bags")
    for number in range(5):
        settings = SimulationSettings(current_noise=1e-3, seed=number)
        simulation = run_experiment(machine_map("ipm"), settings, TRAJECTORY, 0.6)
        write_recording(folder / f"bag_{number}", simulation.samples, simulation.truth)
    return [folder / f"bag_{number}" for number in range(5)]


@pytest.fixture(scope="module")
def alone(bags):
    """What one process makes of them."""
    return accumulate_sources(Sources(bags), RADIUS)


@pytest.fixture(scope="module")
def mortal(tmp_path_factory):
    with own_cluster(tmp_path_factory.mktemp("cluster"), workers=0) as cluster:
        yield cluster


@pytest.fixture
def cluster(mortal):
    """A cluster of two workers, whichever tests have killed."""
    mortal.keep_workers(2)
    return mortal


@pytest.fixture
def shared(cluster):
    return cluster.address


def assert_same(one, other) -> None:
    """To the last bit."""
    states = [accumulated.evidence.state() for accumulated in (one, other)]
    assert set(states[0]) == set(states[1])
    for name, array in states[0].items():
        np.testing.assert_array_equal(array, states[1][name], err_msg=name)
    for name in ("warnings", "digests", "samples", "last_stamp"):
        assert getattr(one, name) == getattr(other, name), name
    for first, second in zip(one.validation, other.validation, strict=True):
        np.testing.assert_array_equal(first.i_abc, second.i_abc)


@pytest.mark.parametrize("workers", [1, 2])
def test_the_result_is_that_of_one_process(bags, alone, workers):
    told = []
    found = accumulate_on_cluster(
        Sources(bags, cluster=f"local:{workers}"), RADIUS, tell=lambda what, share: told.append((what, share))
    )  # fmt: skip
    assert_same(found, alone)
    shares = [share for what, share in told if what == "Accumulating"]
    assert shares == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])


def test_a_worker_that_dies_in_the_middle_changes_nothing(bags, alone, cluster):
    killed = []

    def kill(what, share):
        if what == "Accumulating" and 0 < share < 1 and not killed:
            killed.append(share)
            cluster.kill(cluster.workers[0])

    assert_same(accumulate_on_cluster(Sources(bags, cluster=cluster.address), RADIUS, tell=kill), alone)
    assert killed
    assert cluster.workers[1].poll() is None


def test_a_worker_that_dies_when_all_but_the_last_is_done_changes_nothing(bags, alone, cluster):
    """What it had done is done again."""

    def kill(what, share):
        if what == "Accumulating" and share == pytest.approx(0.8):
            cluster.kill(cluster.workers[0])

    assert_same(accumulate_on_cluster(Sources(bags, cluster=cluster.address), RADIUS, tell=kill), alone)
    assert cluster.workers[0].poll() is not None


def test_relative_paths_are_found_by_workers_elsewhere(bags, alone, shared, monkeypatch):
    monkeypatch.chdir(bags[0].parent)
    found = accumulate_on_cluster(Sources([Path(bag.name) for bag in bags], cluster=shared), JOINT)
    assert_same(found, alone)  # the radius is that of the references


def test_a_scheduler_that_is_lost_is_told(bags, tmp_path):
    def kill(what, _share):
        if what == "Accumulating" and cluster.scheduler.poll() is None:
            cluster.kill(cluster.scheduler)

    with own_cluster(tmp_path, workers=1) as cluster, pytest.raises(ClusterError, match="was lost during the fit"):
        accumulate_on_cluster(Sources(bags, cluster=cluster.address), RADIUS, tell=kill)


def test_workers_that_are_all_lost_are_not_waited_for_for_ever(bags, cluster, monkeypatch):
    monkeypatch.setattr("drive_id.fitting.cluster.PATIENCE", 1.0)

    def kill(what, share):
        if what == "Accumulating" and share > 0:
            for worker in cluster.workers:
                if worker.poll() is None:
                    cluster.kill(worker)

    with pytest.raises(ClusterError, match="was lost during the fit"):
        accumulate_on_cluster(Sources(bags, cluster=cluster.address), RADIUS, tell=kill)


def test_bad_bags(bags, alone, shared, tmp_path):
    (tmp_path / "bad.mcap").write_text("no bag")
    sources = [*bags[:2], tmp_path / "bad.mcap", *bags[2:]]
    for settings in (RADIUS, FitSettings(method="joint")):
        with pytest.raises(DriveIdError, match=r"bad\.mcap is neither an MCAP nor a sqlite3 recording"):
            accumulate_on_cluster(Sources(sources, cluster=shared), settings)
    fit = fit_bags(Sources(sources, cluster=shared, skip_bad=True), None, RADIUS)
    assert fit.warnings[0].startswith(f"Left out: {tmp_path / 'bad.mcap'} is neither")
    assert fit.drive.report.samples_read == alone.samples


def test_information_files_from_a_cluster_and_for_a_cluster(bags, alone, shared, tmp_path):
    accumulate_bags(Sources(bags[:3], cluster=shared), tmp_path / "x.info", FitSettings(method="joint"))
    found = accumulate_on_cluster(Sources([tmp_path / "x.info", *bags[3:]], cluster=shared), JOINT)
    np.testing.assert_allclose(found.evidence.information.total, alone.evidence.information.total, atol=1e-9)
    with pytest.raises(ConfigurationError, match=r"x\.info was accumulated differently"):
        accumulate_on_cluster(
            Sources([tmp_path / "x.info", bags[3]], cluster=shared), FitSettings("joint", splines_d=9)
        )
