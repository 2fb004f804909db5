"""A bag in which the drive was restarted or exchanged: one map only if its parts can be of one drive."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from drive_bags import TOPICS, blocks_of
from synthetic import reciprocal_flux, record, saturating_flux

import drive_id
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import DriveChangedError
from drive_id.files.messages.block_codec import encode_block
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter
from drive_id.fitting.fit import accumulate_bags, fit_bags
from drive_id.fitting.sources import Sources, read_bag
from drive_id.inspection.inspect import check

SETTINGS = FitSettings("joint", i_max=300.0)
MARKED = {"recordings": "2", "recording_2:because": "/other publishes besides /drive: stop one of the two drives."}


def stronger(i_dq):
    return 1.2 * saturating_flux(i_dq)


DRIVES = {
    "first": partial(record, resistance=0.010),
    "hot": partial(record, resistance=0.0101),
    "double": partial(record, resistance=0.020),
    "more": partial(record, resistance=0.0115),
    "other": partial(record, stronger, resistance=0.010),
}


@pytest.fixture(scope="module")
def drives():
    """Samples, 3 s each."""
    return {name: make(duration=3.0, noise=0.02, seed=k) for k, (name, make) in enumerate(DRIVES.items())}


def write(path, parts, gap=1.5, counts=(0, 0, 0), custom=None):
    """Record the samples of one drive behind those of another, ``gap`` s later."""
    shift = 0
    with Rosbag2McapWriter(path) as writer:
        for topic, kind in TOPICS.items():
            writer.add_topic(topic, kind)
        for samples, begin in zip(parts, counts, strict=False):
            queue = [(block["first"], topic, block) for topic, own in blocks_of(samples).items() for block in own]
            for first, topic, block in sorted(queue, key=lambda entry: entry[:2]):
                columns = [np.ascontiguousarray(column) for column in block["values"].T]
                data = encode_block(block["stamp"] + shift, begin + first, block["period"], columns, "drive")
                writer.write(topic, data, block["stamp"] + shift)
            end = int(samples.stamp[-1]) + shift
            shift += int(samples.stamp[-1] - samples.stamp[0]) + round(gap * 1e9)
        custom = custom and {**custom, "recording_2:begins": str(end - 3 * 10**9)}
        writer.close(custom)
    return path


def fitted(path, **settings):
    return fit_bags(Sources([path]), None, replace(SETTINGS, **settings))


@pytest.mark.cases
@pytest.mark.parametrize("other", ["double", "more", "other"])
def test_an_exchanged_drive_is_refused(drives, tmp_path, other):
    path = write(tmp_path / "bag", [drives["first"], drives[other]])
    with pytest.raises(DriveChangedError) as refused:
        fitted(path)
    assert refused.value.code == "drive_changed"
    assert "The count of /phase_currents went from 30000 to 0" in str(refused.value)
    assert ("psi_PM is" if other == "other" else "R is") in str(refused.value)
    with pytest.raises(DriveChangedError):
        accumulate_bags(Sources([path]), tmp_path / "sums", SETTINGS)
    assert not (tmp_path / "sums").exists()


@pytest.mark.cases
@pytest.mark.parametrize(("again", "gap"), [("first", -3600.0), ("hot", 0.5), ("hot", 1000.0)])
def test_a_restarted_drive_gives_one_map_of_both_parts(drives, tmp_path, again, gap):
    """Whatever its clock says, which may begin anew as well."""
    path = write(tmp_path / "bag", [drives["first"], drives[again]], gap)
    found = fitted(path)
    assert found.drive.report.samples_read == 60_000
    codes = [warning.code for warning in found.warnings]
    assert codes[:2] == ["another_drive", "same_drive"]
    assert found.drive.resistance == pytest.approx(0.01, rel=0.03)
    assert len(read_bag_samples(path)) == 60_000
    assert "another_drive" in [finding.code for finding in check(path).warnings]


def read_bag_samples(path):
    with pytest.warns(UserWarning, match="restarted or exchanged"):
        return read_bag(path)


@pytest.mark.accuracy
def test_a_change_that_only_the_recorder_noticed(drives, tmp_path):
    """test_drive_watch.py has what the blocks themselves tell."""
    path = write(tmp_path / "bag", [drives["first"], drives["double"]], counts=(0, 30_000 + 15_000), custom=MARKED)
    with pytest.raises(DriveChangedError, match="besides /drive"):
        fitted(path)


def test_a_part_that_is_too_short_is_left_out(drives, tmp_path):
    whole, rng = drives["double"], np.random.default_rng(0)
    short = replace(whole, i_abc=whole.i_abc + 3.0 * rng.standard_normal((30_000, 3))).part(0, 3000)
    path = write(tmp_path / "bag", [drives["first"], short])
    found = fitted(path)
    assert found.drive.report.samples_read == 30_000
    assert [warning.code for warning in found.warnings][:2] == ["another_drive", "left_out"]
    assert found.drive.resistance == pytest.approx(0.01, rel=0.03)


def test_two_drives_at_once_are_refused(drives, tmp_path):
    """Blocks of both in turn: no part holds more than one."""
    one, other = (blocks_of(drives[name]) for name in ("first", "double"))
    with Rosbag2McapWriter(tmp_path / "bag") as writer:
        for topic, kind in TOPICS.items():
            writer.add_topic(topic, kind)
        for at in range(300):
            for begin, blocks in ((0, one), (70_000, other)):
                for topic in TOPICS:
                    block = blocks[topic][at]
                    columns = [np.ascontiguousarray(column) for column in block["values"].T]
                    data = encode_block(block["stamp"], begin + block["first"], block["period"], columns, "drive")
                    writer.write(topic, data, block["stamp"])
    with pytest.raises(DriveChangedError, match="from one drive to another"):
        fitted(tmp_path / "bag")


def told(found):
    return [str(warning) for warning in found.warnings if warning.code == "unlike_parts"]


@pytest.mark.parametrize(("method", "apart"), [("joint", False), ("psm", True)])
def test_recordings_of_two_drives_are_told(drives, tmp_path, method, apart):
    """Each is a bag of its own, of which no count tells anything."""
    paths = [write(tmp_path / name, [drives[name]]) for name in ("first", "other")]
    (said,) = told(fit_bags(Sources(paths, skip_bad=apart), None, replace(SETTINGS, method=method)))
    assert re.match(r"In recording 2, psi_d differs by (20|19\.99).* %, psi_q by (20|19\.99).* % and R by 0\.0", said)


def test_a_bag_of_another_drive_is_told_beside_one_in_which_the_drive_was_restarted(drives, tmp_path):
    restarted = write(tmp_path / "restarted", [drives["first"], drives["hot"]])
    paths = [restarted, write(tmp_path / "other", [drives["other"]])]
    assert "In recording 3, psi_d differs by 20.0" in told(fit_bags(Sources(paths), None, SETTINGS))[0]


@pytest.fixture(scope="module")
def later():
    """Recordings of the drive ``first`` under other conditions, by what they are."""

    def warm(i_dq):
        return saturating_flux(i_dq) - np.array([0.04 * 0.08, 0.0])

    def another(t, i_max):
        phase = 2 * np.pi * 0.7 * t
        return i_max * np.stack([np.cos(phase) * np.sin(2 * np.pi * 5.3 * t), np.sin(phase)], axis=-1)

    made = {
        "hot": {"flux": warm, "resistance": 0.014},
        "fast": {"speed": 800.0},
        "backwards": {"speed": -150.0},
        "weak": {"i_max": 100.0, "speed": 300.0},
        "otherwise": {"current": another},
    }
    return {
        name: record(**({"resistance": 0.010, "duration": 3.0, "noise": 0.1, "seed": 7} | given))
        for name, given in made.items()
    }


@pytest.mark.parametrize("name", ["hot", "fast", "backwards", "weak", "otherwise"])
def test_one_drive_under_other_conditions_is_no_other(drives, later, name):
    assert told(drive_id.fit([drives["first"], later[name]], settings=SETTINGS)) == []


def test_a_resistance_that_no_heat_explains_is_told_and_how_many_have_it(drives):
    found = drive_id.fit([drives[name] for name in ("first", "hot", "double", "more", "double")], settings=SETTINGS)
    (said,) = told(found)
    assert said.startswith("In recording 3, ")
    assert "and R by 99.8" in said
    assert "This holds for 1 other recording as well." in said


def stronger_reciprocal(i_dq):
    return 1.2 * reciprocal_flux(i_dq)


FULL = {"the same": (0.010, reciprocal_flux), "more": (0.0115, reciprocal_flux), "other": (0.010, stronger_reciprocal)}


@pytest.fixture(scope="module")
def full_drives():
    """Samples, 2 s each, of machines whose maps are gradients."""
    return {
        name: record(flux, resistance=r, duration=2.0, noise=0.02, seed=seed)
        for seed, (name, (r, flux)) in enumerate({"first": FULL["the same"], **FULL}.items())
    }


@pytest.mark.slow  # three fits of method full each
@pytest.mark.parametrize(
    "other", [pytest.param(name, marks=pytest.mark.essential) if name == "more" else name for name in FULL]
)
def test_method_full_keeps_drives_apart_and_joins_one_that_was_restarted(full_drives, tmp_path, other):
    path = write(tmp_path / "bag", [full_drives["first"], full_drives[other]])
    if other == "the same":
        found = fitted(path, method="full")
        assert found.drive.report.samples_read == 40_000
        assert "same_drive" in [warning.code for warning in found.warnings]
        assert found.drive.resistance == pytest.approx(0.01, rel=1e-3)
        return
    with pytest.raises(DriveChangedError, match="psi_PM is" if other == "other" else "R is") as refused:
        fitted(path, method="full")
    assert refused.value.code == "drive_changed"
