"""What to record next, and which statements of a fit tell that nothing was found."""

from __future__ import annotations

from collections.abc import Sequence

from drive_id.core.result.identification import IdentifiedDrive
from drive_id.files.results.identification import Provenance

_NEXT = "What would help most: "
_NONE = "No "
_ONE_SPEED = 0.1
"""Relative range of the speeds below which they count as one."""
_COVERED = 0.95
"""Share of the disc from which more data are not asked for."""


def advice(drive: IdentifiedDrive, known: Provenance) -> tuple[str, ...]:
    """Say what to record next: what the fit itself says, and what follows from coverage, speed and pole pairs."""
    found = [_capital(text.removeprefix(_NEXT)) for text in drive.statements if text.startswith(_NEXT)]
    coverage = drive.report.coverage
    if coverage < _COVERED:
        missing = f"{100 * (1 - coverage):.3g} %"
        found.append(f"Data over the whole disc of {drive.i_max:.4g} A: {missing} of it has none.")
    if single_speed(known) and not found:
        found.append(f"A second recording at another speed, ideally in the other direction. {drive.origin.one_speed}")
    if known.pole_pairs is None:
        found.append(f"The number of pole pairs, without which there is no torque: {drive.origin.pole_pairs}.")
    return tuple(filter(None, (*found, drive.origin.advice)))


def sorted_statements(drive: IdentifiedDrive) -> tuple[Sequence[str], Sequence[str]]:
    """Return the statements that tell of something, and those that nothing was found; advice is in neither."""
    nothing = {entry.sentence for entry in drive.calibrations if not entry.applied and not entry.doubtful}
    said = [text for text in drive.statements if not text.startswith(_NEXT)]
    empty = [text for text in said if text in nothing or text.startswith(_NONE)]
    return [text for text in said if text not in empty], empty


def single_speed(known: Provenance) -> bool:
    """Tell whether the recordings have one speed; False where it is not known."""
    if known.speed_range is None:
        return False
    low, high = known.speed_range
    return high - low <= _ONE_SPEED * max(abs(low), abs(high))


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"
