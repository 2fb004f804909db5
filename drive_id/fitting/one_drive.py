"""Parts of a recording in which the drive was restarted or exchanged: merged only if they are of one drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

from drive_id.core.accumulation.accumulated import bounded
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import Spans
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.same_drive import compared
from drive_id.errors import DriveChangedError, DriveIdError
from drive_id.files.read.drive_parts import DrivePart
from drive_id.messages import Message
from drive_id.types import Progress, Samples


@dataclass(frozen=True, eq=False)
class Part:
    """Samples of one drive: a bag, or a part of one."""

    bag: int  # number
    of_drive: DrivePart | None  # None for a whole bag
    evidence: Evidence
    spans: Spans


def of_one_drive(parts: Sequence[Part], tell: Progress) -> tuple[Evidence, tuple[Samples, ...], tuple[Message, ...]]:
    """Return what parts have in common: sums of all, excerpts, and what is to be said.

    Each part is fitted by itself and compared with the one before it in the same bag. Those that cannot be fitted are
    left out, for nothing shows that they are of the same drive.

    Raises
    ------
    DriveChangedError
        When two parts cannot be of one drive, or are too short to tell.
    """
    kept: list[Part] = []
    said: list[Message] = []
    before: tuple[Part, IdentifiedDrive] | None = None
    for part in parts:
        tell("Solving", None)
        if part.of_drive is None:
            kept.append(part)
            continue
        try:
            drive = conclude(part.evidence.copy(), ())
        except DriveIdError as error:
            said.append(Message("left_out.part", samples=part.of_drive.samples, reason=str(error)))
            continue
        if before is not None and before[0].bag == part.bag:
            said.append(_agreement(before, (part, drive)))
        kept.append(part)
        before = part, drive
    if not kept:
        raise DriveChangedError(Message("drive_changed.short", parts=len(parts), reason=str(said[0].values["reason"])))
    evidence = reduce(Evidence.merged, (part.evidence for part in kept))
    return evidence, bounded([each for part in kept for each in part.spans.samples()]), tuple(said)


def _agreement(one: tuple[Part, IdentifiedDrive], other: tuple[Part, IdentifiedDrive]) -> Message:
    """Return that two parts are of one drive; raises DriveChangedError if they are not."""
    first, second = one[0].of_drive, other[0].of_drive
    assert first is not None
    assert second is not None
    found = compared(one[1], other[1], second.middle - first.middle)
    reason = second.reason or Message("another_drive.unknown")
    if found.differ:
        raise DriveChangedError(Message("drive_changed.recorded", reason=reason, difference="; ".join(found.differ)))
    return Message("same_drive", compared=found.text)
