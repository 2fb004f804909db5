"""The optional signals that a simulated drive logs, and their rates."""

from __future__ import annotations

import numpy as np

from drive_id.bench.effects import Course
from drive_id.bench.machine import Machine
from drive_id.bench.settings import SimulationSettings
from drive_id.common.temperature import REFERENCE_TEMPERATURE
from drive_id.types import SCALARS, FloatArray

SCALAR_SETTINGS = ("log_scalars", "scalar_rate", "temperature_rate")


def logged_scalars(
    settings: SimulationSettings, machine: Machine, i_dq: FloatArray, angle: FloatArray, course: Course | None
) -> dict[str, FloatArray]:
    """Return the optional signals of ``log_scalars`` at the samples, (N,) each.

    The torque is that of the fundamental machine, 3/2 p (psi_d i_q - psi_q i_d), without friction and inertia.

    Parameters
    ----------
    i_dq : (N, 2) float
        True currents in the true rotor frame, A.
    angle : (N,) float
        True electrical angle, rad.
    course : (N,) recarray of dtype :data:`~drive_id.bench.effects.COURSE`, or None
        Inner quantities of a drive with effects; without, the machine stays at 20 degrees Celsius and its own voltage.
    """
    if course is None:
        u_dc, temperature = np.full(len(i_dq), machine.u_dc), np.full((len(i_dq), 2), REFERENCE_TEMPERATURE)
    else:
        i_dq, u_dc, temperature = course.i_dq_machine, course.u_dc, course.temperature
    found = {}
    for name in settings.log_scalars:
        if name == "dc_link_voltage":
            found[name] = u_dc
        elif name == "shaft_torque":
            psi = machine.flux(i_dq[:, 0], i_dq[:, 1], angle) if course is None else course.psi_dq
            found[name] = 1.5 * machine.pole_pairs * (psi[:, 0] * i_dq[:, 1] - psi[:, 1] * i_dq[:, 0])
        else:
            found[name] = temperature[:, int(name == "magnet_temperature")]
    return found


def scalar_strides(settings: SimulationSettings, sample_period: float) -> dict[str, int]:
    """Return for each optional signal every which sample, of a period in s, is logged."""
    rates = {name: settings.temperature_rate if "temperature" in name else settings.scalar_rate for name in SCALARS}
    return {name: max(1, round(1 / (rate * sample_period))) if rate else 1 for name, rate in rates.items()}
