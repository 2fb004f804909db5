"""From accumulated samples to an identified drive: what all methods share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from drive_id.common.origins import ORIGINS
from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks.radius import check_radius
from drive_id.core.methods.method import Estimate, Method
from drive_id.core.methods.paper import PAPER_METHODS
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.monotone_estimate import made_monotone
from drive_id.core.result.warnings import because, condemned, review
from drive_id.core.validation.current_simulation import simulate_current
from drive_id.core.validation.metrics import mean_absolute_deviation
from drive_id.core.validation.simulated_current import SimulatedCurrent, simulated_current
from drive_id.errors import UnexplainedError
from drive_id.types import Samples

if TYPE_CHECKING:  # takes 0.1 s, which methods psm and joint do without
    from drive_id.core.full.fit import EarlierFit


_CONTINUED = 1.1
"""Ratio of the largest current to i_max up to which the simulated current judges the model: the map goes on linearly,
which is 0.4 % of i_max then, and 5 % at 1.5."""


@dataclass(frozen=True, eq=False)
class Conclusion:
    """An identified drive, and what a conclusion from further samples takes over besides its MAD: the selection."""

    drive: IdentifiedDrive
    fit: EarlierFit | None
    judged: bool  # whether the MAD judges the model


def conclude(evidence: Evidence, validation: Sequence[Samples]) -> IdentifiedDrive:
    """Return the drive of :func:`concluded`."""
    return concluded(evidence, validation).drive


def concluded(evidence: Evidence, validation: Sequence[Samples], earlier: Conclusion | None = None) -> Conclusion:
    """Estimate by the method of the settings, simulate the currents, and judge the result.

    The currents of the validation samples are simulated for the MAD; NaN without any. From an earlier conclusion, by
    the same settings from most of these samples, the MAD, and what method full selected and found about its errors, are
    taken over. Raises CoverageError, UnexplainedError, DataError when these samples cannot give a trustworthy map.
    """
    inside, coverage = evidence.inside(), evidence.coverage()
    check_radius(evidence, coverage)
    method = _method_named(evidence.settings.method)
    estimate = method.conclude(evidence, inside, earlier.fit if earlier else None)
    if not estimate.unexplained <= method.limits.refused:
        raise UnexplainedError(because(evidence, "unexplained.fit", unexplained=estimate.unexplained))
    if evidence.settings.monotone:
        estimate = made_monotone(estimate)
    if earlier:
        known = earlier.drive.report
        mad, complete, simulated = (known.mad_d, known.mad_q), earlier.judged, earlier.drive.simulated
    else:
        mad, complete, simulated = _mad(validation, estimate)
        complete = complete and evidence.reached <= _CONTINUED * evidence.i_max
    judged = mad if complete else (0.0, 0.0)
    if impossible := condemned(evidence, estimate, judged, method.limits):
        raise UnexplainedError(impossible)
    report = replace(
        estimate.report,
        samples_read=evidence.samples,
        gaps=evidence.gaps,
        mad_d=mad[0],
        mad_q=mad[1],
        coverage=coverage,
        warnings=review(evidence, coverage, estimate, judged, method.limits),
    )
    drive = IdentifiedDrive(
        method=evidence.settings.method,
        i_max=evidence.i_max,
        report=report,
        simulated=simulated,
        **estimate.by_name(),
    )
    return Conclusion(drive, estimate.fit, complete)


def _method_named(name: str) -> Method:
    if ORIGINS[name].windows:
        from drive_id.core.methods.full import FullMethod  # noqa: PLC0415  # takes 0.1 s

        return FullMethod()
    return PAPER_METHODS[name]


def _mad(
    validation: Sequence[Samples], estimate: Estimate
) -> tuple[tuple[float, float], bool, SimulatedCurrent | None]:
    """Return the MAD of i_d and i_q, A, whether it judges the model, and an excerpt of the simulated current.

    The samples are corrected for the sensor faults and effects that were found, as far as the effects are known for
    these samples.
    """
    if not validation:
        return (float("nan"), float("nan")), False, None
    pieces, complete = estimate.corrected(validation), True
    if estimate.effects is not None:
        voltages, complete = estimate.effects(validation)
        pieces = [replace(piece, u_abc=piece.u_abc - taken) for piece, taken in zip(pieces, voltages, strict=True)]
    simulated = [simulate_current(piece, estimate.flux_map, estimate.resistance, estimate.drop) for piece in pieces]
    measured = [frames.to_dq(piece.i_abc, piece.angle) for piece in pieces]
    mad = mean_absolute_deviation(np.concatenate(simulated), np.concatenate(measured))
    return mad, complete, simulated_current(pieces, simulated, measured)
