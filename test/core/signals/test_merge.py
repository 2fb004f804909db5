"""Several recordings, one behind the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import record

from drive_id.core.signals.join import Piece
from drive_id.core.signals.pieces import SeveralRecordings
from drive_id.errors import SamplePeriodError


def test_recordings_that_overlap_are_moved_behind_those_before():
    part = record(duration=0.05)
    later = replace(part, stamp=part.stamp + 10**12, sample_period=1.001e-4)
    parts = [part, part, later, part]
    length = int(part.stamp[-1] - part.stamp[0])
    starts = [int(part.stamp[0]), int(part.stamp[-1]) + 10**9, int(later.stamp[0]), int(later.stamp[-1]) + 10**9]
    expected = np.concatenate([start + part.stamp - part.stamp[0] for start in starts])
    several, found = SeveralRecordings(), []
    for recording in parts:
        several.begin()
        for part, continues in ((recording.part(0, 200), False), (recording.part(199, len(recording)), True)):
            found.append(several.placed(Piece(part, continues)))
    stamps = np.concatenate([piece.samples.stamp[int(piece.continues) :] for piece in found])
    np.testing.assert_array_equal(stamps, expected)
    assert several.moved == [1, 3]
    assert several.end == starts[-1] + length
    assert {piece.samples.sample_period for piece in found} == {1e-4}


@pytest.mark.parametrize(("since", "again", "told"), [(0, False, []), (0, True, [1]), (10**18, False, [1])])
def test_times_that_count_from_the_beginning_of_each_recording_tell_no_overlap(since, again, told):
    first = record(duration=0.05)
    first = replace(first, stamp=first.stamp - first.stamp[0] + since)
    several = SeveralRecordings()
    for recording in (first, first if again else replace(first, i_abc=-first.i_abc)):
        several.begin()
        several.placed(Piece(recording, False))
    assert several.moved == told


def test_rates_that_differ_are_refused():
    part = record(duration=0.05)
    several = SeveralRecordings()
    several.begin()
    several.placed(Piece(part, False))
    several.begin()
    with pytest.raises(SamplePeriodError, match="100 us in the first and 200 us in number 2"):
        several.placed(Piece(replace(part, sample_period=2e-4), False))
