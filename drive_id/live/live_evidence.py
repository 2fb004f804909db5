"""Live samples as evidence: accumulated as they arrive, and fitted from a snapshot while more arrive."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks.plausibility import Plausibility
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identification import Identification
from drive_id.core.signals.join import SECTIONS, Piece, StreamJoin, joined
from drive_id.core.signals.join_report import JoinReport
from drive_id.core.signals.signal import Signal
from drive_id.errors import ConfigurationError
from drive_id.types import Samples


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Everything that had arrived at one moment; the stream goes on without it.

    Parameters
    ----------
    join : StreamJoin
        Finished.
    evidence : Evidence
    plausibility : Plausibility
    rest : tuple of Piece
        Of the join, not yet in evidence and plausibility.
    recent : tuple of Piece
        The last seconds but for the rest, for the MAD.
    """

    join: StreamJoin
    evidence: Evidence
    plausibility: Plausibility
    rest: tuple[Piece, ...]
    recent: tuple[Piece, ...]

    @property
    def report(self) -> JoinReport:
        """What became of the signals."""
        return self.join.report()

    def validation(self) -> Samples | None:
        """Return the last seconds as one recording."""
        pieces = [*self.recent, *self.rest]
        return joined(pieces) if pieces else None

    def identify(self) -> Identification:
        """Fit; call it once.

        Raises
        ------
        DriveIdError
            What reading and fitting a bag of these samples would raise.
        """
        self.join.check()
        for piece in self.rest:
            self.evidence.add(piece.samples, continues=piece.continues)
            self.plausibility.add(piece.samples, continues=piece.continues)
        self.plausibility.check()
        validation = self.validation()
        return conclude(self.evidence, [] if validation is None else [validation])


class LiveEvidence:
    """Accumulates the samples of one drive. Not for several threads at once.

    Parameters
    ----------
    settings : FitSettings
        Without i_max nothing can be accumulated.
    validation_seconds : float
        How much of the latest samples to keep for the MAD, s.
    names : tuple of str
        Topics of currents, voltages and resolver, for messages.
    """

    def __init__(
        self, settings: FitSettings, validation_seconds: float, names: tuple[str, str, str] = SECTIONS
    ) -> None:
        self.settings = settings
        self._validation_seconds = validation_seconds
        self._names = names
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        settings = self.settings
        self.join = StreamJoin(self._names)
        self.evidence = None if settings.i_max is None else Evidence.within(settings, settings.i_max)
        if self.evidence is not None:
            self.evidence.next_recording()  # the live samples are the first one
        self._plausibility = Plausibility()
        self._recent: deque[Piece] = deque()
        self._recent_count = 0

    def configure(self, settings: FitSettings) -> bool:
        """Take other settings, and tell whether the samples had to be forgotten.

        What is gathered for method full serves the others, but not the reverse; with what shapes no sum, the same
        samples are fitted anew.
        """
        self.settings = settings
        lost = settings.i_max is not None if self.evidence is None else not self.evidence.suits(settings)
        if lost:
            self.reset()
        return lost

    def add(self, section: int, piece: Signal) -> None:
        """Take a further part of a signal, see :meth:`StreamJoin.add`."""
        for found in self.join.add(section, piece):
            if self.evidence is None:
                continue
            self.evidence.add(found.samples, continues=found.continues)
            self._plausibility.add(found.samples, continues=found.continues)
            self._keep(found)

    def snapshot(self, method: str = "") -> Snapshot:
        """Return what has arrived so far, to be fitted in another thread.

        Parameters
        ----------
        method : str
            Empty: that of the settings.

        Raises
        ------
        ConfigurationError
            When i_max is not set, or there is no such method.
        """
        settings = replace(self.settings, method=method or self.settings.method)
        settings.check_recordings(1)
        if self.evidence is None:
            raise ConfigurationError(
                "i_max is not set, and live samples need it in advance: set it to the radius of the trajectory's "
                "current disc in A, or give bags."
            )
        join, rest = self.join.finished()
        return Snapshot(join, self.evidence.copy(settings), self._plausibility.copy(), tuple(rest), tuple(self._recent))

    def _keep(self, piece: Piece) -> None:
        """Keep the latest seconds."""
        self._recent.append(piece)
        self._recent_count += len(piece.samples)
        most = self._validation_seconds / piece.samples.sample_period
        while self._recent and self._recent_count - len(self._recent[0].samples) >= most:
            self._recent_count -= len(self._recent.popleft().samples)
