"""Several recordings of one drive, put one behind the other: piece by piece."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from drive_id.core.signals.join import Piece
from drive_id.core.signals.period import PERIOD_TOLERANCE, period_text
from drive_id.errors import DataError, SamplePeriodError
from drive_id.types import GroundTruth

_DISTANCE = 1_000_000_000
"""Put between recordings that overlap, ns."""
_SINCE_ITS_BEGINNING = 86_400_000_000_000
"""Stamp, ns, up to which a time may count from the beginning of its own recording, as that of each CSV file does."""
_TOLD_BY = 64  # samples that are the same only in the same recording


class SeveralRecordings:
    """Puts recordings one behind the other, piece by piece; one that overlaps those before is moved behind them.

    Attributes
    ----------
    end : int or None
        Stamp of the last sample so far, ns.
    moved : list of int
        Numbers of the recordings that were moved and begin like one before, or have a common clock.
    """

    def __init__(self) -> None:
        self.end: int | None = None
        self.moved: list[int] = []
        self._period: float | None = None
        self._number = -1
        self._shift: int | None = None
        self._beginnings: set[bytes] = set()

    def begin(self) -> None:
        """Begin a further recording."""
        self._number += 1
        self._shift = None

    def placed(self, piece: Piece) -> Piece:
        """Return the next piece of the recording, moved behind those before if it overlaps them.

        Raises SamplePeriodError when the periods of two recordings differ by more than 1 %.
        """
        samples = piece.samples
        if self._period is None:
            self._period = samples.sample_period
        if abs(samples.sample_period / self._period - 1.0) > PERIOD_TOLERANCE:
            raise SamplePeriodError(
                f"The sample periods of the recordings disagree, {period_text(self._period)} in the first and "
                f"{period_text(samples.sample_period)} in number {self._number + 1}: fit them separately."
            )
        if self._shift is None:
            self._shift = 0
            beginning = samples.i_abc[:_TOLD_BY].tobytes()
            if self.end is not None and int(samples.stamp[0]) <= self.end + 2e9 * self._period:
                self._shift = self.end + _DISTANCE - int(samples.stamp[0])
                if beginning in self._beginnings or int(samples.stamp[0]) > _SINCE_ITS_BEGINNING:
                    self.moved.append(self._number)
            self._beginnings.add(beginning)
        if self._shift or samples.sample_period != self._period:
            samples = replace(samples, stamp=samples.stamp + self._shift, sample_period=self._period)
            piece = replace(piece, samples=samples)
        self.end = int(samples.stamp[-1])
        return piece


def common_truth(truths: Sequence[GroundTruth | None], sources: Sequence[object] = ()) -> GroundTruth | None:
    """Return the truth that all recordings, of these names, carry; None where one has none.

    Raises DataError when they are simulations of different machines, whose fit together means nothing.
    """
    known = [truth for truth in truths if truth is not None]
    names = [f" in {source}" for source in sources] or [""] * len(truths)
    machines = {truth.machine: name for truth, name in zip(truths, names, strict=True) if truth is not None}
    if len(machines) > 1:
        named = ", ".join(f"{machine}{name}" for machine, name in sorted(machines.items()))
        raise DataError(f"The recordings are simulations of different machines ({named}): fit each by itself.")
    return known[0] if known and len(known) == len(truths) else None
