"""Protocol of all running sums: save, restore, merge; and cross products per block of time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from drive_id.types import FloatArray

SavedSums = dict[str, NDArray[Any]]
"""SavedSums of an accumulator, by name: plain arrays, scalars as arrays without axes."""

Self = TypeVar("Self", bound="Accumulator")


class Accumulator(Protocol):
    """Sums over samples, of a size independent of their number."""

    def state(self) -> SavedSums:
        """Return the state as arrays; names contain no slash."""

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore the state of an accumulator constructed with the same arguments.

        Raises KeyError, ValueError, TypeError when the state belongs to another kind of accumulator.
        """

    def merge(self: Self, other: Self) -> None:
        """Add the sums of ``other``, constructed with the same arguments, over other recordings; it stays unchanged."""


def prefixed(name: str, state: Mapping[str, NDArray[Any]]) -> SavedSums:
    """Return a state with all names prefixed by ``name/``."""
    return {f"{name}/{key}": value for key, value in state.items()}


def below(name: str, state: Mapping[str, NDArray[Any]]) -> SavedSums:
    """Return the entries of a state under ``name/``, without the prefix; see :func:`prefixed`."""
    return {key.removeprefix(f"{name}/"): value for key, value in state.items() if key.startswith(f"{name}/")}


def exactly(value: NDArray[Any], like: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of an array after checking that shape and type are those of ``like``.

    Raises ValueError when they differ.
    """
    if value.shape != like.shape or value.dtype != like.dtype:
        raise ValueError(f"{value.dtype}{value.shape} where {like.dtype}{like.shape} is needed")
    return np.array(value)


@dataclass(frozen=True, eq=False)
class TimeBlocks:
    """Cross products per block of equal time, of one recording after the other.

    Neighbours are added only within a recording, so the blocks of a recording depend on the total number of blocks but
    not on the order in which recordings were merged. Recordings share blocks only when there are more recordings than
    blocks.
    """

    sums: tuple[FloatArray, ...]  # (S, S) each, symmetric, one per block
    starts: tuple[int, ...]  # first block of each recording
    duration: float  # of a block, s; the last one of a recording may be shorter

    def halved(self) -> TimeBlocks:
        """Return blocks of twice the time: neighbours within a recording added, an odd last one kept."""
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
        """Return the blocks of both, with equal durations, at most ``most`` of them."""
        first, second = self, other
        while 1.5 * first.duration < second.duration:
            first = first.halved()
        while 1.5 * second.duration < first.duration:
            second = second.halved()
        starts = (*first.starts, *(len(first.sums) + start for start in second.starts))
        return TimeBlocks((*first.sums, *second.sums), starts, first.duration).within(most)

    def state(self) -> SavedSums:
        """Return the blocks as arrays, each matrix as its lower triangle, (blocks, triangle)."""
        triangle = np.tril_indices(len(self.sums[0]) if self.sums else 0)
        return {
            "blocks": np.array([block[triangle] for block in self.sums]),
            "starts": np.array(self.starts, np.int64),
            "duration": np.array(self.duration),
        }

    @classmethod
    def of_state(cls, state: Mapping[str, NDArray[Any]], size: int) -> TimeBlocks:
        """Return the blocks of a state, with matrices of the given size.

        Raises KeyError, ValueError, TypeError when the state is not one of such blocks.
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
