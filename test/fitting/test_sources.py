"""Several sources: what is accumulated apart and merged is fitted like the bags together."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive_bags import TRAJECTORY, with_arrays
from same_bits import assert_same_bits

import drive_id
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.common.messages import Message
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, DriveIdError, InformationError, NotABagError, WorkerError
from drive_id.files.results.information import read_information, write_information
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import accumulate_bags, fit_bags
from drive_id.fitting.processes import in_order, in_processes
from drive_id.fitting.simulated import simulate_bag
from drive_id.fitting.sources import Sources, accumulate_sources, pairwise

JOINT = FitSettings(method="joint")
RADIUS = replace(JOINT, i_max=300.0)


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Three recordings of one drive, of different lengths and speeds; read only."""
    folder = tmp_path_factory.mktemp("bags")
    for number, (speed, seconds) in enumerate(((500.0, 1.03), (800.0, 0.71), (300.0, 1.2))):
        settings = SimulationSettings(current_noise=1e-3, speeds=(speed,), seed=number)
        simulate_bag(machine_map("ipm"), settings, folder / f"bag_{number}", TRAJECTORY, seconds)
    return [folder / f"bag_{number}" for number in range(3)]


@pytest.fixture(scope="module")
def infos(bags, tmp_path_factory):
    """Each bag as an information file; read only."""
    folder = tmp_path_factory.mktemp("infos")
    for bag in bags:
        accumulate_bags(Sources([bag]), folder / f"{bag.name}.info", RADIUS)
    return [folder / f"{bag.name}.info" for bag in bags]


@pytest.fixture(scope="module")
def together(bags):
    return fit_bags(Sources(bags), None, RADIUS)


def assert_same_fit(one, other, rel: float = 1e-9) -> None:
    for name in ("resistance", "sigma_resistance", "voltage_error", "sigma_voltage_error", "i_max"):
        first, second = (getattr(fit.drive, name) for fit in (one, other))
        assert first == pytest.approx(second, rel=rel), name
    maps = [fit.drive.flux_map for fit in (one, other)]
    np.testing.assert_array_equal(maps[0].inside, maps[1].inside)
    for name in ("i_d", "psi_d", "psi_q", "sigma_d", "sigma_q"):
        first, second = (getattr(flux_map, name) for flux_map in maps)
        np.testing.assert_allclose(first, second, rtol=0, atol=rel * np.nanmax(np.abs(second)), err_msg=name)
    reports = [replace(fit.drive.report, mad_d=0.0, mad_q=0.0, warnings=()) for fit in (one, other)]
    for name in ("samples_read", "samples_used", "gaps", "rows", "rank", "unseen", "coverage"):
        assert getattr(reports[0], name) == getattr(reports[1], name), name
    for name in ("condition", "residual_rms"):
        assert getattr(reports[0], name) == pytest.approx(getattr(reports[1], name), rel=rel), name
    assert one.provenance.nrmse == pytest.approx(other.provenance.nrmse, rel=rel)
    assert sorted(one.provenance.inputs.values()) == sorted(other.provenance.inputs.values())


def test_information_files_are_fitted_like_their_bags_together(infos, together):
    assert_same_fit(fit_bags(Sources(infos), None, RADIUS), together)


@pytest.mark.accuracy
def test_whatever_the_order_and_the_mixture(bags, infos, together, tmp_path):
    accumulate_bags(Sources([bags[2], bags[0]]), tmp_path / "two.info", RADIUS)
    for sources in ([infos[2], infos[0], infos[1]], [bags[0], infos[2], bags[1]], [tmp_path / "two.info", bags[1]]):
        assert_same_fit(fit_bags(Sources(sources), None, RADIUS), together)


@pytest.mark.accuracy
def test_method_full_merges_too(bags, tmp_path):
    settings = FitSettings("full", i_max=300.0, harmonic_orders=(6,), search_orders=False, maps="reciprocal")
    two = sorted(bags)[:2]
    for bag in two:
        accumulate_bags(Sources([bag]), tmp_path / f"{bag.name}.info", settings)
    apart = fit_bags(Sources(sorted(tmp_path.glob("*.info"))), None, settings)
    assert_same_fit(apart, fit_bags(Sources(two), None, settings), rel=1e-7)


