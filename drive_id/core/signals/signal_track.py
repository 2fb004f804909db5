"""One signal as it arrives: sorted out, counted, and buffered until its samples have found their partners."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Iterator

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.quantity import counted
from drive_id.core.numerics.scans import all_finite, rising
from drive_id.core.signals.period import Spacings, usual_period
from drive_id.core.signals.signal import LARGEST_CUT, LATEST, Signal, finite_rows
from drive_id.errors import DataError, EmptyTopicError, NonFiniteError, SamplePeriodError, StampOrderError
from drive_id.types import FloatArray, IntArray

_SAME_PERIOD = 1e-6  # relative change of a declared period that is rounding
_SPACINGS = 1000  # times between the latest messages of a live signal, for its measured period
_LARGE_OFFSET = 0.25
"""Of stamps from those of the currents, in sample periods, that is reported."""
MOST_HELD = 20_000
"""Samples behind a gap that may wait for late ones, whatever the sample rate."""
_NONE: tuple[IntArray, FloatArray] = (np.zeros(0, np.int64), np.zeros((0, 0)))


class SignalTrack:
    """One signal: its statistics, and the samples that still wait for partners.

    Parameters
    ----------
    name : str
        Topic, for messages.
    recorded : bool
        It is read from a recording: all of its messages count for the measured period, not only the latest, and it
        need not declare one.
    held : int
        Most samples behind a gap that wait for late ones, for :data:`~drive_id.core.signals.signal.LATEST`; 0: none is
        put in its place. Late are samples that fit into a gap, so that those of a clock set back are not.

    Attributes
    ----------
    stamp : (N,) int64
        Waiting samples after :meth:`fold`, strictly increasing, ns.
    values : (N, K) float
    period : float or None
        As declared, s.
    read, fresh : int
        Samples that arrived, and those of them since the last :meth:`fold`.
    repeated, backward : int
        Samples cut out because their stamp repeats, or lies before, one seen earlier.
    not_finite : int
        Samples dropped because they are NaN or infinite.
    lost, losses : int
        Samples missing by the messages' own count, and the number of places where they are.
    given_up : int
        Samples dropped because their partners kept them waiting.
    fault : DataError or None
        Why the signal cannot be used any more.
    """

    def __init__(self, name: str, *, recorded: bool = False, held: int = MOST_HELD) -> None:
        self.name = name
        self._most_held = held
        self._held = _NONE  # behind a gap, in order
        self.stamp: IntArray = np.zeros(0, np.int64)
        self.values: FloatArray = np.zeros((0, 0))
        self.period: float | None = None
        self.read = self.fresh = self.repeated = self.backward = self.lost = self.losses = self.given_up = 0
        self.not_finite = 0
        self.fault: DataError | None = None
        self._raw: list[Signal] = []
        self._first_not_finite = 0  # ns after the start
        self._first_cut = (0, 0)  # ns by which it lies behind, ns after the start
        self._start: int | None = None
        self._previous = 0  # stamp of the last sample, ns
        self._latest = 0  # largest stamp that waits for no late ones, ns
        self._spacings: deque[tuple[int, int]] = deque(maxlen=_SPACINGS)
        self._whole = Spacings() if recorded else None
        self._last_message: tuple[int, int] | None = None

    @property
    def measured_period(self) -> float | None:
        """Sample period by the stamps of the latest messages, or of all of a recording, s."""
        if self._whole is not None:
            return self._whole.period()
        elapsed, count = np.array(self._spacings, np.int64).reshape(-1, 2).T
        return usual_period(elapsed, count)

    @property
    def range(self) -> tuple[int, int]:
        """First and largest stamp, ns."""
        return self._start or 0, self._latest

    def copy(self) -> SignalTrack:
        """Return an independent copy."""
        other = copy.copy(self)
        other._raw, other._spacings = list(self._raw), self._spacings.copy()  # noqa: SLF001  # of its own class
        other._whole = self._whole and self._whole.copy()  # noqa: SLF001
        return other

    def add(self, piece: Signal) -> None:
        """Take what arrived; a signal with a fault is counted, but not kept."""
        count = len(piece.stamp)
        self.lost += piece.lost
        self.losses += piece.losses
        if not count:
            return
        self.read += count
        self._check_period(piece)
        self._space(piece)
        if self.fault is None:
            self._raw.append(piece)
            self.fresh += count

    def fold(self, *, final: bool = False) -> None:
        """Sort what arrived: drop samples that are not finite, put late ones in their places, and cut the others.

        Parameters
        ----------
        final : bool
            Nothing follows, so that nothing has to wait for late samples.
        """
        arrived = [self._held] if len(self._held[0]) and (self._raw or final) else []
        arrived += [(piece.stamp, piece.values) for piece in self._raw]
        if not arrived:
            return
        stamp, values = arrived[0]
        if len(arrived) > 1:
            stamp = np.concatenate([part for part, _ in arrived])
            values = np.concatenate([part for _, part in arrived])
        self._raw, self.fresh, self._held = [], 0, _NONE
        if self._start is None:
            self._start = int(stamp[0])
            self._latest = self._previous = self._start - 1
        if stamp[0] > self._latest and rising(stamp):
            self._previous = int(stamp[-1])
        else:
            kept = self._in_order(stamp)
            stamp, values = stamp[kept], values[kept]
        ready = len(stamp) if final else self._ready(stamp)
        if ready < len(stamp):
            self._held = stamp[ready:], values[ready:]
            stamp, values = stamp[:ready], values[:ready]
        self._latest = int(stamp[-1]) if len(stamp) else self._latest
        if not all_finite(values):
            finite = finite_rows(values)
            if not self.not_finite:
                self._first_not_finite = int(stamp[np.argmin(finite)]) - self._start
            self.not_finite += len(finite) - int(finite.sum())
            stamp, values = stamp[finite], values[finite]
        if len(self.stamp):
            stamp, values = np.concatenate([self.stamp, stamp]), np.concatenate([self.values, values])
        self.stamp, self.values = stamp, values

    def drop(self, count: int) -> None:
        """Forget the oldest samples."""
        self.stamp, self.values = self.stamp[count:], self.values[count:]

    def check(self) -> None:
        """Raise what is wrong with this signal.

        Raises EmptyTopicError, NonFiniteError, SamplePeriodError, StampOrderError.
        """
        if not self.read and self._whole is not None:
            raise EmptyTopicError(f"{self.name} holds no sample: record it, or name another topic.")
        if not self.read:
            raise EmptyTopicError(f"No sample of {self.name} has arrived: start the drive, or remap the topic.")
        if self.not_finite:
            raise NonFiniteError(
                f"{self.name} holds {counted(self.not_finite, 'sample')} of NaN or infinity, the first "
                f"{self._first_not_finite * 1e-9:.6f} s after its start: cut the recording there or repair it."
            )
        if self.fault is not None:
            raise self.fault
        cut = self.repeated + self.backward
        if cut > LARGEST_CUT * self.read:
            by, after = self._first_cut
            raise StampOrderError(
                f"{cut} of {counted(self.read, 'stamp')} of {self.name} repeat or run backwards, the first by "
                f"{by * 1e-9:.6f} s at {after * 1e-9:.6f} s: "
                "remove repeated rows, check the clock, or give stamp_unit or another stamp in a signals file."
            )

    def warnings(self, offset: float, period: float) -> Iterator[Message]:
        """Yield what is missing or cut out, and the offset of the stamps from those of the currents, s, if large."""
        if self.not_finite:
            yield Message("samples_not_finite", samples=self.not_finite, topic=self.name)
        if self.repeated or self.backward:
            yield Message("stamps_cut", repeated=self.repeated, backward=self.backward, topic=self.name)
        if self.lost:
            yield Message("samples_lost", samples=self.lost, places=self.losses, topic=self.name)
        if abs(offset) > _LARGE_OFFSET * period:
            yield Message("stamps_shifted", offset=offset, topic=self.name)

    def _in_order(self, stamp: IntArray) -> IntArray:
        """Return the indices, in order of time, of stamps (N,) to keep, and count the others."""
        seen = np.maximum.accumulate(np.concatenate(([self._latest], stamp)))
        before = np.concatenate(([self._previous], stamp[:-1]))
        behind = stamp <= seen[:-1]
        kept = np.flatnonzero(~behind)
        late = self._late(stamp, kept, np.flatnonzero(behind))
        if len(late):
            behind[late] = False
            kept = np.concatenate([kept, late])
            kept = kept[np.argsort(stamp[kept])]
        if behind.any():
            if not self.repeated + self.backward:
                k = int(np.argmax(behind))
                self._first_cut = int(seen[k]) - int(stamp[k]), int(before[k]) - (self._start or 0)
            repeated = int(np.sum(behind & ((stamp == seen[:-1]) | (stamp == before))))
            self.repeated += repeated
            self.backward += int(behind.sum()) - repeated
        self._previous = int(stamp[-1])
        return kept

    def _late(self, stamp: IntArray, kept: IntArray, behind: IntArray) -> IntArray:
        """Return which of the ``behind`` fit into gaps between the ``kept``, half a period from any other sample."""
        half = 0.5e9 * (self.period or 0.0)
        if not self._most_held or not half or not len(behind):
            return behind[:0]
        order = behind[np.argsort(stamp[behind], kind="stable")]
        late, others = stamp[order], np.concatenate(([self._latest], stamp[kept]))
        place = np.searchsorted(others, late)
        fits = (place > 0) & (place < len(others))
        place = np.clip(place, 1, len(others) - 1)
        fits &= (late - others[place - 1] >= half) & (others[place] - late >= half)
        found = order[fits]
        return found[np.diff(stamp[found], prepend=self._latest) >= half]

    def _ready(self, stamp: IntArray) -> int:
        """Return how many samples at increasing stamps (N,) are not behind a gap that late ones may yet fill."""
        if not (self._most_held and self.period and len(stamp)):
            return len(stamp)
        closed = int(stamp[-1]) - round(1e9 * LATEST)
        first = max(int(np.searchsorted(stamp, closed)), len(stamp) - self._most_held)
        before = stamp[first - 1 : -1] if first else np.append(self._latest, stamp[:-1])
        gap = stamp[first:] - before > 1.5e9 * self.period
        return first + int(np.argmax(gap)) if gap.any() else len(stamp)

    def _check_period(self, piece: Signal) -> None:
        if self.period is None:
            self.period = piece.sample_period
            if self.period is None and self._whole is None:
                self.fault = SamplePeriodError(f"{self.name} declares no sample period: correct its publisher.")
            elif self.period is not None and not 1e-9 <= self.period < 1e4:
                self.fault = SamplePeriodError(
                    f"{piece.name} declares a sample period of {self.period} s: correct its publisher or give the "
                    "period in a signals file."
                )
        elif not abs((piece.sample_period or 0.0) - self.period) <= _SAME_PERIOD * self.period and self.fault is None:
            self.fault = SamplePeriodError(
                f"The sample period of {self.name} changes from {self.period} to {piece.sample_period} s at stamp "
                f"{int(piece.stamp[0])} ns: reset the live samples after a change of rate."
            )

    def _space(self, piece: Signal) -> None:
        """Note the time from message to message."""
        starts = np.arange(len(piece.stamp)) if piece.block_start is None else piece.block_start
        if self._whole is not None:
            self._whole.add(piece.stamp[starts], np.diff(np.append(starts, len(piece.stamp))))
            return
        for start, end in zip(starts, np.append(starts[1:], len(piece.stamp)), strict=True):
            stamp = int(piece.stamp[start])
            if self._last_message is not None:
                self._spacings.append((stamp - self._last_message[0], self._last_message[1]))
            self._last_message = stamp, int(end - start)
