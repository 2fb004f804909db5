"""Accumulate bags for a fit, in memory that does not grow with their length.

A recording of up to :data:`WHOLE` samples is read once and kept between the prescan and accumulating. A longer one is
read twice, unless i_max is set: for the prescan, then to accumulate. Another thread reads, unpacks and joins meanwhile.
For the MAD and for pictures, a short recording is kept whole, and eight evenly spaced parts of a longer one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from drive_id.core.accumulation.accumulated import Accumulated
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import SPAN, SPANS, Spans
from drive_id.core.checks.prescan import Prescan
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.extraction import UnusualError
from drive_id.files.read.several import SeveralBags, digests_of
from drive_id.files.results.checkpoint import Checkpoint, Progressed
from drive_id.types import Progress, silent

WHOLE = SPAN * SPANS
"""Longest recording, in samples, that is kept whole."""


class Interrupted(KeyboardInterrupt):
    """Interrupted, but a checkpoint was kept: the same call resumes from it."""


def accumulate(
    bags: Sequence[Path],
    settings: FitSettings,
    *,
    signals: SignalMap | None = None,
    namespace: str = "",
    i_max: float | None = None,
    checkpoint: Path | None = None,
    threads: bool = True,
    tell: Progress = silent,
) -> Accumulated:
    """Accumulate the samples of one or several bags of one drive.

    Parameters
    ----------
    bags : sequence of Path
    settings : FitSettings
    signals : SignalMap, optional
        Where to find the signals in bags that are not ours.
    namespace : str
        Of the drive, when a bag holds several.
    i_max : float, optional
        Radius of the current disc, A, instead of that of the settings. Whatever is to be merged needs the same one.
    checkpoint : Path, optional
        File kept while long bags are read; after an interrupt the same call resumes from it.
    threads : bool
        Read in other threads; False where each process is confined to one core.
    tell : callable, optional

    Raises
    ------
    DriveIdError
        When a bag cannot be read, or its samples cannot give a map.
    Interrupted
        When interrupted with a checkpoint to resume from.
    """
    if not bags:
        raise ConfigurationError("No bag is given: name at least one.")
    if i_max is not None:
        settings = replace(settings, i_max=i_max)
    signals = signals or SignalMap()
    reading = SeveralBags(bags, signals, namespace, tell, threads=threads)
    saved = Checkpoint(checkpoint, bags, settings, signals, namespace) if checkpoint else None
    try:
        found = digests_of(bags)
        gathering = _Gathering(reading, settings, saved, tell)
        gathering.read()
        gathering.accumulate()
    except KeyboardInterrupt:
        if saved and saved.saved:
            raise Interrupted("run the same command again to resume where it stopped.") from None
        raise
    if saved:
        saved.remove()
    return Accumulated(
        evidence=gathering.evidence,
        validation=gathering.spans.samples(),
        warnings=reading.warnings,
        digests=found,
        truth=reading.truth,
        samples=reading.samples,
        last_stamp=reading.last_stamp,
        unchecked=reading.unchecked,
    )


@dataclass(eq=False)
class _Step:
    """One pass over the bags.

    Parameters
    ----------
    what : str
        Name of the step, for the progress.
    prescan : bool
        Whether to prescan the samples.
    evidence : Evidence or None
        Where to accumulate them; None in a pass that only prescans.
    done : int
        Pieces that it holds already.
    """

    what: str
    prescan: bool
    evidence: Evidence | None = None
    done: int = 0


class _Gathering:
    """Reads the bags once or twice, and keeps prescan, evidence and the excerpt for the MAD."""

    def __init__(self, reading: SeveralBags, settings: FitSettings, saved: Checkpoint | None, tell: Progress) -> None:
        self._reading = reading
        self._settings = settings
        self._saved = saved
        self._tell = tell
        self._prescan = Prescan()
        self.spans = Spans()
        self._evidence: Evidence | None = None

    @property
    def evidence(self) -> Evidence:
        assert self._evidence is not None
        return self._evidence

    def read(self) -> None:
        """Read once and check; accumulate meanwhile if i_max is set or an interrupted call left a checkpoint."""
        progressed = self._saved.load() if self._saved else None
        while True:
            self._prescan, self.spans = Prescan(), Spans()
            step = self._first_step(progressed)
            try:
                self._take(step)
                break
            except UnusualError:
                self._reading.read_whole()
                progressed = None
        self._evidence = step.evidence
        if step.prescan:
            self._prescan.check()
            if self._evidence is not None:
                self._prescan.inform(self._evidence)

    def accumulate(self) -> None:
        """Accumulate, unless the first pass did: the samples that were kept, or all of them in a second pass."""
        if self._evidence is not None:
            return
        self._evidence = evidence = self._prescan.prepare(self._settings)
        if not self.spans.whole:
            self._take(_Step("Accumulating", prescan=False, evidence=evidence))
            return
        for samples in self.spans.samples():
            evidence.add(samples, partial(self._tell_done, len(samples)))

    def _tell_done(self, count: int, done: int) -> None:
        self._tell("Accumulating", done / count)

    def _first_step(self, progressed: Progressed | None) -> _Step:
        known = self._settings.i_max is not None
        if progressed is not None:
            return _Step("Accumulating", prescan=known, evidence=progressed.evidence, done=progressed.pieces)
        if known:
            return _Step("Accumulating", prescan=True, evidence=self._prescan.prepare(self._settings))
        return _Step("Reading", prescan=True)

    def _take(self, step: _Step) -> None:
        first_time = step.prescan or step.done
        for number, (piece, begins) in enumerate(self._reading.pieces(step.what)):
            if step.prescan:
                self._prescan.add(piece.samples, continues=piece.continues)
            if first_time:
                self.spans.add(piece)
            if step.evidence is None or number < step.done:
                continue
            if begins and (self._settings.i_max is not None or self._settings.conditions):
                step.evidence.next_recording()
            step.evidence.add(piece.samples, continues=piece.continues)
            if self._saved:
                self._saved.save(step.evidence, number + 1)
