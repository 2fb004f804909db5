"""Machines of every kind as analytic co-energies, with fluxes averaged over the rotor position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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


def mean_flux(machine, i_d, i_q):
    """Return psi_d and psi_q averaged over the rotor position; the harmonics cancel."""
    plain = replace(machine, harmonics=())
    return plain.flux(np.asarray(i_d, float), np.asarray(i_q, float), np.zeros(1))


def mean_torque(machine, i_d, i_q):
    psi_d, psi_q = mean_flux(machine, i_d, i_q)
    return 1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d)
