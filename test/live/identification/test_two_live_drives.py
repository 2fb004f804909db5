"""Live samples of two drives never end in one map: requests are refused, and offer what came before and after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drive_bags import TOPICS, blocks_of
from synthetic import reciprocal_flux, record

from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.same_drive import magnet_flux
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


@pytest.mark.cases
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"later": 2.0}, "went from 15000 to 0"),
        ({"later": 2.0, "count": 35_000, "frame": "other"}, "changed from 'drive' to 'other'"),
        ({"later": 2.0, "count": 900_000}, "went from 15000 to 900000"),
        ({"later": -5000.0}, "went from 15000 to 0"),  # the clock of the drive began anew as well
    ],
)
def test_another_drive_is_kept_apart(identifier, drives, options, words):
    play(identifier, drives["first"], range(150))
    assert asked(identifier).success
    play(identifier, drives["second"], range(150), **options)
    assert_two(identifier, words)
    identifier.reset()
    play(identifier, drives["second"], range(150), **options)
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


@pytest.mark.parametrize("seed", range(10))
def test_no_script_of_changes_ends_in_one_map_of_two_drives(identifier, drives, seed):
    """Whatever is restarted, exchanged, late or repeated: a map is of one drive, and its samples are of no other."""
    rng = np.random.default_rng(seed)
    now, changed = "first", False
    count, later, frame = 0, 0.0, "drive"
    number = 0
    while number < 150:
        length = int(rng.integers(20, 80))
        play(identifier, drives[now], range(number, min(number + length, 150)), count=count, later=later, frame=frame)
        if rng.random() < 0.3:
            play(identifier, drives[now], [min(number + length, 150) - 1], count=count, later=later, frame=frame)
        number += length
        if number < 150 and rng.random() < 0.7:
            changed = True
            now = "second" if now == "first" else "first"
            sign = rng.integers(3)
            first = drives[now][0][number]["first"]
            count = -first if sign == 0 else count + (500_000 if sign == 1 else 0)
            frame = f"drive {number}" if sign == 2 else frame
    live = identifier.live
    if changed:
        with pytest.raises(DriveChangedError):
            identifier.job((), "")
    else:
        assert live.join.samples > 0
        assert asked(identifier).success


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


def stronger(i_dq):
    return 1.2 * reciprocal_flux(i_dq)


FULL = {
    "restarted": (0.010, reciprocal_flux, 0.0800),
    "double": (0.020, reciprocal_flux, 0.0800),
    "more": (0.0115, reciprocal_flux, 0.0800),
    "other": (0.010, stronger, 0.0960),
}  # resistance, ohm, flux, and that of the magnet, Wb


@pytest.fixture(scope="module")
def first_of_full():
    return list(blocks_of(record(reciprocal_flux, resistance=0.01, duration=1.5, noise=0.02)).values())


@pytest.mark.cases
@pytest.mark.parametrize("other", FULL)
def test_method_full_gives_a_map_of_each_part_and_none_of_both(tmp_path, first_of_full, other):
    resistance, flux, magnet = FULL[other]
    second = blocks_of(record(flux, resistance=resistance, duration=1.5, noise=0.02, seed=1)).values()
    settings = IdentificationSettings(output_directory=str(tmp_path), refit_share=0.0)
    identifier = Identifier(settings, FitSettings("full", i_max=300.0), tuple(TOPICS))
    play(identifier, first_of_full, range(150))
    play(identifier, list(second), range(150), later=4.0)
    with pytest.raises(DriveChangedError):
        identifier.job((), "")
    for part, true in (("before", (0.01, 0.08)), ("after", (resistance, magnet))):
        found = asked(identifier, part).identification
        assert (found.resistance, magnet_flux(found.flux_map)[0]) == pytest.approx(true, rel=2e-3)
        assert found.report.samples_read == 15_000
