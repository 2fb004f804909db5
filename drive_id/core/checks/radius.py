"""Compare i_max with the currents of the data: too small, too large, or the disc is not filled."""

from __future__ import annotations

import numpy as np

from drive_id.core.accumulation.evidence import DOMAIN_MARGIN, Evidence
from drive_id.errors import CoverageError

_LEAST_COVERAGE = 0.05
_WEAK_COVERAGE = 0.45
_MUCH_TOO_SMALL = 2.0
_TOO_LARGE = 0.7
_EMPTY_HALF = 0.5


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
    i_max, reached = evidence.i_max, evidence.reached
    if reached > _MUCH_TOO_SMALL * i_max:
        raise CoverageError(
            f"i_max is {i_max:.4g} A but the recording reaches {reached:.4g} A: what lies beyond "
            f"{DOMAIN_MARGIN * i_max:.4g} A has no place in the map, so set i_max to {reached:.3g} A."
        )
    if coverage >= _LEAST_COVERAGE:
        return
    if _too_large(evidence):
        raise CoverageError(_too_large_sentence(evidence, coverage))
    raise CoverageError(
        f"The trajectory covers {100 * coverage:.1f} % of the disc of {i_max:.4g} A, too little for a map: drive the "
        "machine along a trajectory that fills the current disc, such as a Lissajous figure."
    )


def radius_warnings(evidence: Evidence, coverage: float) -> list[str]:
    """Return warnings on the disc and on samples beyond the map; see :func:`check_radius`."""
    warnings = []
    i_max, reached, outside = evidence.i_max, evidence.reached, evidence.information.outside
    if _too_large(evidence):
        warnings.append(_too_large_sentence(evidence, coverage))
    elif coverage < _WEAK_COVERAGE:
        warnings.append(
            f"The data cover {100 * coverage:.0f} % of the disc of {i_max:.4g} A{_missing(evidence)}: the map is valid "
            "only where 'inside' says so."
        )
    if outside and evidence.settings.i_max is not None and reached > DOMAIN_MARGIN * i_max:
        warnings.append(
            f"i_max is {i_max:.4g} A but the recording reaches {reached:.4g} A: {outside} pairs of samples beyond "
            f"{DOMAIN_MARGIN * i_max:.4g} A were left out, so set i_max to {reached:.3g} A."
        )
    elif outside:
        warnings.append(
            f"{outside} pairs of samples lie beyond the map's range and were left out: they are faulty, or i_max is "
            "set too low."
        )
    return warnings


def _missing(evidence: Evidence) -> str:
    """Return a clause naming the half of the disc with the least data; empty if no half stands out."""
    i_d, i_q = np.meshgrid(evidence.visits.i_d, evidence.visits.i_q, indexing="ij")
    disc, inside = np.hypot(i_d, i_q) <= evidence.i_max, evidence.inside()
    halves = {"i_d > 0": i_d > 0, "i_d < 0": i_d < 0, "i_q > 0": i_q > 0, "i_q < 0": i_q < 0}
    filled = {name: float(inside[disc & half].mean()) for name, half in halves.items() if (disc & half).any()}
    least = min(filled, key=lambda name: filled[name])
    if filled[least] > _EMPTY_HALF * max(filled.values()):
        return ""
    return f", and {100 * filled[least]:.0f} % of its half with {least}"


def _too_large(evidence: Evidence) -> bool:
    return 0 < evidence.reached < _TOO_LARGE * evidence.i_max


def _too_large_sentence(evidence: Evidence, coverage: float) -> str:
    return (
        f"i_max is {evidence.i_max:.4g} A but the currents reach only {evidence.reached:.4g} A: the map covers "
        f"{100 * coverage:.2g} % of the disc, so set i_max to {evidence.reached:.3g} A or drive the machine further."
    )
