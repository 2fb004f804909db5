"""What the running count of the blocks says of lost samples and of publishers that start again."""

from __future__ import annotations

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
    count = counted(500, 510, 0, 10, 40, 30)
    assert (count.lost, count.losses, count.restarts, count.zeros) == (20, 1, 2, 1)


def test_nothing_is_lost_by_an_interruption():
    count = counted(0, 10, None, 900, 910, None, 0)
    assert (count.samples, count.lost, count.losses, count.restarts, count.zeros) == (50, 0, 0, 0, 2)
