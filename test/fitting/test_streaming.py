"""Accumulating piece by piece gives what the samples in memory give, in memory that does not grow."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from drive_bags import blocks_of, write_blocks
from synthetic import record

from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import Spans
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identify import gather, identify
from drive_id.errors import ConfigurationError
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read import extraction
from drive_id.files.read import reader as bag_pieces
from drive_id.files.read import several as several_bags
from drive_id.files.read.several import read_recording
from drive_id.files.write.writer import write_recording
from drive_id.fitting import streaming
from drive_id.fitting.fit import accumulate_bags, fit_bags
from drive_id.fitting.sources import Sources
from drive_id.fitting.streaming import accumulate

SETTINGS = FitSettings(method="joint")


@pytest.fixture
def long(monkeypatch):
    """Treat the short recordings of the tests as long ones."""
    monkeypatch.setattr(extraction, "PART_SAMPLES", 700)
    monkeypatch.setattr(bag_pieces, "_LOCKING_PAIRS", 1000)
    monkeypatch.setattr(streaming, "Spans", partial(Spans, 1000, 4))
    monkeypatch.setattr(several_bags, "KEPT", 3000)


def assert_same(found: Evidence, expected: Evidence, accuracy: float = 1e-12) -> None:
    if expected.information is not None:
        mine, theirs = found.information.total, expected.information.total
        scale = np.sqrt(np.outer(np.diag(theirs), np.diag(theirs)))
        assert np.all(np.abs(mine - theirs) <= accuracy * scale + 1e-300)
        assert found.information.rows == expected.information.rows
    assert (found.d, found.q) == (expected.d, expected.q)
    assert found.i_max == pytest.approx(expected.i_max, rel=1e-14)
    for name in ("samples", "gaps", "idle", "outside"):
        assert getattr(found, name) == getattr(expected, name), name
    np.testing.assert_array_equal(found.visits.count, expected.visits.count)


def assert_same_as_in_memory(bags, settings=SETTINGS, signals=None, **options):
    found = accumulate(bags, settings, signals=signals, **options)
    recording = read_recording(bags, signals)
    assert_same(found.evidence, gather([recording.samples], settings))
    assert found.warnings == recording.warnings
    assert found.digests == recording.digests
    assert found.samples == len(recording.samples)
    assert found.last_stamp == recording.samples.stamp[-1]
    assert (found.truth is None) == (recording.truth is None)
    return found, recording


@pytest.mark.parametrize("i_max", [None, 310.0])
@pytest.mark.parametrize("count", [1, 2])
def test_each_bag_is_a_recording_under_its_own_conditions(tmp_path, i_max, count):
    """Whether the radius is given or found: without it, the bags were one recording under no conditions."""
    bags = [tmp_path / f"bag_{number}" for number in range(count)]
    for number, bag in enumerate(bags):
        write_recording(bag, record(duration=0.3, seed=number))
    settings = FitSettings(method="full", i_max=i_max, temperatures=(60.0, 90.0)[:count], u_dc=(400.0, 380.0)[:count])
    kept = accumulate(bags, settings).evidence.windows.finished().kept()
    for name, values in (("recording", (0, 1)), ("heating", (40.0, 70.0)), ("drop_scale", (1.0, 0.95))):
        found = np.unique(np.concatenate([getattr(windows, name) for windows in kept]))
        np.testing.assert_allclose(np.sort(found), np.sort(values[:count]), err_msg=name)


@pytest.mark.cases
@pytest.mark.parametrize("i_max", [None, 310.0])
@pytest.mark.parametrize("method", ["psm", "joint"])
@pytest.mark.usefixtures("long")
def test_a_long_recording_is_accumulated_as_in_memory(bag, method, i_max):
    settings = FitSettings(method=method, i_max=i_max)
    found, recording = assert_same_as_in_memory([bag], settings)
    assert 2000 <= sum(len(part) for part in found.validation) < 0.5 * len(recording.samples)
    mine = conclude(found.evidence, found.validation)
    expected = conclude(gather([recording.samples], settings), [recording.samples])
    inside = expected.flux_map.inside
    np.testing.assert_array_equal(mine.flux_map.inside, inside)
    for name in ("psi_d", "psi_q"):
        one, other = getattr(mine.flux_map, name)[inside], getattr(expected.flux_map, name)[inside]
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(other).max())
    assert mine.resistance == pytest.approx(expected.resistance, rel=1e-9)
    assert mine.report.mad_d == pytest.approx(expected.report.mad_d, rel=0.4)  # of parts, where the map folds


@pytest.mark.usefixtures("long")
def test_the_windows_of_method_full_are_those_in_memory(bag):
    settings = FitSettings(method="full")
    found, recording = assert_same_as_in_memory([bag], settings)
    expected = gather([recording.samples], settings).windows.finished()
    mine = found.evidence.windows.finished()
    assert mine.windows == expected.windows
    for one, other in zip(mine.folds, expected.folds, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-11 * np.abs(other).max())


def test_a_short_recording_is_fitted_from_exactly_the_same_numbers(bag):
    found, recording = assert_same_as_in_memory([bag])
    expected = gather([recording.samples], SETTINGS)
    np.testing.assert_array_equal(found.evidence.information.blocks, expected.information.blocks)
    (kept,) = found.validation
    for name in ("stamp", "i_abc", "u_abc", "angle", "speed", "run_starts"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(recording.samples, name))


@pytest.mark.parametrize("threads", [True, False])
@pytest.mark.usefixtures("long")
def test_samples_kept_and_samples_read_again_give_the_same_sums(simulation, bag, tmp_path, monkeypatch, threads):
    later = replace(simulation.samples, stamp=simulation.samples.stamp + 10**12)
    write_recording(tmp_path / "later", later, simulation.truth)
    bags, read = [bag, tmp_path / "later"], []

    def noted(path, *rest, **more):
        read.append(path)
        return bag_pieces.bag_pieces(path, *rest, **more)

    monkeypatch.setattr(several_bags, "bag_pieces", noted)
    found = []
    for kept, paths in ((0, [*bags, *bags]), (35_000, [*bags, *bags]), (45_000, bags)):
        monkeypatch.setattr(several_bags, "KEPT", kept)
        read.clear()
        found.append(accumulate(bags, SETTINGS, threads=threads))
        assert read == paths
    for one in found[1:]:
        np.testing.assert_array_equal(one.evidence.information.blocks, found[0].evidence.information.blocks)
        for name in ("samples", "last_stamp", "warnings", "digests", "unchecked"):
            assert getattr(one, name) == getattr(found[0], name)
        assert one.truth is not None


@pytest.mark.usefixtures("long")
def test_gaps_and_losses(simulation, tmp_path):
    blocks = blocks_of(simulation.samples)
    for topic, number in (("/phase_currents", 17), ("/resolver", 90), ("/phase_voltages", 91)):
        del blocks[topic][number : number + 3]
    blocks["/phase_currents"].insert(120, blocks["/phase_currents"][119])
    found, recording = assert_same_as_in_memory([write_blocks(tmp_path / "bag", blocks)])
    assert found.evidence.gaps == len(recording.samples.run_starts) - 1 >= 2
    assert any("missing in" in text for text in found.warnings)
    assert any("repeated" in text for text in found.warnings)


@pytest.mark.accuracy
@pytest.mark.usefixtures("long")
def test_several_bags(simulation, bag, tmp_path):
    samples = simulation.samples
    later = replace(samples, stamp=samples.stamp + 10**12)
    write_recording(tmp_path / "later", later, simulation.truth, block_size=50)
    write_recording(tmp_path / "same time", replace(samples, u_abc=1.001 * samples.u_abc), simulation.truth)
    bags = [bag, tmp_path / "later", tmp_path / "same time"]
    found, _ = assert_same_as_in_memory(bags)
    assert found.truth is not None
    assert any("overlaps in time" in text for text in found.warnings)
    with pytest.raises(ConfigurationError, match="the same recording"):
        accumulate([bag, bags[1], bag], SETTINGS)


@pytest.fixture(scope="module")
def one_without_references(tmp_path_factory):
    """Two bags, the first one with references up to 260 A, the second one without, and with currents up to 310 A."""
    folder = tmp_path_factory.mktemp("references")
    known, without = (record(duration=1.0, noise=0.3, i_max=i_max) for i_max in (260.0, 310.0))
    wanted = frames.to_dq(record(duration=1.0, i_max=260.0).i_abc, known.angle)
    write_recording(folder / "known", replace(known, i_dq_reference=wanted))
    write_recording(folder / "without", replace(without, stamp=without.stamp + 10**10))
    return folder / "known", folder / "without"


@pytest.mark.cases
@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
@pytest.mark.parametrize("parts", ["long", "short"])
def test_one_recording_without_references_gives_one_radius_on_every_way_in(
    one_without_references, order, parts, request
):
    """By bags it was once 260.0 A, by arrays 309.7 A."""
    if parts == "long":
        request.getfixturevalue("long")
    bags = one_without_references[order]
    samples = [read_recording([bag]).samples for bag in bags]
    further = samples[bags[0].name == "known"]
    reached = np.quantile(np.hypot(*frames.to_dq(further.i_abc, further.angle).T), 0.999)
    found = [
        gather(samples, SETTINGS).i_max,
        gather([read_recording(bags).samples], SETTINGS).i_max,
        fit_bags(Sources(bags), None, SETTINGS).drive.i_max,
    ]
    assert found == pytest.approx([found[0]] * 3, rel=1e-14)
    assert found[0] == pytest.approx(reached, rel=1e-3)


def test_one_radius_that_is_set_is_that_of_every_way_in(one_without_references, tmp_path):
    """What is merged needs it in advance, as live samples do."""
    known, without = one_without_references
    with pytest.raises(ConfigurationError, match="without has no current references to take i_max"):
        accumulate_bags(Sources([known, without]), tmp_path / "both.info", SETTINGS)
    settings = replace(SETTINGS, i_max=311.0)
    accumulate_bags(Sources([without]), tmp_path / "one.info", settings)
    samples = [read_recording([bag]).samples for bag in (known, without)]
    found = [
        identify(samples, settings),
        fit_bags(Sources([known, without]), None, settings).drive,
        fit_bags(Sources([known, tmp_path / "one.info"]), None, settings).drive,
        fit_bags(Sources([known, tmp_path / "one.info"]), None, SETTINGS).drive,
    ]
    assert [one.i_max for one in found] == [311.0] * 4
    assert [one.resistance for one in found] == pytest.approx([found[0].resistance] * 4, rel=1e-6)


@pytest.mark.usefixtures("long")
def test_bags_that_are_read_at_once(bag, tmp_path, monkeypatch):
    """Without a sample period, or with topics one behind the other, also among others."""
    text = (
        "currents: {topic: phase_currents, fields: [a, b, c]}\nvoltages: {topic: phase_voltages, fields: [a, b, c]}\n"
        "resolver: {topic: resolver, angle: angle}\n"
    ).replace("}", ", sample_period: 0.0001}")
    assert_same_as_in_memory([bag], signals=parse_signals(text, "test"))
    monkeypatch.setattr(bag_pieces, "CAPACITY", 3000)
    blocks = dict(reversed(blocks_of(read_recording([bag]).samples).items()))
    for number, parts in enumerate(blocks.values()):
        for block in parts:
            block["first"] += 10**6 * number
    sorted_by_topic = write_blocks(tmp_path / "sorted", blocks)
    for i_max in (None, 310.0):
        found, _ = assert_same_as_in_memory([sorted_by_topic, bag], FitSettings("joint", i_max=i_max))
        assert found.samples == 40_000


@pytest.mark.usefixtures("long")
def test_progress_goes_from_nothing_to_all_and_names_the_rate(bag, monkeypatch):
    monkeypatch.setattr(several_bags, "_LONG", 5000)
    told = []
    accumulate([bag], SETTINGS, tell=lambda what, share: told.append((what, share)))
    for task in ("Reading", "Accumulating"):
        shares = [share for what, share in told if what.startswith(task)]
        assert shares[0] == 0.0
        assert shares[-1] == 1.0
        assert shares == sorted(shares)
        assert len(shares) > 10
    assert any("million samples/s" in what for what, _ in told)


# -- interrupts ----------------------------------------------------------------------------------------------------


class Stop:
    """Interrupts at so many told shares of accumulating."""

    def __init__(self, after: int) -> None:
        self.left = after

    def __call__(self, what: str, _share: float) -> None:
        self.left -= what.startswith("Accumulating")
        if not self.left:
            raise KeyboardInterrupt


def test_a_fit_that_is_interrupted_leaves_nothing(bag, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        fit_bags(Sources([bag]), tmp_path / "out", SETTINGS, tell=Stop(1))
    assert list(tmp_path.iterdir()) == []


# -- memory --------------------------------------------------------------------------------------------------------

MEASURE = """
import resource, sys, tracemalloc
from pathlib import Path
from drive_id.core.fit_settings import FitSettings
from drive_id.files.read import several
from drive_id.fitting.streaming import accumulate
several.KEPT = 100_000
tracemalloc.start()
found = accumulate([Path(sys.argv[1])], FitSettings(method="joint"), threads=False)
print(found.samples, tracemalloc.get_traced_memory()[1], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""


def repeated(path: Path, samples, times: int) -> Path:
    blocks = blocks_of(samples)
    span = int(samples.stamp[-1] - samples.stamp[0]) + 5_000_000
    many = {
        topic: [
            {**block, "stamp": block["stamp"] + k * span, "first": block["first"] + k * len(samples)}
            for k in range(times)
            for block in parts
        ]
        for topic, parts in blocks.items()
    }
    return write_blocks(path, many)


@pytest.mark.process
def test_memory_does_not_grow_with_the_recording(simulation, tmp_path):
    """A recording of 60 s against one of 20 s; the shorter one is too long to be kept as a whole, of what is kept here.

    Without the thread that reads ahead: how many of its few pieces wait at the peak is up to the scheduler.
    """
    measured = []
    for times in (10, 30):
        path = repeated(tmp_path / f"bag_{times}", simulation.samples, times)
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        ran = subprocess.run(
            [sys.executable, "-c", MEASURE, str(path)], capture_output=True, text=True, check=True, env=environment
        )
        samples, traced, resident = (int(word) for word in ran.stdout.split())
        assert samples == times * len(simulation.samples)
        measured.append((traced, resident))
    (traced_short, resident_short), (traced_long, resident_long) = measured
    assert traced_long < 1.05 * traced_short  # 10 bytes of a sample would show
    assert resident_long < 1.1 * resident_short