def test_the_mad_is_that_of_a_piece_of_each_recording(infos, together):
    report = fit_bags(Sources(infos), None, RADIUS).drive.report
    assert report.mad_d == pytest.approx(together.drive.report.mad_d, rel=0.3)
    assert report.mad_q == pytest.approx(together.drive.report.mad_q, rel=0.3)


def test_another_method_can_be_asked_for_later(bags, infos):
    psm = replace(RADIUS, method="psm")
    assert_same_fit(fit_bags(Sources(infos), None, psm), fit_bags(Sources(bags), None, psm))


def test_without_a_radius_it_is_that_of_the_first_file_or_of_the_references(bags, infos, together):
    assert_same_fit(fit_bags(Sources([bags[0], infos[1], bags[2]]), None, FitSettings(method="joint")), together)
    assert accumulate_sources(Sources(bags), FitSettings(method="joint")).evidence.i_max == 300.0


def test_a_bag_without_references_needs_a_radius(bags, simulation, tmp_path):
    write_recording(tmp_path / "bag", with_arrays(simulation.samples))
    with pytest.raises(ConfigurationError, match=r"bag has no current references .*: give --i-max, "):
        accumulate_sources(Sources([bags[0], tmp_path / "bag"]), FitSettings(method="joint"))
    assert accumulate_sources(Sources([tmp_path / "bag"]), RADIUS).samples == len(simulation.samples)


def test_settings_are_taken_from_the_first_file(infos, bags, tmp_path):
    settings = replace(RADIUS, splines_d=6, method="psm")
    accumulate_bags(Sources(bags[:1]), tmp_path / "x.info", replace(settings, i_max=None))
    assert Sources([bags[0], tmp_path / "x.info", infos[0]]).stored_settings() == settings
    assert Sources(bags).stored_settings() is None
    (tmp_path / "cut.info").touch()
    with pytest.raises(InformationError, match=r"cut\.info"):
        Sources([tmp_path / "cut.info", tmp_path / "x.info"]).stored_settings()
    assert Sources([tmp_path / "cut.info", tmp_path / "x.info"], skip_bad=True).stored_settings() == settings


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (replace(RADIUS, splines_d=9), "splines_d is 8 there and 9 here"),
        (replace(RADIUS, i_max=280.0), "i_max is 300 A there and 280 A here"),
    ],
)
@pytest.mark.parametrize("skip_bad", [False, True])
def test_files_of_other_settings_are_named(infos, settings, said, skip_bad):
    with pytest.raises(ConfigurationError) as caught:
        fit_bags(Sources(infos, skip_bad=skip_bad), None, settings)
    assert str(caught.value) == (
        f"{infos[0]} was accumulated differently ({said}) and cannot be merged: accumulate it again with these "
        "settings, or remove them."
    )


def test_the_same_recording_is_not_counted_twice(bags, infos):
    with pytest.raises(ConfigurationError, match="are the same recording: give each bag once"):
        fit_bags(Sources([infos[0], bags[1], bags[0]]), None, RADIUS)


@pytest.fixture
def bad(infos, simulation, tmp_path):
    """Three bad sources: none, one that breaks off, and one whose samples are bad but whose error names no file."""
    shutil.copy(infos[0], tmp_path / "cut.info")
    os.truncate(tmp_path / "cut.info", 1000)
    still = with_arrays(simulation.samples, speed=0 * simulation.samples.speed)
    write_recording(tmp_path / "still", still)
    return [tmp_path / "none", tmp_path / "cut.info", tmp_path / "still"]


def test_a_bad_source_is_named(bags, bad):
    for source in bad:
        for settings in (RADIUS, FitSettings(method="joint")):
            with pytest.raises(DriveIdError, match=f"{source.name}") as caught:
                accumulate_sources(Sources([bags[0], source]), settings)
            assert str(source) in str(caught.value)


