"""Parts of a recording in which the drive was restarted or exchanged: merged only if they are of one drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

from drive_id.common.messages import Message
from drive_id.core.accumulation.accumulated import bounded
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import Spans
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.same_drive import Compared, compared
from drive_id.errors import DriveChangedError, DriveIdError
from drive_id.files.read.drive_parts import DrivePart
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
    left out, for nothing shows that they are of the same drive. Bags are compared by the fit of all, which warns.

    Raises
    ------
    DriveChangedError
        When two parts cannot be of one drive, or are too short to tell.
    """
    kept = [part for part in parts if part.of_drive is None]
    said: list[Message] = []
    for bag in sorted({part.bag for part in parts if part.of_drive is not None}):
        chosen, remarks = _alike([part for part in parts if part.bag == bag], tell)
        kept += chosen
        said += remarks
    kept.sort(key=lambda part: part.bag)  # the parts of a bag stay in order
    evidence = reduce(Evidence.merged, (part.evidence for part in kept))
    return evidence, bounded([each for part in kept for each in part.spans.samples()]), tuple(said)


def _alike(parts: Sequence[Part], tell: Progress) -> tuple[list[Part], list[Message]]:
    """Return the parts of a bag that are of one drive, and what is to be said; see :func:`of_one_drive`."""
    kept: list[tuple[Part, IdentifiedDrive]] = []
    said: list[Message] = []
    for part in parts:
        tell("Solving", None)
        try:
            found = part, conclude(part.evidence.copy(), ())
        except DriveIdError as error:
            said.append(_left_out(part, str(error)))
            continue
        agreement = _compared(kept[-1], found) if kept else None
        if agreement is not None and agreement.vague:
            fewer, more = sorted((kept.pop(), found), key=lambda each: each[0].evidence.samples)
            said.append(_left_out(fewer[0], "Its errors are too large to tell."))
            found = more
        elif agreement is not None:
            said.append(Message("same_drive", compared=agreement.text))
        kept.append(found)
    if not kept:
        raise DriveChangedError(Message("drive_changed.short", parts=len(parts), reason=said[0].values["reason"]))
    return [part for part, _ in kept], said


def _left_out(part: Part, reason: str) -> Message:
    return Message("left_out.part", samples=part.evidence.samples, reason=reason)


def _compared(one: tuple[Part, IdentifiedDrive], other: tuple[Part, IdentifiedDrive]) -> Compared:
    """Compare two parts; raises DriveChangedError if they cannot be of one drive."""
    first, second = one[0].of_drive, other[0].of_drive
    assert first is not None
    assert second is not None
    found = compared(one[1], other[1], second.middle - first.middle)
    reason = second.reason or Message("another_drive.unknown")
    if found.differ:
        raise DriveChangedError(Message("drive_changed.recorded", reason=reason, difference="; ".join(found.differ)))
    return found
