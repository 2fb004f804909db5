"""Six machines for what is flashed and simulated: three kinds, two with sharp bridges, one whose map folds at zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from exact_results import exact_result
from exchange_machine import flux

from drive_id.fitting.simulated import load_machine
from drive_id.types import MachineMap

I_MAX = 15.0
AXIS = np.arange(-20.0, 20.01, 0.25)
BRIDGES = {"bridge": (0.6, 0.04), "sharper bridge": (0.4, 0.03)}  # width, A, and height, Wb
NAMES = ("ipm", "spm", "pmsyrm", *BRIDGES, "fold")


def drive(name):
    """Return the exact result of a machine, with data up to i_max."""
    if name in BRIDGES:
        return within(bridged(*BRIDGES[name]))
    if name == "fold":
        return within(folding())
    machine = replace(load_machine(name), theta=None, psi_d_theta=None, psi_q_theta=None)
    return within(exact_result(machine))


def bridged(width=0.6, height=0.04):
    """Return a machine whose bridges saturate within a fraction of a table's step."""
    d, q = np.meshgrid(AXIS, AXIS, indexing="ij")
    psi = 0.05 + 4e-3 * d + 0.3 * height * np.tanh(d / width), 8e-3 * q + height * np.tanh(q / width)
    return exact_result(MachineMap("bridged", AXIS, AXIS, *psi, 0.45, 3, I_MAX, 320.0))


def folding(step=0.5, height=0.06, width=0.5):
    """Return a map whose psi_q falls with i_q next to zero, as if a drop of the inverter had been left in it."""
    axis = np.arange(-20.0, 20.01, step)
    d, q = np.meshgrid(axis, axis, indexing="ij")
    psi_d, psi_q = flux(d, q)
    psi_q = psi_q - height * np.tanh(q / width)
    return exact_result(MachineMap("folds", axis, axis, psi_d, psi_q, 0.45, 3, I_MAX, 320.0))


def within(found):
    """Return a result without data beyond i_max."""
    m = found.flux_map
    inside = np.hypot(m.i_d[:, None], m.i_q) <= 1.01 * found.i_max
    return replace(found, drive=replace(found.drive, flux_map=replace(m, inside=inside)))
