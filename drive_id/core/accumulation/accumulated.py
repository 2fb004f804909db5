"""What is kept of recordings for a fit: evidence, excerpts for the MAD and provenance, and how to merge it."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import count

from drive_id.common.messages import Message
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.signals.pieces import common_truth
from drive_id.errors import ConfigurationError
from drive_id.types import GroundTruth, Samples

VALIDATION_SECONDS = 2.0
"""Length of the excerpt of a recording that is sent or stored for the MAD, s."""

VALIDATION_PIECES = 10
"""Largest number of recordings with such an excerpt."""


@dataclass(frozen=True, eq=False)
class Accumulated:
    """What is kept of one bag or of several."""

    evidence: Evidence  # of all samples
    validation: tuple[Samples, ...]  # a bounded part of the recording, for the MAD and for pictures
    warnings: tuple[Message, ...]  # about the recording
    digests: Mapping[str, str]  # storage file to its sha256
    truth: GroundTruth | None  # of the simulation, when all bags carry one of the same machine
    samples: int  # joined, in all bags
    last_stamp: int  # of the last sample, ns
    unchecked: tuple[str, ...] = ()  # recordings whose files have no checksums

    def merged(self, other: Accumulated) -> Accumulated:
        """Return what is kept of both.

        Raises ConfigurationError when they contain the same recording, or were accumulated with different settings.
        """
        known = {digest: file for file, digest in self.digests.items()}
        for file, digest in other.digests.items():
            if digest in known:
                raise ConfigurationError(f"{file} and {known[digest]} are the same recording: give each bag once.")
        return Accumulated(
            evidence=self.evidence.merged(other.evidence),
            validation=bounded([*self.validation, *other.validation]),
            warnings=(*self.warnings, *other.warnings),
            digests={**self.digests, **{_unused(file, self.digests): digest for file, digest in other.digests.items()}},
            truth=common_truth([self.truth, other.truth], [*self.digests][:1] + [*other.digests][:1]),
            samples=self.samples + other.samples,
            last_stamp=max(self.last_stamp, other.last_stamp),
            unchecked=(*self.unchecked, *other.unchecked),
        )


def _unused(file: str, names: Collection[str]) -> str:
    """Return a free name for a file: two machines may have recorded two bags under the same name."""
    candidates = (file if number == 1 else f"{file} ({number})" for number in count(1))
    return next(name for name in candidates if name not in names)


def bounded(pieces: Sequence[Samples]) -> tuple[Samples, ...]:
    """Return the beginnings of recordings, of a bounded number of them.

    A hash of their currents selects them: the same ones in whatever order the recordings come, one by one or in groups.
    """
    cut = [beginning(piece, VALIDATION_SECONDS) for piece in pieces]
    if len(cut) <= VALIDATION_PIECES:
        return tuple(cut)
    return tuple(sorted(cut, key=lambda piece: hashlib.sha256(piece.i_abc.tobytes()).digest())[:VALIDATION_PIECES])


def beginning(samples: Samples, seconds: float) -> Samples:
    """Return the first seconds of a recording, at least one sample."""
    end = max(1, round(seconds / samples.sample_period))
    return samples if len(samples) <= end else samples.part(0, end)
