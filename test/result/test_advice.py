"""What to record next does not contradict what the warnings say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exact_results import exact_result

from drive_id.bench.machines import machine_map
from drive_id.common.messages import Message
from drive_id.core.maps.coverage import disc_coverage
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.files.results.identification import Provenance
from drive_id.result.advice import advice


def recorded(where, statement="second_speed") -> tuple[IdentifiedDrive, Provenance, float]:
    """Return a drive with data at such currents, relative to i_max, whose fit wants a second speed."""
    result = exact_result(machine_map("ipm"))
    drive, known = result.drive, replace(result.provenance, pole_pairs=4)
    found = drive.flux_map
    inside = where(*np.moveaxis(found.grid(), -1, 0) / drive.i_max)
    coverage = disc_coverage(found.i_d, found.i_q, inside, drive.i_max)
    report = replace(drive.report, coverage=coverage)
    drive = replace(drive, flux_map=replace(found, inside=inside), report=report, statements=(Message(statement),))
    return drive, known, coverage


def rings(d, q):
    """Thin lines all over the disc, as a short recording leaves them."""
    return (np.hypot(d, q) <= 1) & ((np.arange(len(d))[:, None] % 4 == 0) | (np.hypot(d, q) > 0.93))


def test_where_most_of_the_disc_has_no_data_they_help_most():
    drive, known, coverage = recorded(lambda d, q: (np.hypot(d, q) <= 1) & (d <= 0) & (q >= 0))
    assert coverage < 0.3
    first, second = advice(drive, known)
    assert first.startswith("Record over the whole disc of ")
    assert second.code == "second_speed"


def test_between_the_lines_of_a_short_recording_are_no_data():
    drive, known, coverage = recorded(rings)
    assert coverage < 0.45
    first, _ = advice(drive, known)
    assert first.startswith("Record longer, or along a denser trajectory: ")
    assert first.values["missing"] == pytest.approx(1 - coverage, abs=0.06)


def test_where_much_is_covered_the_fit_knows_better():
    drive, known, coverage = recorded(lambda d, q: (np.hypot(d, q) <= 1) & (d <= 0.4))
    assert 0.45 < coverage < 0.95
    assert [message.code for message in advice(drive, known)] == ["second_speed", "cover_disc"]


def test_the_disc_is_asked_for_once():
    drive, known, _ = recorded(lambda d, q: (np.hypot(d, q) <= 1) & (d <= 0), "cover_disc")
    assert [message.code for message in advice(drive, known)] == ["cover_disc"]
