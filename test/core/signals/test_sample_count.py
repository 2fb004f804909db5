"""What the running count of the blocks says of lost samples and of publishers that start again."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.signals.signal import SampleCount


def counted(*blocks):
    count = SampleCount()
    for first in blocks:
        if first is None:
            count.interrupt()
        else:
            count.add(first, 10)
    return count


def test_blocks_in_a_row_lose_nothing():
    count = counted(0, 10, 20)
    assert (count.samples, count.blocks, count.lost, count.losses, count.restarts, count.zeros) == (30, 3, 0, 0, 0, 1)


def test_losses_are_samples_and_places():
    count = counted(70, 100, 110, 125)
    assert (count.lost, count.losses, count.restarts, count.zeros) == (25, 2, 0, 0)


def test_a_count_that_runs_backwards_is_a_restart():
    count = counted(500, 510, 0, 10, 40, 10)
    assert (count.lost, count.losses, count.restarts, count.zeros) == (20, 1, 2, 1)


def test_nothing_is_lost_by_an_interruption():
    count = counted(0, 10, None, 900, 910, None, 0)
    assert (count.samples, count.lost, count.losses, count.restarts, count.zeros) == (50, 0, 0, 0, 2)


@pytest.mark.parametrize("seed", range(20))
def test_blocks_out_of_order_are_late_and_not_lost(seed):
    rng = np.random.default_rng(seed)
    whole = np.arange(300)
    sent = whole[rng.random(300) > 0.1]  # some never arrive
    arrived = sent[np.argsort(sent + rng.uniform(0, 8, len(sent)))]
    first = min(arrived[0], sent[0])
    arrived = arrived[np.argsort(arrived != first, kind="stable")]  # whoever listens late has lost nothing
    expected = 10 * (int(sent.max()) + 1 - int(first) - len(sent))
    gaps = int(np.sum(np.diff(np.sort(sent)) > 1))
    one_by_one, in_parts = counted(*(10 * arrived).tolist()), SampleCount()
    for part in np.array_split(10 * arrived, 7):
        in_parts.add_blocks(part, np.full(len(part), 10))
    for count in (one_by_one, in_parts):
        assert (count.lost, count.losses, count.restarts) == (expected, gaps, 0)
        assert (count.samples, count.blocks) == (10 * len(sent), len(sent))


def test_a_publisher_that_starts_again_fills_no_loss_of_long_ago():
    count = counted(0, 40, 200_000, 10)
    assert (count.losses, count.restarts) == (2, 1)
