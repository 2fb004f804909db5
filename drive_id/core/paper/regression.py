"""The paper's regression ``eq:ls_regression``, accumulated as cross products per block of time.

Each pair of consecutive samples gives two rows by ``eq:single_row``, ``v = R q_1 + (Q_2 + Q_3) gamma + u_e q_4``. Only
Z'Z with Z = [q_1, q_4, v, Q_2 + Q_3] is kept, per block of time: recordings merge by addition, and leaving out one
block at a time gives the uncertainty.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.core.maps.flux_models import FluxModel
from drive_id.core.maps.inverter_curve import TanhShape
from drive_id.core.numerics.running_sums import SavedSums, TimeBlocks
from drive_id.core.paper.rows import FLUX, SampleIntegrals, add_rows, sample_integrals
from drive_id.types import BoolArray, FloatArray, Samples

CHUNK = 8192
"""Samples processed at a time, which bounds the memory for recordings of any length."""

_BLOCK_MEMORY = 2e8  # bytes, of all blocks
_MOST_BLOCKS = 128
_FIRST_DURATION = 0.1  # of a block, s


class RegressionSums:
    """Z'Z per block of time, in memory that does not grow with the recording.

    The duration of a block, s, is doubled by merging neighbours when there are more than ``max_blocks``: 128, or fewer
    where the model is large.

    Samples may arrive in portions of any size. A row needs two consecutive samples: a portion that continues another
    one begins with its last sample.
    """

    def __init__(self, model: FluxModel, shape: TanhShape) -> None:
        self.model = model
        self.shape = shape
        self.block_duration = _FIRST_DURATION
        self.rows = 0
        self.outside = 0
        self._size = FLUX + model.parameters
        affordable = int(_BLOCK_MEMORY / (8 * self._size**2)) // 2 * 2
        self.max_blocks = min(max(affordable, 8), _MOST_BLOCKS)
        self._blocks: list[FloatArray] = []
        self._starts: list[int] = []  # first block of each merged recording
        self._filled = np.inf  # time in the last block, s; infinite before a new recording

    @property
    def blocks(self) -> FloatArray:
        """Z'Z of each block, (blocks, 3 + P, 3 + P), symmetric."""
        return np.array(self._blocks).reshape(-1, self._size, self._size)

    @property
    def recordings(self) -> list[FloatArray]:
        """Z'Z of the blocks of each recording, (blocks, 3 + P, 3 + P); one of all where there are too many."""
        return np.split(self.blocks, self._starts[1:])

    @property
    def total(self) -> FloatArray:
        """Z'Z of all rows, (3 + P, 3 + P), symmetric."""
        total = np.zeros((self._size, self._size))
        for block in self._blocks:
            total += block
        return total

    def copy(self) -> RegressionSums:
        """Return an independent copy; complete blocks are shared."""
        other = copy.copy(self)
        growing = [block.copy() for block in self._blocks[-1:]]
        other._blocks = [*self._blocks[:-1], *growing]  # noqa: SLF001  # of its own class
        other._starts = [*self._starts]  # noqa: SLF001
        return other

    def next_recording(self) -> None:
        """Begin new blocks for another recording, as merging does."""
        self._filled = np.inf

    def merge(self, other: RegressionSums) -> None:
        """Add the sums over other recordings, see :class:`~drive_id.core.numerics.running_sums.Accumulator`."""
        self.rows += other.rows
        self.outside += other.outside
        self._take(self._time_blocks().joined(other.copy()._time_blocks(), self.max_blocks))  # noqa: SLF001
        self.next_recording()

    def state(self) -> SavedSums:
        """Return the state as arrays."""
        counts = {"rows": np.array(self.rows), "outside": np.array(self.outside), "filled": np.array(self._filled)}
        return self._time_blocks().state() | counts

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state, see :class:`~drive_id.core.numerics.running_sums.Accumulator`."""
        self._take(TimeBlocks.of_state(state, self._size).within(self.max_blocks))
        self.rows, self.outside, self._filled = int(state["rows"]), int(state["outside"]), float(state["filled"])

    def _time_blocks(self) -> TimeBlocks:
        return TimeBlocks(tuple(self._blocks), tuple(self._starts), self.block_duration)

    def _take(self, blocks: TimeBlocks) -> None:
        self._blocks, self._starts, self.block_duration = list(blocks.sums), list(blocks.starts), blocks.duration

    def add(
        self, samples: Samples, done: Callable[[int], None] | None = None, left_out: BoolArray | None = None
    ) -> None:
        """Accumulate the rows of further samples.

        Parameters
        ----------
        done : callable, optional
            Called with the number of samples done so far.
        left_out : (N,) bool, optional
            Samples to leave out.
        """
        for run in samples.runs():
            for chunk in _chunks(run):
                integrals = sample_integrals(samples, chunk, self.model, self.shape, left_out)
                self._accumulate(integrals, samples.sample_period)
                if done:
                    done(chunk.stop)

    def _accumulate(self, integrals: SampleIntegrals, period: float) -> None:
        self.rows += 2 * int(integrals.valid.sum())
        self.outside += int((~integrals.inside).sum())
        known = np.stack([integrals.q1, integrals.q4, integrals.v], axis=-1)
        for pairs in self._spans(len(integrals.v), period):
            own = slice(pairs.start, pairs.stop + 1)
            add_rows(
                known[pairs],
                integrals.half_turn[pairs],
                integrals.valid[pairs],
                integrals.rows.column[own],
                integrals.rows.value[own],
                self._blocks[-1],
            )

    def _spans(self, count: int, period: float) -> Iterator[slice]:
        """Divide ``count`` pairs of samples among the last block of time and further ones."""
        start = 0
        while start < count:
            if self._filled >= self.block_duration - period / 2:
                self._open_block()
            room = max(1, round((self.block_duration - self._filled) / period))
            stop = min(count, start + room)
            yield slice(start, stop)
            self._filled += (stop - start) * period
            start = stop

    def _open_block(self) -> None:
        if len(self._blocks) == self.max_blocks:
            own, before = len(self._blocks) - self._starts[-1], self.block_duration
            self._take(self._time_blocks().within(self.max_blocks - 1))
            rest = own % round(self.block_duration / before)
            if rest and np.isfinite(self._filled):  # the last block of this recording is not full at its new length
                self._filled = rest * before
                return
        if np.isinf(self._filled):
            self._starts.append(len(self._blocks))
        self._blocks.append(np.zeros((self._size, self._size)))
        self._filled = 0.0


def _chunks(run: slice) -> Iterator[slice]:
    for start in range(run.start, run.stop - 1, CHUNK):
        yield slice(start, min(start + CHUNK + 1, run.stop))
