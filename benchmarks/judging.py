"""Errors of an identified drive, with the linear part of the inverter curve counted as resistance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drive_id.bench.drive import Simulation
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.identify import gather, score
from drive_id.core.validation.metrics import nrmse
from drive_id.fitting.result import Identification
from drive_id.types import FloatArray, GroundTruth

LARGE = 0.5
"""Share of i_max above which currents are large: there a drop is a + r i + c / i, and r belongs to the resistance."""


BAND = 1.96
"""Standard errors that a normal error exceeds once in twenty times."""


@dataclass(frozen=True)
class Errors:
    """Errors at the map's points with data, and of R: relative, and in standard errors."""

    psi_d: float  # NRMSE
    psi_q: float
    z: FloatArray  # (N, 2), in standard errors
    resistance: float
    resistance_z: float

    @property
    def band(self) -> float:
        """Share of errors within the 95 % intervals."""
        return float(np.mean(np.abs(self.z) < BAND))


def against(
    found: IdentifiedDrive | Identification, flux: Callable[[FloatArray], FloatArray], i_max: float, resistance: float
) -> Errors:
    """Compare with true fluxes (N, 2), Wb, at currents (N, 2), A, up to ``i_max``, and a true resistance, ohm."""
    flux_map, grid = found.flux_map, found.flux_map.grid()
    chosen = flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= i_max)
    true = flux(grid[chosen])
    psi, sigma = (
        np.stack([getattr(flux_map, f"{kind}_{axis}")[chosen] for axis in "dq"], axis=-1) for kind in ("psi", "sigma")
    )
    known = np.isfinite(true).all(axis=1)
    error = found.resistance - resistance
    return Errors(
        *nrmse(psi[known], true[known]), ((psi - true) / sigma)[known], error / resistance,
        error / found.sigma_resistance,
    )  # fmt: skip


@dataclass(frozen=True)
class Figures:
    """Errors of one fit; all but the MAD are dimensionless."""

    nrmse_d: float
    nrmse_q: float
    resistance: float  # |R / (R_true + r) - 1|, r being the slope to which the true curve tends
    curve: float
    """Root mean square error of the inverter curve over [-i_max, i_max], the true one less r i, relative to
    ``unit``."""
    mad_d: float  # A; NaN when the simulation diverged
    mad_q: float


def judge(found: IdentifiedDrive, truth: GroundTruth, unit: float) -> Figures:
    """Compare with the truth.

    Parameters
    ----------
    found : IdentifiedDrive
    truth : GroundTruth
    unit : float
        To which the curve's error is relative where the true curve is zero, V.
    """
    slope, true = normalized_curve(truth, found.inverter_current)
    resistance = abs(found.resistance / (truth.resistance + slope) - 1)
    height = float(np.abs(true).max()) or unit
    curve = float(np.sqrt(np.mean((found.inverter_voltage - true) ** 2))) / height
    return Figures(*score(found, truth), resistance, curve, found.report.mad_d, found.report.mad_q)


def normalized_curve(truth: GroundTruth, current: FloatArray) -> tuple[float, FloatArray]:
    """Return the slope r, ohm, to which the true inverter curve tends, and the curve less r i (C,), V.

    What a compensating drive adds to its commands is no part of the record: such an inverter seems to be none.
    """
    if truth.details.get("inverter_compensation"):
        return 0.0, np.zeros_like(current)
    large = truth.inverter_current >= LARGE * truth.i_max
    i, drop = truth.inverter_current[large], truth.inverter_voltage[large]
    slope = float(np.linalg.lstsq(np.stack([i, np.ones_like(i), 1 / i], axis=1), drop, rcond=None)[0][0])
    true = np.interp(current, truth.inverter_current, truth.inverter_voltage) - slope * current
    return slope, np.asarray(true)


def fitted(simulations: Sequence[Simulation], settings: FitSettings, unit: float) -> tuple[IdentifiedDrive, Figures]:
    """Fit recordings of one drive together and judge the fit on the MAD of the same recordings."""
    recordings = [simulation.samples for simulation in simulations]
    found = conclude(gather(recordings, settings), recordings)
    return found, judge(found, simulations[0].truth, unit)


def predicted(seen: Sequence[Simulation], unseen: Simulation, settings: FitSettings) -> tuple[float, float]:
    """Fit some recordings, and return the MAD of the current simulated for one that the fit has never seen, A."""
    report = conclude(gather([simulation.samples for simulation in seen], settings), [unseen.samples]).report
    return report.mad_d, report.mad_q


def percent(value: float) -> str:
    """Write a share with three digits that count."""
    return f"{100 * value:.3f} %" if abs(value) < 0.1 else f"{100 * value:.1f} %"


def amperes(value: float) -> str:
    """Format a current, or its absence."""
    return f"{value:.3g} A" if np.isfinite(value) else "diverged"
