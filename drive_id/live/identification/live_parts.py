"""Live samples of one drive after the other: what came before a drive was restarted or exchanged is kept apart."""

from __future__ import annotations

from collections.abc import Sequence

from drive_id.common.health import Level, Observation
from drive_id.common.messages import Message
from drive_id.core.fit_settings import FitSettings
from drive_id.core.signals.drive_watch import LEAST_OF_ONE_DRIVE, DriveWatch
from drive_id.errors import ConfigurationError, DriveChangedError
from drive_id.files.messages.block_codec import read_head
from drive_id.live.identification.live_evidence import LiveEvidence
from drive_id.live.publishers import Publisher

BEFORE, AFTER = "before", "after"
"""Parts that may be asked for."""


class LiveParts:
    """Live samples of the present drive, and of the one before it. Not for several threads at once."""

    def __init__(self, present: LiveEvidence) -> None:
        self.present = present
        """Samples since the last change."""
        self.life = 0
        """Number of times that samples were forgotten, or another drive began."""
        self._begin()

    def _begin(self) -> None:
        self._watch = DriveWatch()
        self._before: LiveEvidence | None = None
        self._reason: Message | None = None
        self._changes = 0

    def block(self, topic: str, data: bytes) -> bool:
        """Take a serialized block, and tell whether another drive begins with it."""
        try:
            head = read_head(data)
        except ValueError:
            return False  # whoever decodes it tells
        return self._divided(
            self._watch.block(topic, head.first_sample, head.samples, head.stamp, head.sample_period, head.frame)
        )

    def publishers(self, topic: str, found: Sequence[Publisher]) -> bool:
        """Take who publishes a topic, and tell whether another drive has come up."""
        return self._divided(self._watch.publishers(topic, {each.identity: each.node for each in found}))

    def configure(self, settings: FitSettings) -> bool:
        """Take other settings, and tell whether samples had to be forgotten."""
        lost = self.present.configure(settings)
        if lost or (self._before is not None and self._before.configure(settings)):
            self.reset()
            return True
        return False

    def reset(self) -> None:
        """Forget all samples."""
        self.present.reset()
        self.life += 1
        self._begin()

    def chosen(self, part: str) -> LiveEvidence:
        """Return the samples of the part asked for, empty for all.

        Raises
        ------
        DriveChangedError
            When the samples are of two drives, and no part is named.
        ConfigurationError
            When there is no such part.
        """
        if part not in {"", BEFORE, AFTER}:
            raise ConfigurationError(f"There is no part '{part}': ask for '{BEFORE}' or '{AFTER}', or for none.")
        if self._reason is None:
            if part:
                raise ConfigurationError("The live samples are of one drive only: name no part.")
            return self.present
        if not part:
            raise DriveChangedError(self._sentence())
        if part == AFTER:
            return self.present
        if self._before is None:
            raise ConfigurationError("Too few samples came before the change to be kept: ask for the part 'after'.")
        return self._before

    def findings(self) -> list[Observation]:
        """Return that the samples are of two drives."""
        return [] if self._reason is None else [(Level.WARN, self._sentence())]

    def _sentence(self) -> str:
        assert self._reason is not None
        before = 0 if self._before is None else self._before.join.samples
        return Message(
            "drive_changed",
            reason=self._reason,
            changes=self._changes if self._changes > 1 else None,
            before=before,
            after=self.present.join.samples,
        )

    def _divided(self, reason: Message | None) -> bool:
        """Begin a new part, for a reason, unless no sample has come yet."""
        if reason is None or not any(track.read for track in self.present.join.tracks):
            return False
        self.life += 1
        self._changes += 1
        before = self.present
        self.present = before.successor()
        before.advance()
        if before.join.samples >= LEAST_OF_ONE_DRIVE:
            self._before, self._reason = before, reason
        self._reason = self._reason or reason
        return True
