"""Parts of a recording of any length, evenly spread over it, in bounded memory: to simulate and to draw."""

from __future__ import annotations

import numpy as np

from drive_id.core.live_evidence import concatenate
from drive_id.core.stream_join import Piece
from drive_id.types import Samples

SPAN = 1 << 14
"""Samples of one part."""
SPANS = 8
"""Most parts: a recording of up to ``SPAN x SPANS`` samples is kept whole."""


class Spans:
    """Keeps every sample of a short recording, and every second, fourth, ... part of a longer one.

    Parameters
    ----------
    span : int
        Samples of a part.
    most : int
        Parts to keep; even.
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

    def add(self, piece: Piece) -> None:
        """Take further samples."""
        start = int(piece.continues)
        while start < len(piece.samples):
            number, filled = divmod(self._count, self._span)
            stop = min(start + self._span - filled, len(piece.samples))
            if number % self._stride == 0:
                within = start > 0 and start not in piece.samples.run_starts
                joined = within and (number - 1 in self._parts or filled > 0)
                self._keep(number, Piece(_cut(piece.samples, start - joined, stop), joined))
            self._count += stop - start
            start = stop

    def samples(self) -> tuple[Samples, ...]:
        """Return what was kept, parts without a gap between them put together."""
        found = concatenate([piece for number in sorted(self._parts) for piece in self._parts[number]])
        return () if found is None else (found,)

    def _keep(self, number: int, piece: Piece) -> None:
        self._parts.setdefault(number, []).append(piece)
        if len(self._parts) > self._most:
            self._stride *= 2
            self._parts = {
                number: [Piece(part[0].samples, False), *part[1:]]
                for number, part in self._parts.items()
                if number % self._stride == 0
            }


def _cut(samples: Samples, start: int, stop: int) -> Samples:
    """Return a copy of some of the samples."""
    starts = samples.run_starts[(samples.run_starts > start) & (samples.run_starts < stop)] - start
    part = slice(start, stop)
    reference = samples.i_dq_reference
    return Samples(
        stamp=samples.stamp[part].copy(),
        i_abc=samples.i_abc[part].copy(),
        u_abc=samples.u_abc[part].copy(),
        angle=samples.angle[part].copy(),
        speed=samples.speed[part].copy(),
        sample_period=samples.sample_period,
        run_starts=np.append(0, starts).astype(np.int64),
        i_dq_reference=None if reference is None else reference[part].copy(),
    )
