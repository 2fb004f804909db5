"""Compare i_max with the currents of the data: too small, too large, or the disc is not filled."""

from __future__ import annotations

import numpy as np

from drive_id.common.messages import Message
from drive_id.core.accumulation.evidence import DOMAIN_MARGIN, Evidence
from drive_id.errors import CoverageError

_LEAST_COVERAGE = 0.05  # of the disc: a map of less is a line
WEAK_COVERAGE = 0.45  # a quadrant or half a disc, and some more, is covered from which on nothing is said
_MUCH_TOO_SMALL = 2.0  # currents over i_max: three quarters of the plane would be left out
_TOO_LARGE = 0.7  # largest current over i_max: half of the disc stays empty
_EMPTY_HALF = 0.5  # coverage of a half-plane over that of the best one, below which it is named


def check_radius(evidence: Evidence, coverage: float) -> None:
    """Refuse a disc that does not match the data.

    Parameters
    ----------
    evidence : Evidence
        Of all samples.
    coverage : float
        Share of the disc with data, 0 to 1.

    Raises
    ------
    CoverageError
        When the currents reach more than twice i_max, or the data cover less than 5 % of the disc.
    """
    if evidence.reached > _MUCH_TOO_SMALL * evidence.i_max:
        raise CoverageError(Message("disc_too_small", **_sizes(evidence, coverage)))
    if coverage < _LEAST_COVERAGE:
        code = "disc_too_large" if _too_large(evidence) else "little_coverage"
        raise CoverageError(Message(code, "error", **_sizes(evidence, coverage)))


def radius_warnings(evidence: Evidence, coverage: float) -> list[Message]:
    """Return warnings on the disc and on samples beyond the map; see :func:`check_radius`."""
    warnings, sizes = [], _sizes(evidence, coverage)
    if _too_large(evidence):
        warnings.append(Message("disc_too_large", **sizes))
    elif coverage < WEAK_COVERAGE:
        half, covered = _emptiest_half(evidence)
        warnings.append(Message("little_coverage.data", half=half, covered=covered, **sizes))
    if outside := evidence.outside:
        beyond = evidence.settings.i_max is not None and evidence.reached > sizes["domain"]
        warnings.append(Message(f"left_out.{'beyond' if beyond else 'outside'}", pairs=outside, **sizes))
    return warnings


def _sizes(evidence: Evidence, coverage: float) -> dict[str, float]:
    i_max = evidence.i_max
    return {"coverage": coverage, "i_max": i_max, "reached": evidence.reached, "domain": DOMAIN_MARGIN * i_max}


def _emptiest_half(evidence: Evidence) -> tuple[str | None, float]:
    """Return the half of the disc with the least data, None if no half stands out, and its share with data."""
    i_d, i_q = np.meshgrid(evidence.visits.i_d, evidence.visits.i_q, indexing="ij")
    disc, inside = np.hypot(i_d, i_q) <= evidence.i_max, evidence.inside()
    halves = {"i_d > 0": i_d > 0, "i_d < 0": i_d < 0, "i_q > 0": i_q > 0, "i_q < 0": i_q < 0}
    filled = {name: float(inside[disc & half].mean()) for name, half in halves.items() if (disc & half).any()}
    least = min(filled, key=lambda name: filled[name])
    return (None if filled[least] > _EMPTY_HALF * max(filled.values()) else least), filled[least]


def _too_large(evidence: Evidence) -> bool:
    return 0 < evidence.reached < _TOO_LARGE * evidence.i_max
