"""The sample period of signals, as declared and as measured from their stamps."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from drive_id.core.signals.signal import Signal
from drive_id.errors import SamplePeriodError
from drive_id.types import IntArray

PERIOD_TOLERANCE = 0.01
"""Largest relative difference between sample periods that count as equal."""


def measured_period(signal: Signal) -> float | None:
    """Estimate the true sample period of a signal, s, from the stamps of its messages; None with fewer than three.

    It is the mean over all neighbouring messages between which nothing is missing.
    """
    starts = np.arange(len(signal.stamp)) if signal.block_start is None else signal.block_start
    return usual_period(np.diff(signal.stamp[starts]), np.diff(starts))


def usual_period(elapsed: IntArray, count: IntArray) -> float | None:
    """Estimate the sample period, s, from the times (B,), ns, and samples (B,) between neighbouring messages.

    None with fewer than two times that are positive.
    """
    forward = elapsed > 0
    elapsed, count = elapsed[forward], count[forward]
    if len(elapsed) < 2:
        return None
    middle = np.median(elapsed / count)
    usual = np.abs(elapsed - count * middle) < 0.5 * middle
    if not usual.any():
        return float(middle) * 1e-9
    return float(elapsed[usual].sum() / count[usual].sum()) * 1e-9


class Spacings:
    """Measures the sample period of a recording of any length from the times between neighbouring messages.

    The first ones are kept; of later ones, the sum of those within half a period of the median of the first.
    """

    def __init__(self, kept: int = 1 << 16) -> None:
        self._most = kept
        self._kept: list[IntArray] = []
        self._count = 0
        self._middle = 0.0
        self._sum: IntArray = np.zeros(2, np.int64)
        self._last: tuple[int, int] | None = None

    def copy(self) -> Spacings:
        """Return an independent copy."""
        other = copy.copy(self)
        other._kept = list(self._kept)  # noqa: SLF001  # of its own class
        return other

    def add(self, stamp: IntArray, count: IntArray) -> None:
        """Take further messages: stamps (B,), ns, and numbers (B,) of samples."""
        if not len(stamp):
            return
        if self._last is not None:
            stamp, count = np.append(self._last[0], stamp), np.append(self._last[1], count)
        self._last = int(stamp[-1]), int(count[-1])
        pairs = np.stack([np.diff(stamp), count[:-1]])
        room = max(self._most - self._count, 0)
        if room:
            self._kept.append(pairs[:, :room])
            self._count += min(pairs.shape[1], room)
        later = pairs[:, room:]
        if later.shape[1]:
            if not self._middle:
                elapsed, number = self._first()
                self._middle = float(np.median((elapsed / number)[elapsed > 0]))
            self._sum = self._sum + self._usual(later)

    def period(self) -> float | None:
        """Return the sample period, s; see :func:`usual_period`."""
        if not self._kept:
            return None
        if not self._sum[1]:
            return usual_period(*self._first())
        elapsed, count = self._usual(self._first()) + self._sum
        return float(elapsed / count) * 1e-9

    def _first(self) -> IntArray:
        self._kept = [np.concatenate(self._kept, axis=1)]
        return self._kept[0]

    def _usual(self, pairs: IntArray) -> IntArray:
        """Return the sums (2,) of times, ns, and samples, over the pairs (2, B) within half a period of the median."""
        elapsed, number = pairs
        usual = (elapsed > 0) & (np.abs(elapsed - number * self._middle) < 0.5 * self._middle)
        return np.asarray(pairs[:, usual].sum(axis=1))


def period_text(period: float) -> str:
    """Write a sample period for a reader: ``100 us``."""
    return f"{period * 1e6:.6g} us"


def check_agreement(claims: Sequence[tuple[str, float]]) -> None:
    """Refuse sample periods that differ by more than the tolerance."""
    for other, value in claims[1:]:
        said, period = claims[0]
        if abs(value / period - 1.0) > PERIOD_TOLERANCE:
            raise SamplePeriodError(
                f"The sample periods disagree, {said} {period_text(period)} but {other} {period_text(value)}"
                f"{_wrong_unit(period, value)}: record all signals at one rate, or correct sample_period or the stamp "
                "source in a signals file."
            )


def _wrong_unit(period: float, value: float) -> str:
    """Say in a clause which wrong unit would explain two sample periods, s; empty if none does."""
    for one, other in ((period, value), (value, period)):
        for factor, unit in ((1e-3, "kHz"), (1.0, "Hz")):
            if abs(one * other / factor - 1.0) < PERIOD_TOLERANCE:
                return f", as if {max(one, other):.4g} were in {unit}"
        for factor, unit in ((1e3, "ms"), (1e6, "us"), (1e9, "ns")):
            if abs(one / other / factor - 1.0) < PERIOD_TOLERANCE:
                return f", as if one were in {unit}"
    return ""
