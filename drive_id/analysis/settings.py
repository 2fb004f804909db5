"""Settings of an analysis: the one source for files and the command line."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.common.settings import Checked, setting
from drive_id.common.temperature import COLDEST, HOTTEST

_SIX_STEP = 1.1027
"""Fundamental of six-step operation, 2/pi u_dc, over the largest sinusoidal voltage, u_dc / sqrt(3), rounded up."""


@dataclass(frozen=True)
class AnalysisSettings(Checked):
    """Settings of an analysis."""

    u_dc: tuple[float, ...] = setting(
        (), "DC-link voltages of the tables over speed; default: that of the result", unit="V", minimum=1e-3
    )
    i_max: float | None = setting(
        None, "largest amplitude of the current; default: the current disc of the experiment", unit="A", minimum=1e-6
    )
    speed: float | None = setting(
        None,
        "highest mechanical speed of the tables; default: four times the corner speed, or the highest possible",
        unit="rpm",
        minimum=1e-3,
    )
    temperature: float | None = setting(
        None, "of the winding; default: that of the experiment", unit="degC", minimum=COLDEST, maximum=HOTTEST
    )
    magnet_temperature: float | None = setting(
        None, "of the magnets; default: that of the winding", unit="degC", minimum=COLDEST, maximum=HOTTEST
    )
    bandwidth: float = setting(500.0, "of the current controllers", unit="Hz", minimum=1e-3)
    modulation: float = setting(
        1.0,
        "usable share of the largest sinusoidal voltage, u_dc / sqrt(3); six-step operation reaches 1.1027",
        minimum=0.01,
        maximum=_SIX_STEP,
    )
    pole_pairs: int | None = setting(None, "number of pole pairs; default: that of the result", minimum=1, maximum=1000)
    current_points: int = setting(41, "points of the current trajectories", minimum=3, maximum=1001)
    torque_points: int = setting(
        10, "torques on each side of zero in the field-weakening table", minimum=1, maximum=200
    )
    speed_points: int = setting(31, "speeds of the tables", minimum=3, maximum=1001)
