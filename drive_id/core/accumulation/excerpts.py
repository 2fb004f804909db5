"""Excerpts of a recording of any length, evenly spread over it, in bounded memory: for the MAD and for pictures."""

from __future__ import annotations

import copy

from drive_id.core.signals.join import Piece, joined
from drive_id.types import Samples

SPAN = 1 << 14
"""Samples of one span."""
SPANS = 8
"""Largest number of spans: a recording of up to ``SPAN x SPANS`` samples is kept whole."""


class Spans:
    """Keeps every sample of a short recording, and every second, fourth, ... span of a longer one.

    Parameters
    ----------
    span : int
        Samples of a span.
    most : int
        Spans to keep; even.
    """

    def __init__(self, span: int = SPAN, most: int = SPANS) -> None:
        self._span = span
        self._most = most
        self._stride = 1
        self._count = 0
        self._parts: dict[int, list[Piece]] = {}

    @property
    def whole(self) -> bool:
        """Whether nothing was left out so far."""
        return self._stride == 1

    def copy(self) -> Spans:
        """Return an independent copy; the samples are shared."""
        other = copy.copy(self)
        other._parts = {number: list(part) for number, part in self._parts.items()}  # noqa: SLF001  # of its own class
        return other

    def add(self, piece: Piece) -> None:
        """Take further samples."""
        start = int(piece.continues)
        while start < len(piece.samples):
            number, filled = divmod(self._count, self._span)
            stop = min(start + self._span - filled, len(piece.samples))
            if number % self._stride == 0:
                within = start > 0 and start not in piece.samples.run_starts
                goes_on = within and (number - 1 in self._parts or filled > 0)
                self._keep(number, Piece(piece.samples.part(start - goes_on, stop, copy=True), goes_on))
            self._count += stop - start
            start = stop

    def samples(self) -> tuple[Samples, ...]:
        """Return the excerpts as one recording; spans without a gap between them are joined."""
        pieces = [piece for number in sorted(self._parts) for piece in self._parts[number]]
        return (joined(pieces),) if pieces else ()

    def runs(self) -> list[Samples]:
        """Return the gap-free runs of the excerpts, of one span at most each."""
        found: list[list[Piece]] = []
        for number in sorted(self._parts):
            for at, piece in enumerate(self._parts[number]):
                if at and piece.continues:
                    found[-1].append(piece)
                else:
                    found.append([piece])
        return [part.part(run.start, run.stop) for part in map(joined, found) for run in part.runs()]

    def _keep(self, number: int, piece: Piece) -> None:
        self._parts.setdefault(number, []).append(piece)
        if len(self._parts) > self._most:
            self._stride *= 2
            self._parts = {
                number: [Piece(part[0].samples, False), *part[1:]]
                for number, part in self._parts.items()
                if number % self._stride == 0
            }


def shortened(samples: Samples) -> Samples:
    """Return a recording as it is, or what is kept of a long one."""
    if len(samples) <= SPAN * SPANS:
        return samples
    spans = Spans()
    spans.add(Piece(samples, continues=False))
    return spans.samples()[0]
