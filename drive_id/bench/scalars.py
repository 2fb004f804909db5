"""The optional signals that a simulated drive logs, and their rates."""

from __future__ import annotations

import numpy as np

from drive_id.bench.machine import Machine
from drive_id.bench.settings import SimulationSettings
from drive_id.types import SCALARS, FloatArray

SCALAR_SETTINGS = ("log_scalars", "scalar_rate", "temperature_rate")
_TEMPERATURE = 20.0  # degrees Celsius, of a drive that does not heat up


def logged_scalars(
    settings: SimulationSettings, machine: Machine, i_dq: FloatArray, angle: FloatArray
) -> dict[str, FloatArray]:
    """Return the optional signals of ``log_scalars`` at the samples, (N,) each.

    The torque is that of the fundamental machine, 3/2 p (psi_d i_q - psi_q i_d), without friction and inertia.

    Parameters
    ----------
    settings : SimulationSettings
    machine : Machine
    i_dq : (N, 2) float
        True currents in the true rotor frame, A.
    angle : (N,) float
        True electrical angle, rad.
    """
    found = {}
    for name in settings.log_scalars:
        if name == "dc_link_voltage":
            found[name] = np.full(len(i_dq), machine.u_dc)
        elif name == "shaft_torque":
            psi = machine.flux(i_dq[:, 0], i_dq[:, 1], angle)
            found[name] = 1.5 * machine.pole_pairs * (psi[:, 0] * i_dq[:, 1] - psi[:, 1] * i_dq[:, 0])
        else:
            found[name] = np.full(len(i_dq), _TEMPERATURE)
    return found


def scalar_strides(settings: SimulationSettings, sample_period: float) -> dict[str, int]:
    """Return for each optional signal every which sample, of a period in s, is logged."""
    rates = {name: settings.temperature_rate if "temperature" in name else settings.scalar_rate for name in SCALARS}
    return {name: max(1, round(1 / (rate * sample_period))) if rate else 1 for name, rate in rates.items()}
