"""Live samples of two drives never end in one map: requests are refused, and offer what came before and after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drive_bags import TOPICS, blocks_of
from synthetic import record

from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, DriveChangedError
from drive_id.files.messages.block_codec import encode_block
from drive_id.files.messages.messages import PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import Identifier
from drive_id.live.publishers import Publisher
from drive_id.types import silent

KINDS = (PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER)
R = {"first": 0.010, "second": 0.020}


@pytest.fixture(scope="module")
def drives():
    """Blocks by section, of 1.5 s of two drives, R 10 and 20 mΩ."""
    made = {name: record(resistance=r, duration=1.5, noise=0.01, seed=1) for name, r in R.items()}
    return {name: list(blocks_of(samples).values()) for name, samples in made.items()}


@pytest.fixture
def identifier(tmp_path):
    settings = IdentificationSettings(output_directory=str(tmp_path), refit_share=0.0)
    return Identifier(settings, FitSettings("joint", i_max=300.0), tuple(TOPICS))


def play(identifier, sections, numbers, *, count=0, later=0.0, frame="drive"):
    """Hand blocks on as a drive publishes them that counts from ``count``, ``later`` s behind their stamps."""
    for number in numbers:
        for section, blocks in enumerate(sections):
            block = blocks[number]
            columns = [np.ascontiguousarray(column) for column in block["values"].T]
            stamp = block["stamp"] + round(later * 1e9)
            identifier.receive(section, encode_block(stamp, count + block["first"], block["period"], columns, frame))


def asked(identifier, part=""):
    return identifier.job((), "", part=part)(silent)


def heard(identifier, *names):
    """Tell which publishers of each topic there are."""
    identifier.publishers([[Publisher(f"/{name}", kind, identity=f"{name}{kind}") for name in names] for kind in KINDS])


def assert_two(identifier, words):
    with pytest.raises(DriveChangedError, match=words) as refused:
        identifier.job((), "")
    assert refused.value.code == "drive_changed"
    for part, name in (("before", "first"), ("after", "second")):
        reply = asked(identifier, part)
        assert reply.success, reply.message
        assert reply.message.startswith(f"Of the samples {part} the change: ")
        assert reply.identification.resistance == pytest.approx(R[name], rel=0.15)
        assert (reply.refit is None) == (part == "before")
    said = [text for key, text in identifier.health("", [[]] * 3).values.items() if key.startswith("also")]
    assert any("come from two drives" in text for text in [identifier.health("", [[]] * 3).message, *said])


def test_another_drive_is_kept_apart(identifier, drives):
    """By its name: test_drive_watch.py has what else tells another drive, and its count alone is tried below."""
    play(identifier, drives["first"], range(150))
    assert asked(identifier).success
    play(identifier, drives["second"], range(150), later=2.0, count=35_000, frame="other")
    assert_two(identifier, "changed from 'drive' to 'other'")
    identifier.reset()
    play(identifier, drives["second"], range(150), later=2.0)
    assert asked(identifier).identification.resistance == pytest.approx(R["second"], rel=0.15)


def test_another_publisher_is_another_drive(identifier, drives):
    """Its count may go on by chance."""
    heard(identifier, "drive")
    play(identifier, drives["first"], range(150))
    heard(identifier, "drive")
    heard(identifier)  # the middleware lost sight of it
    heard(identifier, "drive")
    assert asked(identifier).success
    heard(identifier, "drive", "rival")
    play(identifier, drives["second"], range(150), later=2.0, count=20_000)
    heard(identifier, "drive", "rival")
    assert_two(identifier, "/rival publishes /phase_currents besides /drive")


def test_a_part_is_named_only_where_there_are_two(identifier, drives):
    play(identifier, drives["first"], range(50))
    heard(identifier, "drive")
    for part, words in (("before", "of one drive only"), ("other", "no part 'other'")):
        with pytest.raises(ConfigurationError, match=words):
            identifier.job((), "", part=part)
    with pytest.raises(ConfigurationError, match="a part is of the live samples only"):
        identifier.job(("bag",), "", part="after")


def test_two_drives_at_once_give_no_map(identifier, drives):
    for number in range(150):
        play(identifier, drives["first"], [number])
        play(identifier, drives["second"], [number], count=70_000)
    with pytest.raises(DriveChangedError, match=r"There were 29\d changes"):
        identifier.job((), "")
    with pytest.raises(ConfigurationError, match="Too few samples came before"):
        asked(identifier, "before")
    assert not asked(identifier, "after").success


def test_settings_reach_both_parts(identifier, drives):
    play(identifier, drives["first"], range(60))
    play(identifier, drives["second"], range(60), later=2.0)
    assert not identifier.configure(replace(identifier.live.settings, method="psm"))
    with pytest.raises(DriveChangedError):
        identifier.job((), "")
    assert not identifier.configure(replace(identifier.live.settings, i_max=200.0))
    with pytest.raises(DriveChangedError):
        identifier.job((), "")
    assert identifier.configure(replace(identifier.live.settings, i_max=100.0))
    identifier.job((), "")  # all are forgotten
