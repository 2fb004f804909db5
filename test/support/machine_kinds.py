"""Machines of every kind as analytic co-energies, with fluxes averaged over the rotor position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drive_id.bench.kernels import evaluate_many
from drive_id.bench.machines import MACHINES, CoEnergyMachine

KINDS = {
    "interior magnets": MACHINES["ipm"],
    "surface magnets": MACHINES["spm"],
    "reluctance with magnets": MACHINES["pmsyrm"],
    "reluctance": replace(MACHINES["pmsyrm"], magnet_flux=0.0, magnet_current=0.0),
    "reluctance, d of largest inductance": CoEnergyMachine(
        "synrm", 0.0, 0.0, (45e-3, 6e-3), 8.0, (2.5e-3, 3e-3), (), 0.3, 2, 40.0, 540.0
    ),
}


def co_energy(machine, i_d, i_q, theta):
    """Return W, J, of an analytic machine, as :mod:`drive_id.bench.machines` prints it."""
    b = machine.saturation_current
    a = b * np.sqrt(machine.main_inductance[1] / machine.main_inductance[0])
    energy, (linear_d, linear_q) = machine.main_inductance[1] * b**2, machine.linear_inductance
    x, y = (i_d + machine.magnet_current) / a, i_q / b
    s = np.sqrt(1 + x**2 + y**2)
    w = energy * (s - 1) + machine.magnet_flux * i_d + 0.5 * linear_d * i_d**2 + 0.5 * linear_q * i_q**2
    for h, k, m in machine.harmonics:
        w = w + energy * (k * s * np.cos(h * theta) + m * x * y / s * np.sin(h * theta))
    return w


def inductances(machine, i_d, i_q, theta):
    """Return the incremental inductances (..., 2, 2), H, of a machine of splines."""
    i_d, i_q, theta = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (i_d, i_q, theta)))
    values = evaluate_many(machine.table, i_d.ravel(), i_q.ravel(), theta.ravel())
    return values[:, 2:].reshape(*i_d.shape, 2, 2)


def mean_flux(machine, i_d, i_q):
    """Return psi_d and psi_q averaged over the rotor position; the harmonics cancel."""
    plain = replace(machine, harmonics=())
    return plain.flux(np.asarray(i_d, float), np.asarray(i_q, float), np.zeros(1))


def mean_torque(machine, i_d, i_q):
    psi_d, psi_q = mean_flux(machine, i_d, i_q)
    return 1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d)
