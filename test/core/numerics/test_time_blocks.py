"""Blocks of time of several recordings: what they add up to, whatever the order in which they come together."""

from __future__ import annotations

from functools import reduce
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_id.core.numerics.running_sums import TimeBlocks


def recording(number: int, count: int, duration: float = 0.1) -> TimeBlocks:
    """Blocks that hold powers of two, so that each sum tells of what it is."""
    sums = tuple(np.full((2, 2), float(2 ** (10 * number + k))) for k in range(count))
    return TimeBlocks(sums, (0,), duration)


def content(blocks: TimeBlocks) -> list[float]:
    return sorted(float(block[0, 0]) for block in blocks.sums)


def test_neighbours_are_added_and_an_odd_last_block_is_kept():
    halved = recording(0, 5).halved()
    assert [block[0, 0] for block in halved.sums] == [3.0, 12.0, 16.0]
    assert (halved.starts, halved.duration) == ((0,), 0.2)


def test_blocks_never_reach_from_one_recording_into_another():
    both = recording(0, 3).joined(recording(1, 3), 4)
    assert content(both) == [3.0, 4.0, 1024.0 + 2048.0, 4096.0]
    assert both.starts == (0, 2)


def test_nothing_stays_nothing():
    empty = TimeBlocks((), (), 0.1)
    assert empty.joined(recording(0, 2, 0.4), 4).starts == recording(0, 2, 0.4).joined(empty, 4).starts == (0,)


def test_the_longer_blocks_decide():
    both = recording(0, 4, 0.1).joined(recording(1, 2, 0.4), 16)
    assert content(both) == [15.0, 1024.0, 2048.0]
    assert both.duration == 0.4
    assert content(recording(1, 2, 0.4).joined(recording(0, 4, 0.1), 16)) == content(both)


@given(counts=st.lists(st.integers(1, 9), min_size=1, max_size=4), most=st.integers(4, 12))
def test_the_order_of_merging_does_not_matter(counts, most):
    parts = [recording(number, count) for number, count in enumerate(counts)]
    results = [reduce(lambda a, b: a.joined(b, most), order).within(most) for order in permutations(parts)]
    for result in results:
        assert content(result) == content(results[0])
        assert len(result.sums) <= most
        assert result.duration == results[0].duration
    if len(parts) > 2:
        other = parts[0].joined(reduce(lambda a, b: a.joined(b, most), parts[1:]), most)
        assert content(other) == content(results[0])


def test_more_recordings_than_blocks_share_them():
    many = reduce(lambda a, b: a.joined(b, 4), [recording(number, 1) for number in range(5)])
    assert len(many.sums) <= 4
    assert sum(content(many)) == sum(1024.0**number for number in range(5))


def test_a_state_restores_the_blocks():
    rng = np.random.default_rng(0)
    sums = [block + block.T for block in rng.normal(size=(3, 4, 4))]
    blocks = TimeBlocks(tuple(sums), (0, 2), 0.2)
    again = TimeBlocks.of_state(blocks.state(), 4)
    np.testing.assert_array_equal(again.sums, blocks.sums)
    assert (again.starts, again.duration) == (blocks.starts, blocks.duration)
    empty = TimeBlocks.of_state(TimeBlocks((), (), 0.1).state(), 4)
    assert (empty.sums, empty.starts) == ((), ())


@pytest.mark.parametrize(
    "change",
    [
        {"starts": np.array([1, 2])},
        {"starts": np.array([0, 3])},
        {"starts": np.array([0, 2, 2])},
        {"starts": np.array([], np.int64)},
        {"duration": np.array(0.0)},
        {"duration": np.array(np.nan)},
        {"blocks": np.zeros((3, 9))},
        {"blocks": np.zeros((3, 10), np.int64)},
        {"blocks": np.array("text")},
    ],
    ids=str,
)
def test_a_state_of_something_else_is_refused(change):
    state = TimeBlocks((np.eye(4),) * 3, (0, 2), 0.2).state()
    with pytest.raises((ValueError, TypeError)):
        TimeBlocks.of_state(state | change, 4)
