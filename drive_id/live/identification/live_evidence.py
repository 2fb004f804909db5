"""Live samples: accumulated as they arrive, and fitted from a snapshot while more arrive."""

from __future__ import annotations

from dataclasses import dataclass, replace

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import Spans
from drive_id.core.checks.prescan import Prescan
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.conclusion import Conclusion, concluded
from drive_id.core.signals.join import SECTIONS, Piece, StreamJoin
from drive_id.core.signals.signal import Signal
from drive_id.errors import ConfigurationError
from drive_id.types import Samples

_WAIT = 0.2
"""Duration of samples accumulated per call, s: a call takes about a millisecond even for few samples."""


@dataclass(eq=False)
class LiveSums:
    """What is kept of joined samples.

    The excerpt of the trajectory, for the MAD, is without rests, for at rest every map looks good; ``resting`` says
    that the last piece was left out of it.
    """

    evidence: Evidence
    prescan: Prescan
    excerpt: Spans
    resting: bool = False

    def add(self, piece: Piece) -> None:
        """Take a further piece."""
        moving = len(piece.samples) - piece.continues + self.evidence.idle
        self.evidence.add(piece.samples, continues=piece.continues, prompt=True)
        self.prescan.add(piece.samples, continues=piece.continues)
        before, self.resting = self.resting, self.evidence.idle == moving
        if not self.resting:
            self.excerpt.add(replace(piece, continues=piece.continues and not before))

    def copy(self, settings: FitSettings) -> LiveSums:
        """Return an independent copy for another method."""
        return LiveSums(self.evidence.copy(settings), self.prescan.copy(), self.excerpt.copy(), self.resting)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Everything that had arrived at one moment; the stream goes on without it. The rest is not yet gathered."""

    join: StreamJoin
    gathered: LiveSums
    rest: tuple[Piece, ...]

    def validation(self) -> tuple[Samples, ...]:
        """Return the excerpt of the trajectory, to be simulated for the MAD and to be drawn."""
        return self.gathered.excerpt.samples()

    def conclude(self, earlier: Conclusion | None = None) -> Conclusion:
        """Fit; call it once.

        Parameters
        ----------
        earlier : Conclusion, optional
            From most of these samples, see :func:`~drive_id.core.result.conclusion.concluded`.

        Raises
        ------
        DriveIdError
            What reading and fitting a bag of these samples would raise.
        """
        self.join.check()
        for piece in self.rest:
            self.gathered.add(piece)
        self.gathered.prescan.check(self.gathered.evidence.settings.method)
        self.gathered.prescan.inform(self.gathered.evidence)
        return concluded(self.gathered.evidence, self.validation(), earlier)


class LiveEvidence:
    """Accumulates the samples of one drive. Not for several threads at once.

    Parameters
    ----------
    settings : FitSettings
        Nothing can be accumulated without i_max.
    names : tuple of str
        Topics of currents, voltages and resolver, for messages.
    """

    def __init__(self, settings: FitSettings, names: tuple[str, str, str] = SECTIONS) -> None:
        self.settings = settings
        self._names = names
        self.reset()

    @property
    def evidence(self) -> Evidence | None:
        """Of all samples so far; None without i_max."""
        return None if self._gathered is None else self._gathered.evidence

    def successor(self) -> LiveEvidence:
        """Return an empty one with the same settings."""
        return LiveEvidence(self.settings, self._names)

    def reset(self) -> None:
        """Forget all samples."""
        self.join = StreamJoin(self._names, wait=_WAIT)
        self._gathered: LiveSums | None = None
        if self.settings.i_max is not None:
            evidence = Evidence.within(self.settings, self.settings.i_max, compared=True)  # requests name any method
            evidence.next_recording()  # the live samples are the first one
            self._gathered = LiveSums(evidence, Prescan(), Spans())

    def configure(self, settings: FitSettings) -> bool:
        """Take other settings, and tell whether the samples had to be forgotten.

        They are kept where only settings of the solution change, where the map resolves the disc of another i_max, and
        where method full, whose evidence serves all methods, is replaced by another one.
        """
        self.settings = settings
        lost = settings.i_max is not None if self.evidence is None else not self.evidence.suits(settings)
        if lost:
            self.reset()
        elif self.evidence is not None and settings.i_max is not None:
            self.evidence.i_max = settings.i_max
        return lost

    def add(self, section: int, piece: Signal) -> None:
        """Take a further part of a signal, see :meth:`StreamJoin.add`."""
        self._gather(self.join.add(section, piece))

    def advance(self) -> None:
        """Join and accumulate all complete samples, however few."""
        self._gather(self.join.advance())

    def _gather(self, pieces: list[Piece]) -> None:
        if self._gathered is not None:
            for piece in pieces:
                self._gathered.add(piece)

    def snapshot(self, method: str = "", i_max: float = 0.0) -> Snapshot:
        """Return what has arrived so far, to be fitted in another thread.

        Parameters
        ----------
        method : str
            Empty: that of the settings.
        i_max : float
            Radius of the disc, A; 0: that of the settings.

        Raises
        ------
        ConfigurationError
            When i_max is not set, the map does not resolve the disc, or there is no such method.
        """
        settings = replace(self.settings, method=method or self.settings.method, i_max=i_max or self.settings.i_max)
        settings.check_recordings(1)
        if self._gathered is None:
            raise ConfigurationError(
                "i_max is not set, and live samples need it in advance: set it to the radius of the trajectory's "
                "current disc in A, or give bags."
            )
        largest = self._gathered.evidence.largest_disc
        if not self._gathered.evidence.resolves(settings.i_max):
            raise ConfigurationError(
                f"i_max is {settings.i_max:g} A, and the live samples are summed for {largest:g} A: ask for half of "
                "that to all of it, or give the recording."
            )
        join, rest = self.join.finished()
        return Snapshot(join, self._gathered.copy(settings), tuple(rest))
