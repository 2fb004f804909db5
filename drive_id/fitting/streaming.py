"""Accumulate bags for a fit, in memory that does not grow with their length.

Up to :data:`~drive_id.files.read.several.KEPT` samples are kept between the prescan and accumulating. More are read
twice, unless i_max is set: for the prescan, then to accumulate. Another thread reads, unpacks and joins meanwhile. For
the MAD and for pictures, a short recording is kept whole, and eight evenly spaced parts of a longer one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from drive_id.core.accumulation.accumulated import Accumulated
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import Spans
from drive_id.core.checks.prescan import Prescan
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.threads import in_threads
from drive_id.core.signals.join import Piece
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.extraction import DividedError, UnusualError
from drive_id.files.read.several import SeveralBags, digests_of
from drive_id.fitting.one_drive import Part, of_one_drive
from drive_id.types import Progress, silent


def accumulate(
    bags: Sequence[Path],
    settings: FitSettings,
    *,
    signals: SignalMap | None = None,
    namespace: str = "",
    threads: bool = True,
    compared: bool = False,
    tell: Progress = silent,
) -> Accumulated:
    """Accumulate the samples of one or several bags of one drive.

    Without ``threads``, this one reads, too: where each process is confined to one core. ``compared`` is as in
    :class:`~drive_id.core.accumulation.evidence.Evidence`.

    Where the drive was restarted or exchanged within a bag, its parts are recordings, and must be of one drive: see
    :func:`~drive_id.fitting.one_drive.of_one_drive`.

    Raises DriveIdError when a bag cannot be read, or its samples cannot give a map.
    """
    signals = signals or SignalMap()
    reading = SeveralBags(bags, signals, namespace, tell, threads=threads)
    try:
        evidence, spans = _gathered(reading, settings, compared=compared)
        validation, warnings = spans.samples(), reading.warnings
    except DividedError:
        evidence, validation, said = of_one_drive(_gathered_apart(reading, settings, tell, compared=compared), tell)
        warnings = (*reading.warnings, *said)
    return Accumulated(
        evidence=evidence,
        validation=validation,
        warnings=warnings,
        digests=digests_of(bags),  # after reading, which refuses what only looks large
        truth=reading.truth,
        samples=reading.samples,
        last_stamp=reading.last_stamp,
        unchecked=reading.unchecked,
    )


def _gathered(reading: SeveralBags, settings: FitSettings, *, compared: bool) -> tuple[Evidence, Spans]:
    """Prescan and accumulate: together if i_max is set, else one after the other."""
    known = settings.i_max is not None
    while True:
        prescan, spans = Prescan(), Spans()
        evidence = prescan.prepare(settings, compared=compared) if known else None
        try:
            for piece, begins in reading.pieces("Accumulating" if known else "Reading", keep=not known):
                spans.add(piece)
                work = [partial(prescan.add, piece.samples, continues=piece.continues)]
                if evidence is not None:
                    work.append(partial(_add, evidence, piece, begins=begins))
                in_threads(_done, work, len(work) if reading.threads else 1)
            break
        except UnusualError:
            reading.read_whole()
    prescan.check(settings.method)
    if evidence is not None:
        prescan.inform(evidence)
        return evidence, spans
    evidence = prescan.prepare(settings, compared=compared)
    for piece, begins in reading.again("Accumulating"):
        _add(evidence, piece, begins=begins)
    return evidence, spans


def _gathered_apart(reading: SeveralBags, settings: FitSettings, tell: Progress, *, compared: bool) -> list[Part]:
    """Read twice, and accumulate each bag, and each part of one in which the drive changed, by itself."""
    prescan = _scanned(reading, settings)
    parts: list[Part] = []
    for piece, begins in reading.pieces("Accumulating"):
        if begins:
            number, of_drive = reading.present
            evidence = prescan.prepare(settings.of_recording(number), compared=compared)
            parts.append(Part(number, of_drive, evidence, Spans()))
            parts[-1].evidence.next_recording()
        parts[-1].evidence.add(piece.samples, continues=piece.continues)
        parts[-1].spans.add(piece)
    for part in parts:
        prescan.inform(part.evidence)
    tell("Solving", None)
    return parts


def _scanned(reading: SeveralBags, settings: FitSettings) -> Prescan:
    """Return the statistics of all samples, having found out by which parts they are to be read."""
    reading.divide()
    while True:
        prescan = Prescan()
        try:
            for piece, _ in reading.pieces("Reading"):
                prescan.add(piece.samples, continues=piece.continues)
        except UnusualError:
            reading.read_whole()
        except DividedError:
            reading.divide()
        else:
            prescan.check(settings.method)
            return prescan


def _done(work: Callable[[], None]) -> None:
    work()


def _add(evidence: Evidence, piece: Piece, *, begins: bool) -> None:
    if begins:
        evidence.next_recording()
    evidence.add(piece.samples, continues=piece.continues)
