"""From bags to all that a fit needs to know of them: accumulated, in memory that does not grow with their length.

A recording of up to :data:`WHOLE` samples is read once and kept, to survey it before its samples are accumulated. A
longer one is read twice, unless i_max is given: first for checks and the range of its currents, then to accumulate.
Another thread reads, unpacks and joins meanwhile. For the MAD and for pictures, all of a short recording is kept, and
eight evenly spaced parts of a longer one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from drive_id.core.accumulation.accumulated import Accumulated
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import SPAN, SPANS, Spans
from drive_id.core.checks.survey import Survey
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.extraction import UnusualError
from drive_id.files.read.several import SeveralBags, digests_of
from drive_id.files.results.checkpoint import Checkpoint, Progressed
from drive_id.types import Progress, silent

WHOLE = SPAN * SPANS
"""Samples of a recording that is short enough to be kept as a whole."""


class Interrupted(KeyboardInterrupt):
    """An interrupt after which a second call goes on from where this one was; the text says so."""


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
        Radius of the current disc, A, instead of that of the settings. What is to be merged needs one in common.
    checkpoint : Path, optional
        File to keep while long bags are read, from which a second call after an interrupt goes on.
    threads : bool
        Let other threads read meanwhile; not where each process is to keep to one core.
    tell : callable, optional

    Raises
    ------
    DriveIdError
        When a bag cannot be read, or its samples cannot give a map.
    Interrupted
        When there is a checkpoint to go on from.
    """
    if not bags:
        raise ConfigurationError("No bag is given: name at least one.")
    if i_max is not None:
        settings = replace(settings, i_max=i_max)
    signals = signals or SignalMap()
    reading = SeveralBags(bags, signals, namespace, tell, threads=threads)
    saved = Checkpoint(checkpoint, bags, settings, signals, namespace) if checkpoint else None
    try:
        with digests_of(bags, threads=threads) as digests:
            gathering = _Gathering(reading, settings, saved, tell)
            gathering.read()
            found = digests.result()
            gathering.accumulate()
    except KeyboardInterrupt:
        if saved and saved.saved:
            raise Interrupted("the same call once more goes on from where it was.") from None
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
    )


@dataclass(eq=False)
class _Step:
    """What is to be done with the samples while they are read once.

    Parameters
    ----------
    what : str
        To tell with the progress.
    survey : bool
    evidence : Evidence or None
        To accumulate in.
    done : int
        Pieces that are in it already.
    """

    what: str
    survey: bool
    evidence: Evidence | None = None
    done: int = 0


class _Gathering:
    """Reads once or twice, and gathers survey, evidence and the parts for the MAD."""

    def __init__(self, reading: SeveralBags, settings: FitSettings, saved: Checkpoint | None, tell: Progress) -> None:
        self._reading = reading
        self._settings = settings
        self._saved = saved
        self._tell = tell
        self._survey = Survey()
        self.spans = Spans()
        self._evidence: Evidence | None = None

    @property
    def evidence(self) -> Evidence:
        assert self._evidence is not None
        return self._evidence

    def read(self) -> None:
        """Read all once, and check it; when the radius is known or an interrupted call left evidence, accumulate."""
        progressed = self._saved.load() if self._saved else None
        while True:
            self._survey, self.spans = Survey(), Spans()
            step = self._first_step(progressed)
            try:
                self._take(step)
                break
            except UnusualError:
                self._reading.read_whole()
                progressed = None
        self._evidence = step.evidence
        if step.survey:
            self._survey.check()

    def accumulate(self) -> None:
        """Accumulate, unless it is done: what was kept, or else all of it, read once more."""
        if self._evidence is not None:
            return
        self._evidence = evidence = self._survey.prepare(self._settings)
        if not self.spans.whole:
            self._take(_Step("Accumulating", survey=False, evidence=evidence))
            return
        for samples in self.spans.samples():
            evidence.add(samples, partial(self._tell_done, len(samples)))

    def _tell_done(self, count: int, done: int) -> None:
        self._tell("Accumulating", done / count)

    def _first_step(self, progressed: Progressed | None) -> _Step:
        known = self._settings.i_max is not None
        if progressed is not None:
            return _Step("Accumulating", survey=known, evidence=progressed.evidence, done=progressed.pieces)
        if known:
            return _Step("Accumulating", survey=True, evidence=self._survey.prepare(self._settings))
        return _Step("Reading", survey=True)

    def _take(self, step: _Step) -> None:
        first_time = step.survey or step.done
        for number, (piece, begins) in enumerate(self._reading.pieces(step.what)):
            if step.survey:
                self._survey.add(piece.samples, continues=piece.continues)
            if first_time:
                self.spans.add(piece)
            if step.evidence is None or number < step.done:
                continue
            if begins and (self._settings.i_max is not None or self._settings.conditions):
                step.evidence.next_recording()
            step.evidence.add(piece.samples, continues=piece.continues)
            if self._saved:
                self._saved.save(step.evidence, number + 1)
