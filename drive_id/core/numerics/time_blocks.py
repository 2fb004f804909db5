"""Sums per block of time, of one or several recordings: what the uncertainty of an estimate is told by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.core.numerics.running_sums import State, exactly
from drive_id.types import FloatArray


@dataclass(frozen=True, eq=False)
class TimeBlocks:
    """Blocks of equal time, those of one recording behind those of the other.

    Parameters
    ----------
    sums : tuple of (S, S) float
        One symmetric matrix per block.
    starts : tuple of int
        First block of each recording.
    duration : float
        Of a block, s; the last one of a recording may be shorter.

    Notes
    -----
    Neighbours are added only within a recording. So the blocks that a recording ends up with depend on how many there
    are in all, but not on the order in which recordings came together. Only where there are more recordings than
    blocks are allowed, neighbouring recordings share one.
    """

    sums: tuple[FloatArray, ...]
    starts: tuple[int, ...]
    duration: float

    def halved(self) -> TimeBlocks:
        """Return blocks of twice the time: neighbours of one recording added, an odd last one kept."""
        sums: list[FloatArray] = []
        starts = []
        for start, end in zip(self.starts, (*self.starts, len(self.sums))[1:], strict=True):
            starts.append(len(sums))
            own = self.sums[start:end]
            sums += [a + b for a, b in zip(own[::2], own[1::2], strict=False)]
            sums += own[len(own) // 2 * 2 :]
        return TimeBlocks(tuple(sums), tuple(starts), 2 * self.duration)

    def within(self, most: int) -> TimeBlocks:
        """Return at most ``most`` blocks (1 or more), halved as often as needed."""
        blocks = self if len(self.starts) <= most else TimeBlocks(self.sums, (0,), self.duration)
        while len(blocks.sums) > most:
            blocks = blocks.halved()
        return blocks

    def joined(self, other: TimeBlocks, most: int) -> TimeBlocks:
        """Return these and the other recordings' blocks, of equal duration, at most ``most`` of them."""
        first, second = self, other
        while 1.5 * first.duration < second.duration:
            first = first.halved()
        while 1.5 * second.duration < first.duration:
            second = second.halved()
        starts = (*first.starts, *(len(first.sums) + start for start in second.starts))
        return TimeBlocks((*first.sums, *second.sums), starts, first.duration).within(most)

    def state(self) -> State:
        """Return the blocks as arrays, of each matrix only the lower triangle, (blocks, triangle)."""
        triangle = np.tril_indices(len(self.sums[0]) if self.sums else 0)
        return {
            "blocks": np.array([block[triangle] for block in self.sums]),
            "starts": np.array(self.starts, np.int64),
            "duration": np.array(self.duration),
        }

    @classmethod
    def of_state(cls, state: Mapping[str, NDArray[Any]], size: int) -> TimeBlocks:
        """Return the blocks of a state, matrices of the given size.

        Raises
        ------
        KeyError, ValueError, TypeError
            When the state is of something else.
        """
        starts, duration = [int(start) for start in state["starts"]], float(state["duration"])
        if not len(state["blocks"]) and not starts:
            return cls((), (), duration)
        rows, columns = np.tril_indices(size)
        packed = exactly(state["blocks"], np.empty((len(state["blocks"]), len(rows))))
        ends = [*starts[1:], len(packed)]
        if starts[:1] != [0] or any(end <= start for start, end in zip(starts, ends, strict=True)) or not duration > 0:
            raise ValueError("recordings without blocks, or blocks without time")
        blocks = np.zeros((len(packed), size, size))
        blocks[:, rows, columns] = blocks[:, columns, rows] = packed
        return cls(tuple(blocks), tuple(starts), duration)
