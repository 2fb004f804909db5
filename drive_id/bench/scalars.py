"""The optional signals that a simulated drive logs, and their rates."""

from __future__ import annotations

import numpy as np

from drive_id.bench.machine import Machine
from drive_id.bench.settings import SimulationSettings
from drive_id.temperature import REFERENCE_TEMPERATURE
from drive_id.types import SCALARS, FloatArray

SCALAR_SETTINGS = ("log_scalars", "scalar_rate", "temperature_rate")


def logged_scalars(
    settings: SimulationSettings,
    machine: Machine,
    i_dq: FloatArray,
    angle: FloatArray,
    *,
    psi_dq: FloatArray | None = None,
    u_dc: FloatArray | None = None,
    temperature: FloatArray | None = None,
) -> dict[str, FloatArray]:
    """Return the optional signals of ``log_scalars`` at the samples, (N,) each.

    The torque is that of the fundamental machine, 3/2 p (psi_d i_q - psi_q i_d), without friction and inertia.

    Parameters
    ----------
    i_dq : (N, 2) float
        True currents in the true rotor frame, A.
    angle : (N,) float
        True electrical angle, rad.
    psi_dq : (N, 2) float, optional
        Flux linkages, Wb. Default: those of the machine at these currents.
    u_dc : (N,) float, optional
        DC-link voltage, V. Default: that of the machine.
    temperature : (N, 2) float, optional
        Of winding and magnet, degrees Celsius. Default: 20.
    """
    if temperature is None:
        temperature = np.full((len(i_dq), 2), REFERENCE_TEMPERATURE)
    found = {}
    for name in settings.log_scalars:
        if name == "dc_link_voltage":
            found[name] = np.full(len(i_dq), machine.u_dc) if u_dc is None else u_dc
        elif name == "shaft_torque":
            psi = machine.flux(i_dq[:, 0], i_dq[:, 1], angle) if psi_dq is None else psi_dq
            found[name] = 1.5 * machine.pole_pairs * (psi[:, 0] * i_dq[:, 1] - psi[:, 1] * i_dq[:, 0])
        else:
            found[name] = temperature[:, int(name == "magnet_temperature")]
    return found


def scalar_strides(settings: SimulationSettings, sample_period: float) -> dict[str, int]:
    """Return for each optional signal every which sample, of a period in s, is logged."""
    rates = {name: settings.temperature_rate if "temperature" in name else settings.scalar_rate for name in SCALARS}
    return {name: max(1, round(1 / (rate * sample_period))) if rate else 1 for name, rate in rates.items()}
