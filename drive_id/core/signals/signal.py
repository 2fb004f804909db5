"""One recorded signal, before it is joined with others, and the running count of its blocks."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.types import BoolArray, FloatArray, IntArray

LARGEST_CUT = 0.01
"""Largest part of a signal's samples that may be cut out for repeated or backward stamps."""
_FEWEST_BLOCKS = 3
"""Blocks that begin with sample 0 before their publisher is said not to count."""
LATEST = 0.5
"""Time by which a block may arrive behind later ones and still be put in its place, s: networks delay some."""
_OPEN_LOSSES = 100
"""Losses that a late block may still fill."""
_OPEN_SAMPLES = 50_000
"""Samples since such a loss: beyond, a count that runs backwards is that of another publisher."""
_MOST_MISSING = 10**10
"""Samples from which on a count that runs ahead is another one, and none is lost: eleven days at 10 kHz."""
_LONGEST = 1e4
"""Period, s, from which on it says nothing of the stamps."""
_STRAY = 1_000_000
"""Deviation of stamps from an even grid, ns, besides half a block."""
_CLOCK = 0.1
"""Share of a loss, besides ``LATEST``, by which count and stamps may disagree on it: a clock is set meanwhile."""


@dataclass(frozen=True, eq=False)
class Signal:
    """One recorded signal, in order of arrival."""

    name: str  # its topic, for messages
    stamp: IntArray  # (N,), ns
    values: FloatArray  # (N, K), SI units
    sample_period: float | None = None
    """As declared by its messages or its owner, s. None: estimated from the stamps."""
    block_start: IntArray | None = None
    """Index of the first sample of each message (B,), beginning with 0. None: one sample per message. The stamps in
    between follow from the declared period and thus say nothing about the true one."""
    lost: int = 0  # samples missing by the messages' own count
    losses: int = 0  # places where they are


def block_stamps(first: int, count: int, period: float) -> IntArray:
    """Return the stamps (N,), ns, of equally spaced samples, the first at ``first`` ns, ``period`` s apart."""
    return np.asarray(first + np.rint(np.arange(count) * (period * 1e9)).astype(np.int64))


def finite_rows(values: FloatArray) -> BoolArray:
    """Tell which rows of ``values`` (N, K) hold finite numbers only."""
    finite: BoolArray = np.all(np.isfinite(values), axis=1)
    return finite


@dataclass
class SampleCount:
    """Received and lost samples, by the running count in the blocks.

    A block that arrives late and fills a loss undoes it; one that arrives twice changes nothing. Where stamps are
    given, a count that runs backwards, or ahead by more than they do, is another one: nothing is lost there.
    """

    samples: int = 0  # received
    blocks: int = 0  # received
    lost: int = 0  # samples missing between blocks
    losses: int = 0  # places where they are
    restarts: int = 0  # places where another count begins: the publisher restarted, or there are two of them
    zeros: int = 0  # blocks that begin with sample 0
    due: int | None = None  # first sample of the next block; None before the first one
    _end: int | None = None  # time at which it is due, ns
    _open: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=_OPEN_LOSSES))

    def add(self, first_sample: int, samples: int, stamp: int | None = None, period: float = 0.0) -> bool:
        """Count one block of so many samples, the first of which is number ``first_sample``.

        Parameters
        ----------
        stamp : int, optional
            Of the first sample, ns.
        period : float
            Of the samples, s; 0 if it is unknown.

        Returns
        -------
        bool
            Whether another count begins with this block.
        """
        stamp = stamp if 0.0 < period < _LONGEST else None
        end = first_sample + samples
        ahead = 0 if self.due is None else first_sample - self.due
        another = ahead != 0 and self._is_another(ahead, samples, stamp, period)
        if ahead > 0 and not another:
            self._lose(first_sample - ahead, first_sample)
        elif ahead < 0 and not another:
            self._fill(first_sample, end)
        if self.due is None or end > self.due or another or self._is_uncounted(first_sample):
            self.due, self._end = end, None
            if stamp is not None:
                self._end = stamp + round(samples * period * 1e9)
        self.restarts += another
        self.samples += samples
        self.blocks += 1
        self.zeros += first_sample == 0
        return another

    def add_blocks(
        self, first_sample: NDArray[Any], samples: IntArray, stamp: IntArray | None = None, period: float = 0.0
    ) -> None:
        """Count blocks (B,), see :meth:`add`."""
        starts = np.append(0, np.flatnonzero(first_sample[1:] != (first_sample + samples)[:-1]) + 1)
        ends = np.append(starts[1:], len(samples)) - 1
        for start, last, whole in zip(starts, ends, np.add.reduceat(samples, starts), strict=True):  # out of turn
            self.add(int(first_sample[start]), int(whole), None if stamp is None else int(stamp[start]), period)
            if stamp is not None and self._end is not None:
                self._end = int(stamp[last]) + round(int(samples[last]) * period * 1e9)
            self.blocks += int(last - start)
            self.zeros += int((first_sample[start + 1 : last + 1] == 0).sum())

    def interrupt(self) -> None:
        """Have the next block begin anew: what is missing before it is not lost."""
        self.due = self._end = None
        self._open.clear()

    def _is_another(self, ahead: int, samples: int, stamp: int | None, period: float) -> bool:
        """Tell whether a block that is so many samples out of turn, behind if negative, is of another count."""
        first = (self.due or 0) + ahead
        if self._is_uncounted(first) or ahead > _MOST_MISSING:
            return ahead > _MOST_MISSING
        known = stamp is not None and self._end is not None
        apart = abs(((stamp or 0) - (self._end or 0)) * 1e-9 - ahead * period)  # s, by which count and stamps disagree
        if ahead > 0:
            return known and apart > LATEST + _CLOCK * ahead * period
        if any(gap[0] <= first and first + samples <= gap[1] for gap in self._open) and -ahead <= _OPEN_SAMPLES:
            return known and apart > LATEST
        return not known or -ahead * period > 2 * LATEST or apart > 0.5 * samples * period + _STRAY * 1e-9

    def _is_uncounted(self, first_sample: int) -> bool:
        return first_sample == 0 and self.zeros == self.blocks

    def _lose(self, begin: int, end: int) -> None:
        self.lost += end - begin
        self.losses += 1
        self._open.append((begin, end))

    def _fill(self, begin: int, end: int) -> bool:
        """Take a late block out of the losses, and tell whether it is in one of them."""
        for gap in self._open:
            if gap[0] <= begin and end <= gap[1] and (self.due or 0) - begin <= _OPEN_SAMPLES:
                self._open.remove(gap)
                self.lost -= gap[1] - gap[0]
                self.losses -= 1
                for rest in ((gap[0], begin), (end, gap[1])):
                    if rest[0] < rest[1]:
                        self._lose(*rest)
                return True
        return False

    @property
    def counts_nothing(self) -> bool:
        """Whether ``first_sample`` is always 0, so that losses do not show."""
        return self.zeros == self.blocks >= _FEWEST_BLOCKS and self.samples > 0
