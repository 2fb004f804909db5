"""Stamps that repeat or run backwards are cut out and counted, wherever one piece ends and the next begins."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.signals.signal import Signal
from drive_id.core.signals.signal_track import SignalTrack

START = 1_700_000_000_000_000_007


@pytest.mark.parametrize("numbers", [[0, 1, 2, 2, 3, 4], [0, 1, 2, 3, 1, 2, 4], [0, 2, 2, 2, 1, 3], [0, 1, 2, 3]])
def test_wherever_a_piece_ends(numbers):
    rises = [number for k, number in enumerate(numbers) if number > max(numbers[:k], default=-1)]
    for end in range(1, len(numbers)):
        track = SignalTrack("/x", recorded=True)
        for piece in (numbers[:end], numbers[end:]):
            stamp = START + 100_000 * np.array(piece, np.int64)
            track.add(Signal("/x", stamp, np.array(piece, np.float64)[:, None]))
            track.fold()
        np.testing.assert_array_equal(track.stamp, START + 100_000 * np.array(rises, np.int64))
        np.testing.assert_array_equal(track.values[:, 0], rises)
        assert track.repeated + track.backward == len(numbers) - len(rises), end
