"""What a method estimates of a drive, and a result holds: the one list of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from drive_id.common.messages import Message
from drive_id.types import FloatArray, Samples

if TYPE_CHECKING:  # a stored result is read without scipy
    from drive_id.core.full.effects.effect import Calibration
    from drive_id.core.maps.error_modes import ErrorModes
    from drive_id.core.maps.flux_map import FluxMap


@dataclass(frozen=True, kw_only=True)
class FitReport:
    """How well the data determine the model: by the method, and completed by what all methods share."""

    samples_read: int = 0  # in the recordings
    samples_used: int = 0  # in the regression: not those before a gap, beyond the map's range, or at rest
    gaps: int = 0  # interruptions within recordings; nothing is integrated across them
    rows: int = 0  # of the regression, two per pair of samples
    parameters: int = 0  # unknowns
    rank: int = 0  # how many of them the data determine
    unseen: int = 0  # flux parameters without any data (corner functions outside the disc)
    condition: float = np.inf  # condition number of the column-scaled regression within its rank
    residual_rms: float = np.nan  # of the mean voltage over a sample, V
    mad_d: float = np.nan  # mean absolute deviation of simulated (open-loop) from measured currents, A
    mad_q: float = np.nan  # A; both NaN when the simulation diverged
    coverage: float = np.nan  # share of the disc of radius i_max with data, 0 to 1
    warnings: tuple[Message, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Parameters:
    """What is estimated of a drive."""

    resistance: float  # the paper's R, which includes the linear part of the inverter's drop, ohm
    sigma_resistance: float  # its standard error, ohm; infinite when it cannot be estimated
    voltage_error: float  # u_e as a drop (positive for a physical inverter), V; 0 without a model of the inverter
    sigma_voltage_error: float  # its standard error, V
    inverter_current: FloatArray  # (C,), A
    inverter_voltage: FloatArray  # (C,), drop of one phase at these currents, V
    flux_map: FluxMap
    sigma_inverter_voltage: FloatArray | None = None  # (C,), V, where it was estimated for each current
    phase_voltages: FloatArray | None = None  # (C, 3), drop of each phase, V, when each has a curve of its own
    calibrations: tuple[Calibration, ...] = ()  # sensor faults and effects of the drive
    magnet_coefficient: tuple[float, float] | None = None
    """Change of the magnet's flux per kelvin and its standard error, Wb/K, when temperatures were given and differ."""
    statements: tuple[Message, ...] = ()
    """What fixed the unknowns that the data alone leave open, where data are missing, and what would help most."""
    error_modes: ErrorModes | None = None
    """Joint errors of fluxes, resistance and inverter curve; None in results without standard errors, or of versions
    that did not keep them."""

    def corrected(self, pieces: Sequence[Samples]) -> Sequence[Samples]:
        """Return recordings without the applied faults of sensors; the same ones if none was looked for."""
        if not self.calibrations:
            return pieces
        from drive_id.core.full.calibration import corrected  # noqa: PLC0415  # takes 0.1 s

        return [corrected(piece, self.calibrations) for piece in pieces]

    def by_name(self) -> dict[str, Any]:
        """Return the parameters alone, for another class that holds them."""
        return {entry.name: getattr(self, entry.name) for entry in fields(Parameters)}
