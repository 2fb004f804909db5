"""Options that only some formats need."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drive_id.errors import ConfigurationError


@dataclass(frozen=True)
class ExportOptions:
    """Options of single formats.

    Parameters
    ----------
    leakage_inductance : float
        L_sigma of the stator, H, which PLECS wants apart from the flux linkages of the air gap.
    bandwidth : float
        Of the current controllers for VESC, ODrive and C, Hz.
    sample_period : float, optional
        Of the current controllers, s, for C: the delay then limits the bandwidth.
    phase_margin : float
        Least margin with that delay, degrees.

    Raises
    ------
    ConfigurationError
        When a value is negative or not finite.
    """

    leakage_inductance: float = 0.0
    bandwidth: float = 160.0
    sample_period: float | None = None
    phase_margin: float = 60.0

    @property
    def rate(self) -> float:
        """The bandwidth, rad/s."""
        return 2 * math.pi * self.bandwidth

    def __post_init__(self) -> None:
        if not (math.isfinite(self.leakage_inductance) and self.leakage_inductance >= 0):
            raise ConfigurationError(f"--leakage is {self.leakage_inductance} H: it must not be negative.")
        if not (math.isfinite(self.bandwidth) and self.bandwidth > 0):
            raise ConfigurationError(f"--bandwidth is {self.bandwidth} Hz: it must be positive.")
        if self.sample_period is not None and not (math.isfinite(self.sample_period) and self.sample_period > 0):
            raise ConfigurationError(f"--sample-period is {self.sample_period} s: it must be positive.")
        if not 0 < self.phase_margin < 90:
            raise ConfigurationError(f"--phase-margin is {self.phase_margin} degrees: it must be between 0 and 90.")
