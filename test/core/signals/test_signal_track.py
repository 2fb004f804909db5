"""Stamps that repeat or run backwards are cut out and counted, wherever one piece ends and the next begins."""

from __future__ import annotations

from dataclasses import replace

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


def blocks(numbers, *, size=10):
    """Blocks of a signal at 10 kHz, whose values are the numbers of their samples."""
    for number in numbers:
        count = size * number + np.arange(size)
        yield Signal("/x", START + 100_000 * count, count[:, None].astype(np.float64), 1e-4, np.zeros(1, np.int64))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("recorded", [True, False])
def test_late_blocks_are_put_in_their_places(recorded, seed):
    rng = np.random.default_rng(seed)
    sent = np.append(0, 1 + np.flatnonzero(rng.random(600) > 0.05))  # some are lost for good
    arrived = sent[np.argsort(sent + rng.uniform(0, 100, len(sent)) * (sent > 0), kind="stable")]
    track, most = SignalTrack("/x", recorded=recorded), 0
    for piece in blocks(arrived):
        track.add(piece)
        track.fold()
        most = max(most, len(track._held[0]))
    track.fold(final=True)
    expected = (10 * sent[:, None] + np.arange(10)).ravel()
    np.testing.assert_array_equal(track.values[:, 0], expected)
    np.testing.assert_array_equal(track.stamp, START + 100_000 * expected)
    assert track.repeated + track.backward == 0
    assert most <= 5000 + 10  # half a second


def test_blocks_that_are_too_late_are_cut():
    track = SignalTrack("/x")
    for piece in blocks([*range(100), *range(101, 700), 100]):
        track.add(piece)
        track.fold()
    track.fold(final=True)
    assert track.repeated + track.backward == 10
    assert len(track.stamp) == 6990


@pytest.mark.parametrize("back", [0.3e-4, 0.5e-3, 20e-3])
def test_a_clock_that_is_set_back_is_not_taken_for_disorder(back):
    track = SignalTrack("/x")
    for number, piece in enumerate(blocks(range(100))):
        track.add(replace(piece, stamp=piece.stamp - (number >= 50) * round(1e9 * back)))
        track.fold()
    track.fold(final=True)
    assert (np.diff(track.values[:, 0]) > 0).all()
    assert track.backward + track.repeated == int(back * 1e4 + 0.5)


def test_what_arrives_in_order_does_not_wait():
    track = SignalTrack("/x")
    for number, piece in enumerate(blocks(range(30)), 1):
        track.add(piece)
        track.fold()
        assert len(track.stamp) == 10 * number