def test_bad_sources_are_left_out_on_request(bags, bad, together, tmp_path):
    sources = [bad[0], bags[0], bad[1], bags[1], bad[2], bags[2]]
    fit = fit_bags(Sources(sources, skip_bad=True), tmp_path / "out", RADIUS)
    assert_same_fit(fit, together)
    left_out = [text for text in fit.warnings if text.startswith("Left out: ")]
    assert len(left_out) == 3
    for source, text in zip(bad, left_out, strict=True):
        assert str(source) in text
    with pytest.raises(NotABagError):
        fit_bags(Sources(bad, skip_bad=True), None, RADIUS)
    with pytest.raises(NotABagError):
        fit_bags(Sources(bad[:2], skip_bad=True), None, FitSettings(method="joint"))


def test_warnings_name_their_source_where_there_are_several(bags, infos, tmp_path):
    stored = read_information(infos[0]).accumulated
    write_information(tmp_path / "x.info", replace(stored, warnings=(Message.told("Something."),)))
    assert accumulate_sources(Sources([tmp_path / "x.info"]), RADIUS).warnings == ("Something.",)
    both = accumulate_sources(Sources([tmp_path / "x.info", bags[1]]), RADIUS)
    assert both.warnings == (f"{tmp_path / 'x.info'}: Something.",)


def test_nothing_is_accumulated_for_an_output_that_cannot_be(bags, tmp_path, monkeypatch):
    def fail(*_args, **_options):
        raise AssertionError("too late")

    monkeypatch.setattr("drive_id.fitting.fit.accumulate_sources", fail)
    (tmp_path / "notes").touch()
    with pytest.raises(DriveIdError, match="exists already"):
        accumulate_bags(Sources(bags), tmp_path / "notes", RADIUS)


def test_no_source_at_all():
    with pytest.raises(ConfigurationError, match="No bag is given"):
        Sources([])


