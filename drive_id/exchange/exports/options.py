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
        Of the current controllers for VESC and ODrive, rad/s.

    Raises
    ------
    ConfigurationError
        When a value is negative or not finite.
    """

    leakage_inductance: float = 0.0
    bandwidth: float = 1000.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.leakage_inductance) and self.leakage_inductance >= 0):
            raise ConfigurationError(f"--leakage is {self.leakage_inductance} H: it must not be negative.")
        if not (math.isfinite(self.bandwidth) and self.bandwidth > 0):
            raise ConfigurationError(f"--bandwidth is {self.bandwidth} rad/s: it must be positive.")
