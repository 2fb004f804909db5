"""Another drive is told of at its first block, whatever late, lost and repeated blocks there are besides."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from drive_id.core.signals.drive_watch import DriveWatch
from drive_id.core.signals.signal import SampleCount

PERIOD, SIZE = 1e-4, 100
BLOCK = round(SIZE * PERIOD * 1e9)  # ns
START = 1_700_000_000_000_000_000
TOPICS = ("/currents", "/voltages", "/resolver")


class Drive:
    """A drive that began to count at a time, ns."""

    def __init__(self, begin, frame="drive"):
        self.begin, self.frame = begin, frame

    def block(self, number):
        """Return what a watch takes of the block with this number of those since START."""
        stamp = START + number * BLOCK
        return (round((stamp - self.begin) / BLOCK) * SIZE, SIZE, stamp, PERIOD, self.frame)


def told(blocks):
    """Return the positions at which a watch tells of a change, and what it says."""
    watch, found = DriveWatch(), {}
    for at, block in enumerate(blocks):
        for topic in TOPICS:
            if (reason := watch.block(topic, *block)) is not None:
                found[at] = reason
    return found


FIRST = Drive(START - 1000 * BLOCK)


@pytest.mark.parametrize(
    ("other", "code", "words"),
    [
        (Drive(START + 50 * BLOCK), "count", "went from 105000 to 0"),  # restarted
        (Drive(START - 9000 * BLOCK), "count", "went from 105000 to 905000"),  # has run for longer
        (Drive(FIRST.begin, "other"), "frame", "from 'drive' to 'other'"),
    ],
)
def test_another_drive_is_told_of_once(other, code, words):
    found = told([*(FIRST.block(n) for n in range(50)), *(other.block(n) for n in range(50, 90))])
    assert list(found) == [50]
    assert words in found[50]
    assert found[50].code == "another_drive"
    assert ("frame_id" in found[50]) == (code == "frame")


@pytest.mark.parametrize("step", [-3600, -2, 2, 3600])
def test_a_clock_that_is_set_is_no_other_drive(step):
    blocks = [FIRST.block(n) for n in range(60)]
    moved = [(first, size, stamp + step * 10**9, *rest) for first, size, stamp, *rest in blocks[30:]]
    assert not told([*blocks[:30], *moved])


def test_a_pause_of_the_network_is_no_other_drive():
    assert not told([FIRST.block(n) for n in (*range(20), *range(500, 520), *range(100_000, 100_020))])


def test_a_count_that_is_always_zero_tells_nothing():
    assert not told([(0, SIZE, START + n * BLOCK, PERIOD, "drive") for n in range(30)])


def test_absurd_counts_lose_nothing():
    count = SampleCount()
    for first, stamp in ((0, 0), (100, 1), (2**64 - 1, 2), (200, 3), (2**63, 4), (300, 5)):
        count.add(first, SIZE, START + stamp * BLOCK, PERIOD)
    assert (count.lost, count.losses) == (0, 0)
    assert count.restarts == 4
    assert count.due == 400


@pytest.mark.parametrize("seed", range(100))
def test_scripts_of_restart_exchange_duplicates_and_delay(seed):
    """Every change is told of within a block, and nothing else is, however the network treats the blocks."""
    rng = np.random.default_rng(seed)
    drives, changes, sent = [Drive(START - int(rng.integers(200, 5000)) * BLOCK)], [], []
    for number in range(600):
        if number - (changes or [-130])[-1] > 150 and rng.random() < 0.01:
            began = -int(rng.integers(9000, 20_000)) if rng.random() < 0.5 else number - int(rng.integers(0, 3))
            drives.append(Drive(START + began * BLOCK, "drive" if rng.random() < 0.7 else f"drive {number}"))
            changes.append(number)
        sent.append((number, len(drives) - 1))
    arrived = []
    for number, drive in sent:
        if rng.random() < 0.03 and number not in changes:
            continue  # lost
        delay = float(rng.uniform(0, 3)) if rng.random() < 0.1 else 0.0
        near = any(0 <= number - change < 5 or 0 < change - number <= 5 for change in changes)
        arrived.append((number + (0.0 if near else delay), number, drive))
        if rng.random() < 0.03 and not near:
            arrived.append((number + delay + float(rng.uniform(0, 5)), number, drive))  # twice
    order = [(number, drive) for _, number, drive in sorted(arrived)]
    expected = [k for k, (one, other) in enumerate(pairwise(order), 1) if other[1] > one[1]]
    found = told([drives[drive].block(number) for number, drive in order])
    assert list(found) == expected, (changes, found)


def test_two_drives_at_once_are_told_of_at_each_block():
    other = Drive(START - 77 * BLOCK)
    blocks = [(FIRST if n % 2 else other).block(n) for n in range(40)]
    assert len(told(blocks)) > 35


def test_publishers_are_known_by_their_identity():
    watch = DriveWatch()
    assert watch.publishers("/c", {}) is None
    assert watch.publishers("/c", {"1": "/drive"}) is None
    assert watch.publishers("/c", {}) is None  # discovery lost sight of it
    assert watch.publishers("/c", {"1": "/drive"}) is None
    second = watch.publishers("/c", {"1": "/drive", "2": "/other"})
    assert second == "/other publishes /c besides /drive: stop one of the two drives."
    assert watch.publishers("/c", {"1": "/drive", "2": "/other"}) is None
    assert "new publisher, /drive" in watch.publishers("/c", {"3": "/drive"})