@pytest.mark.parametrize("count", range(1, 18))
def test_pairs_are_those_of_a_tree_and_few_are_kept(count):
    """One level after the other, as one would do with a list."""
    level = list(map(str, range(count)))
    while len(level) > 1:
        pairs = [f"({a}{b})" for a, b in zip(level[::2], level[1::2], strict=False)]
        level = pairs + level[len(level) // 2 * 2 :]
    assert pairwise(map(str, range(count)), lambda a, b: f"({a}{b})") == level[0]


def test_paths_may_be_relative(bags, together, monkeypatch):
    monkeypatch.chdir(bags[0].parent)
    assert_same_fit(fit_bags(Sources([Path(bag.name) for bag in bags], skip_bad=True), None, RADIUS), together)


@pytest.mark.process
def test_the_result_of_several_processes_is_that_of_one(bags):
    told = []
    found = accumulate_sources(Sources(bags, workers=2), JOINT, tell=lambda what, share: told.append((what, share)))
    assert_same_bits(found, accumulate_sources(Sources(bags), JOINT))
    assert [share for what, share in told if what == "Accumulating"] == pytest.approx([0, 1 / 3, 2 / 3, 1])
    assert not multiprocessing.active_children()


def test_the_result_of_any_executor_is_that_of_one_process(bags, infos):
    sources = [bags[0], infos[1], bags[2]]
    with ThreadPoolExecutor(2) as executor:
        found = accumulate_sources(Sources(sources, executor=executor), RADIUS)
        assert_same_bits(found, accumulate_sources(Sources(sources), RADIUS))
        fitted = drive_id.fit(bags, executor=executor, settings=RADIUS)
        assert fitted.resistance == drive_id.fit(bags, skip_bad=True, settings=RADIUS).resistance
        assert executor.submit(abs, -1).result() == 1  # it is the caller's, who may go on with it


class Sent(Executor):
    """Computes at once, as if elsewhere, and keeps what would be sent there."""

    def __init__(self):
        self.sent = []

    def submit(self, work, /, *args):
        self.sent.append(pickle.dumps((work, args)))
        future = Future()
        work, args = pickle.loads(self.sent[-1])
        future.set_result(work(*args))
        return future


def test_elsewhere_a_path_is_absolute_and_goes_alone(bags, monkeypatch):
    """Ten thousand paths with each of ten thousand recordings would be 10 GB."""
    monkeypatch.chdir(bags[0].parent)
    executor = Sent()
    accumulate_sources(Sources([Path(bag.name) for bag in bags], executor=executor), JOINT)
    assert len(executor.sent) == 6  # i_max of each, and then its sums
    for sent in executor.sent[1:3] + executor.sent[4:]:  # the first path tells which settings belong to all
        _, (given,) = pickle.loads(sent)
        path = given if isinstance(given, Path) else given[0]
        assert path.is_absolute()
        assert sum(bag.name.encode() in sent for bag in bags) <= 2


@pytest.mark.process
def test_an_executor_whose_process_dies_is_told():
    with (
        ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as executor,
        pytest.raises(WorkerError, match="A process of the executor has died"),
    ):
        list(in_processes(die, range(8), 2, executor))


@pytest.mark.process
def test_a_bad_bag_ends_the_processes_or_is_left_out(bags, tmp_path):
    (tmp_path / "bad.mcap").write_text("no bag")
    sources = [bags[0], tmp_path / "bad.mcap", *bags[1:]]
    with pytest.raises(DriveIdError, match=r"bad\.mcap is neither"):
        accumulate_sources(Sources(sources, workers=2), RADIUS)
    assert not multiprocessing.active_children()
    found = accumulate_sources(Sources(sources, workers=2, skip_bad=True), RADIUS)
    assert found.warnings[0].startswith(f"Left out: {tmp_path / 'bad.mcap'} is neither")


def die(number):
    os.kill(os.getpid(), signal.SIGKILL if number == 3 else 0)
    return number


def fail(number):
    raise ArithmeticError(number)


@pytest.mark.process
def test_an_error_of_the_work_is_raised_with_its_place():
    with pytest.raises(ArithmeticError, match="5") as caught:
        list(in_processes(fail, [5], 2))
    assert "in fail" in str(caught.value.__cause__)
    with pytest.raises(TypeError, match="pickle"):
        list(in_processes(open, [os.devnull], 2))  # its result cannot be sent
    assert not multiprocessing.active_children()


def test_any_executor_computes_in_order():
    with ThreadPoolExecutor(3) as executor:
        found = in_order(abs, (-n for n in range(20)), executor, ahead=5)
        assert [next(found) for _ in range(3)] == [0, 1, 2]
        assert [*found] == [*range(3, 20)]


@pytest.mark.process
def test_a_process_that_dies_is_told():
    with pytest.raises(WorkerError, match="has died, probably for lack of memory: use fewer --workers"):
        list(in_processes(die, range(8), 2))
    assert not multiprocessing.active_children()


def test_results_come_in_order_and_do_not_pile_up():
    taken = []
    found = in_processes(abs, (taken.append(n) or -n for n in range(20)), 2)
    assert [next(found) for _ in range(3)] == [0, 1, 2]
    assert len(taken) <= 3 + 4
    found.close()
    assert not multiprocessing.active_children()


def children(process):
    """Return the folders in /proc of the processes that any thread of a process has started."""
    found = []
    for task in Path(f"/proc/{process.pid}/task").iterdir():
        with suppress(OSError):  # it has just ended
            found += (task / "children").read_text().split()
    return [Path("/proc") / pid for pid in found]


def test_an_interrupt_leaves_neither_processes_nor_tracebacks(bags, tmp_path):
    """Ctrl-C goes to all processes of a terminal."""
    script = (
        "import sys\n"
        "from pathlib import Path\n"
        "from drive_id.cli.app import main\n"
        "if __name__ == '__main__':\n"
        "    sys.argv = ['drive-id', 'fit', *sys.argv[1:]]\n"
        "    main()\n"
    )
    (tmp_path / "fit.py").write_text(script)
    command = [sys.executable, tmp_path / "fit.py", *bags, "--workers", "2", "--i-max", "300", "--output", "out"]
    with subprocess.Popen(
        command, cwd=tmp_path, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        until = time.monotonic() + 60
        while len(workers := children(process)) < 3 and time.monotonic() < until:  # two, and the resource tracker
            time.sleep(0.01)
        assert len(workers) == 3
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in said
    assert "interrupted" in said
    while any(worker.exists() for worker in workers) and time.monotonic() < until:
        time.sleep(0.01)
    assert not any(worker.exists() for worker in workers)
