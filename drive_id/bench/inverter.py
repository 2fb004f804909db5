"""The inverter's voltage error: the laws as parameters of the one compiled :func:`drive_id.bench.kernels.phase_drop`.

The drop is what the inverter takes away, positive for positive current. Its defaults scale with the drive: a dead time
of 1 % of the switching period, capacitances charged above 1 % of the largest current, and devices of a threshold of
0.25 % and a resistive drop of 0.2 % of the DC-link voltage.

The part of a curve that is linear over the whole range cannot be told from the stator resistance by any experiment of
this kind. The ground truth keeps the true curve and the stator's true resistance apart; what compares an
identification with it has to do so up to R -> R + r, drop(i) -> drop(i) - r i.
"""

from __future__ import annotations

import numpy as np

from drive_id.bench.kernels import phase_drops
from drive_id.bench.parameters import PhaseDrop
from drive_id.bench.settings import SimulationSettings
from drive_id.types import FloatArray

_NODES = 601  # of the true curve
_SHARPEST = 1e-6  # of i_max: the charge current of a switching inverter without output capacitance


def phase_drop_of(settings: SimulationSettings, u_dc: float, i_max: float) -> PhaseDrop:
    """Return the parameters of the law chosen, for a DC-link voltage, V, and a largest current amplitude, A."""
    voltage = 0.01 * u_dc if settings.inverter_voltage is None else settings.inverter_voltage
    current = 0.01 * i_max if settings.inverter_current is None else settings.inverter_current
    threshold = 0.0025 * u_dc if settings.device_voltage is None else settings.device_voltage
    slope = 0.002 * u_dc / i_max if settings.device_resistance is None else settings.device_resistance
    if settings.inverter == "tanh":
        return PhaseDrop(0.0, 1.0, voltage, current, 0.0)
    if settings.inverter == "dead_time":
        return PhaseDrop(voltage, current, 0.0, 1.0, 0.0)
    if settings.inverter == "two_stage":
        return PhaseDrop(voltage, current, threshold, current, slope)
    if settings.inverter == "switching":  # the mean over a period, which the ripple of the currents smears
        lost = settings.dead_time / settings.sample_period * u_dc
        charge = settings.output_capacitance * u_dc / settings.dead_time if lost > 0 else 0.0
        return PhaseDrop(lost, max(charge, _SHARPEST * i_max), threshold, current, slope)
    return PhaseDrop(0.0, 1.0, 0.0, 1.0, 0.0)


def drop_curve(drop: PhaseDrop, i_max: float) -> tuple[FloatArray, FloatArray]:
    """Sample the curve over +-1.2 i_max, densely around zero: currents, A, and voltages, V, both (C,)."""
    current = 1.2 * i_max * np.linspace(-1.0, 1.0, _NODES) ** 3
    return current, phase_drops(drop, current)
