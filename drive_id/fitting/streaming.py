"""Accumulate bags for a fit, in memory that does not grow with their length.

A recording of up to :data:`WHOLE` samples is read once and kept between the prescan and accumulating. A longer one is
read twice, unless i_max is set: for the prescan, then to accumulate. Another thread reads, unpacks and joins meanwhile.
For the MAD and for pictures, a short recording is kept whole, and eight evenly spaced parts of a longer one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from drive_id.core.accumulation.accumulated import Accumulated
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import SPAN, SPANS, Spans
from drive_id.core.checks.prescan import Prescan
from drive_id.core.fit_settings import FitSettings
from drive_id.core.signals.join import Piece
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.extraction import UnusualError
from drive_id.files.read.several import SeveralBags, digests_of
from drive_id.types import Progress, silent

WHOLE = SPAN * SPANS
"""Longest recording, in samples, that is kept whole."""


def accumulate(
    bags: Sequence[Path],
    settings: FitSettings,
    *,
    signals: SignalMap | None = None,
    namespace: str = "",
    threads: bool = True,
    tell: Progress = silent,
) -> Accumulated:
    """Accumulate the samples of one or several bags of one drive.

    Without ``threads``, this one reads, too: where each process is confined to one core.

    Raises DriveIdError when a bag cannot be read, or its samples cannot give a map.
    """
    signals = signals or SignalMap()
    reading = SeveralBags(bags, signals, namespace, tell, threads=threads)
    evidence, spans = _gathered(reading, settings, tell)
    return Accumulated(
        evidence=evidence,
        validation=spans.samples(),
        warnings=reading.warnings,
        digests=digests_of(bags),  # after reading, which refuses what only looks large
        truth=reading.truth,
        samples=reading.samples,
        last_stamp=reading.last_stamp,
        unchecked=reading.unchecked,
    )


def _gathered(reading: SeveralBags, settings: FitSettings, tell: Progress) -> tuple[Evidence, Spans]:
    """Prescan and accumulate: in one pass if i_max is set, else from the samples kept, or in a second pass."""
    known = settings.i_max is not None
    while True:
        prescan, spans = Prescan(), Spans()
        evidence = prescan.prepare(settings) if known else None
        try:
            for piece, begins in reading.pieces("Accumulating" if known else "Reading"):
                prescan.add(piece.samples, continues=piece.continues)
                spans.add(piece)
                if evidence is not None:
                    _add(evidence, piece, begins=begins)
            break
        except UnusualError:
            reading.read_whole()
    prescan.check(settings.method)
    if evidence is not None:
        prescan.inform(evidence)
        return evidence, spans
    evidence = prescan.prepare(settings)
    if spans.whole:
        for samples in spans.samples():
            evidence.add(samples, partial(_tell_done, tell, len(samples)))
    else:
        for piece, begins in reading.pieces("Accumulating"):
            _add(evidence, piece, begins=begins and bool(settings.conditions))
    return evidence, spans


def _add(evidence: Evidence, piece: Piece, *, begins: bool) -> None:
    if begins:
        evidence.next_recording()
    evidence.add(piece.samples, continues=piece.continues)


def _tell_done(tell: Progress, count: int, done: int) -> None:
    tell("Accumulating", done / count)
