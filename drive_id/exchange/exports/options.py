"""Options of an export."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drive_id.common.settings import Checked, setting
from drive_id.types import FloatArray


@dataclass(frozen=True, eq=False)
class ExportOptions(Checked):
    """Which table to write, and what single formats need besides."""

    i_d: FloatArray | None = None  # axes, A; None: 41 points from -i_max to i_max
    i_q: FloatArray | None = None
    filled: bool = setting(False, "whether to continue the map where there are no data")
    pole_pairs: int | None = setting(None, "instead of those of the result")
    u_dc: float | None = setting(None, "instead of that of the result", unit="V")
    leakage_inductance: float = setting(
        0.0, "L_sigma of the stator, which PLECS wants apart from the flux of the air gap", unit="H", minimum=0.0
    )
    bandwidth: float = setting(160.0, "of the current controllers for VESC, ODrive and C", unit="Hz", minimum=1e-6)
    sample_period: float | None = setting(
        None, "of the current controllers for C: the delay then limits the bandwidth", unit="s", minimum=1e-12
    )
    phase_margin: float = setting(
        60.0, "least phase margin with that delay", unit="degrees", minimum=1e-3, maximum=89.999
    )

    @property
    def rate(self) -> float:
        """The bandwidth, rad/s."""
        return 2 * math.pi * self.bandwidth
