"""What a result is judged by besides its numbers: residuals, simulated currents, and the paper's methods beside it.

All of it is small, so that it is stored with a result and a report can be made of a result folder alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.common.origins import JOINT, PSM
from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.identify import gather, score
from drive_id.core.validation.residuals import (
    AngleBins,
    PlaneBins,
    Residual,
    TimeBins,
    over_angle,
    over_plane,
    over_time,
    residual_voltage,
)
from drive_id.core.validation.simulated_current import SimulatedCurrent
from drive_id.errors import DataError
from drive_id.types import FloatArray, GroundTruth, Samples

COMPARED = (PSM.name, JOINT.name)
"""Methods that are run beside the one that was asked for: the paper's, without and with the inverter."""
_TRAJECTORY = 4000
"""Points of the trajectory."""


@dataclass(frozen=True, eq=False)
class ComparedMethod:
    """What another method makes of the same data."""

    method: str  # psm or joint
    failure: str = ""  # why it gave no result, a sentence; empty where it did. All else is NaN or empty then
    samples: int = 0  # that were used
    resistance: float = math.nan  # ohm
    sigma_resistance: float = math.nan  # ohm
    voltage_error: float = math.nan  # V; 0 for psm
    sigma_voltage_error: float = math.nan  # V
    residual_rms: float = math.nan  # see Diagnostics, V
    mad_d: float = math.nan  # A; NaN when unknown
    mad_q: float = math.nan  # A
    nrmse_d: float = math.nan  # against the ground truth; NaN without one
    nrmse_q: float = math.nan
    psi_d: FloatArray | None = None  # (D, Q), on the grid of the result's flux map, Wb
    psi_q: FloatArray | None = None  # (D, Q), Wb


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """What a result is judged by besides its numbers."""

    over_angle: AngleBins  # residual voltage over the rotor position
    over_time: TimeBins  # residual voltage over the time of data
    residual_rms: float  # over windows of a few degrees, d and q alike, V: the same measure for all methods
    over_plane: PlaneBins | None  # residual voltage over the currents; None of results of earlier versions
    trajectory: FloatArray  # (N, 2), measured i_dq, A, decimated; NaN after each gap-free run
    simulated: SimulatedCurrent | None = None  # None where no current was simulated
    comparisons: tuple[ComparedMethod, ...] = ()  # the paper's methods, except the result's own one


def diagnose(
    drive: IdentifiedDrive,
    settings: FitSettings,
    excerpts: Sequence[Samples],
    truth: GroundTruth | None = None,
    evidence: Evidence | None = None,
    *,
    compared: bool = True,
) -> Diagnostics:
    """Evaluate residuals over excerpts of the recordings and, if wanted, run the paper's methods on the same data.

    The latter takes longer than all else; they use the evidence of all samples (default: of the excerpts, where these
    are all samples), the settings of the fit, and are scored against the truth.
    """
    residual, turning = drive_residual(drive, excerpts), drive.origin.turning
    return Diagnostics(
        over_angle=over_angle(residual),
        over_time=over_time(residual),
        over_plane=over_plane(residual, drive.i_max),
        residual_rms=_rms(residual),
        trajectory=thinned_trajectory(excerpts, _TRAJECTORY),
        simulated=drive.simulated,
        comparisons=_comparisons(drive, settings, excerpts, truth, evidence) if compared and turning else (),
    )


def thinned_trajectory(excerpts: Sequence[Samples], most: int) -> FloatArray:
    """Return the measured i_dq (N, 2), A, of about ``most`` samples at most, with a NaN after each run."""
    pieces, every = [np.zeros((0, 2))], 1 + sum(map(len, excerpts)) // most
    for part in excerpts:
        i_dq = frames.to_dq(part.i_abc, part.angle)
        for run in part.runs():
            pieces += [i_dq[run][::every], np.full((1, 2), np.nan)]
    return np.concatenate(pieces)


def drive_residual(drive: IdentifiedDrive, excerpts: Sequence[Samples]) -> Residual:
    """Return the residual voltage of samples, corrected for the sensor faults that were found."""
    drop = drive.phase_voltages
    curve = (drive.inverter_current, drive.inverter_voltage if drop is None else drop)
    found, start = [], 0.0
    for part in drive.corrected(excerpts):
        residual = residual_voltage(part, drive.flux_map.flux, drive.resistance, curve)
        found.append(residual._replace(time=start + residual.time))
        start += part.duration
    return Residual.joined(found)


def _rms(residual: Residual) -> float:
    return float(np.sqrt(np.mean(residual.voltage**2))) if len(residual.voltage) else math.nan


def _comparisons(
    drive: IdentifiedDrive,
    settings: FitSettings,
    excerpts: Sequence[Samples],
    truth: GroundTruth | None,
    evidence: Evidence | None,
) -> tuple[ComparedMethod, ...]:
    methods = [method for method in COMPARED if method != drive.method]
    with one_blas_thread():
        if evidence is None and sum(map(len, excerpts)) < drive.report.samples_read:
            failure = "The fit kept no sums for it: fit with compare=True."
            return tuple(ComparedMethod(method, failure=failure) for method in methods)
        if evidence is None and excerpts:
            try:
                evidence = gather(excerpts, replace(settings, method=methods[0]))
            except DataError as error:
                return tuple(ComparedMethod(method, failure=str(error)) for method in methods)
        if evidence is None:
            return ()
        return tuple(_compared(drive, method, evidence, excerpts, truth) for method in methods)


def _compared(
    drive: IdentifiedDrive, method: str, evidence: Evidence, excerpts: Sequence[Samples], truth: GroundTruth | None
) -> ComparedMethod:
    try:
        found = conclude(evidence.copy(replace(evidence.settings, method=method, monotone=False)), excerpts)
    except DataError as error:
        return ComparedMethod(method, failure=str(error))
    nrmse_d, nrmse_q = score(found, truth) if truth else (math.nan, math.nan)
    psi = found.flux_map.psi
    own = (drive.flux_map.i_d, drive.flux_map.i_q)
    if not all(map(np.array_equal, own, (found.flux_map.i_d, found.flux_map.i_q))):  # of excerpts only
        psi = found.flux_map.continued(drive.flux_map.grid())
    return ComparedMethod(
        method=method,
        samples=found.report.samples_used,
        resistance=found.resistance,
        sigma_resistance=found.sigma_resistance,
        voltage_error=found.voltage_error,
        sigma_voltage_error=found.sigma_voltage_error,
        residual_rms=_rms(drive_residual(found, excerpts)),
        mad_d=found.report.mad_d,
        mad_q=found.report.mad_q,
        nrmse_d=nrmse_d,
        nrmse_q=nrmse_q,
        psi_d=psi[..., 0],
        psi_q=psi[..., 1],
    )
