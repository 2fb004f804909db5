"""What to record next, and which statements of a fit tell that nothing was found."""

from __future__ import annotations

from collections.abc import Sequence

from drive_id.common.messages import Message
from drive_id.core.checks.radius import WEAK_COVERAGE
from drive_id.core.maps.coverage import disc_coverage, enclosed
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.files.results.identification import Provenance

_ONE_SPEED = 0.1
"""Relative range of the speeds below which they count as one."""
_COVERED = 0.95
"""Share of the disc from which more data are not asked for."""
USUAL = frozenset({"common_gain", "harmonics", "linear_drop", "no_checksums", "region", "separation"})
"""Codes of statements that ask for no decision: they hold for every fit, or the table and the advice tell the same."""


def advice(drive: IdentifiedDrive, known: Provenance) -> tuple[Message, ...]:
    """Say what to record next: what the fit itself says, and what follows from coverage, speed and pole pairs.

    Where a warning tells that most of the disc has no data, they are what helps most.
    """
    found = [message for message in drive.statements if message.kind == "advice"]
    coverage, map_ = drive.report.coverage, drive.flux_map
    if coverage < _COVERED and drive.origin.fitted:  # an imported map may be of no drive
        around = disc_coverage(map_.i_d, map_.i_q, enclosed(map_.inside), drive.i_max)
        if around - coverage > 1 - around:
            more = Message("cover_disc.between", i_max=drive.i_max, missing=around - coverage)
        else:
            more = Message("cover_disc.share", i_max=drive.i_max, missing=1 - coverage)
        found = [message for message in found if message.code != more.code]
        found.insert(0 if coverage < WEAK_COVERAGE else len(found), more)
    if single_speed(known) and not found:
        found.append(Message("second_speed", why=drive.origin.one_speed or None))
    if known.pole_pairs is None:
        found.append(Message("pole_pairs_unknown", how=drive.origin.pole_pairs))
    return (*found, *([Message(drive.origin.advice)] if drive.origin.advice else []))


def sorted_statements(drive: IdentifiedDrive) -> tuple[Sequence[Message], Sequence[Message]]:
    """Return the statements that tell of something, and those that nothing was found; advice is in neither."""
    found = [message for message in drive.statements if message.kind not in ("nothing", "advice")]
    return found, [message for message in drive.statements if message.kind == "nothing"]


def single_speed(known: Provenance) -> bool:
    """Tell whether the recordings have one speed; False where it is not known."""
    if known.speed_range is None:
        return False
    low, high = known.speed_range
    return high - low <= _ONE_SPEED * max(abs(low), abs(high))
