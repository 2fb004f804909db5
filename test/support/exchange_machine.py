"""A machine with known maps for files of other tools: reciprocal, monotone, and not symmetric about any axis."""

from __future__ import annotations

import numpy as np
from exact_results import exact_result

from drive_id.types import MachineMap

I_D = np.arange(-20.0, 15.1, 2.5)
I_Q = np.arange(-18.0, 18.1, 1.5)
PAIRS, RESISTANCE, I_MAX, U_DC = 3, 0.45, 15.0, 320.0
AT = (np.array([-12.5, -7.5, 5.0, 10.0]), np.array([6.0, -9.0, 12.0, -4.5]))
"""Grid points without any symmetry among them."""


def flux(i_d, i_q, skew=2e-4):
    """Return psi_d, psi_q, Wb, gradients of a co-energy; ``skew`` breaks the symmetry about the d axis."""
    i_d, i_q = np.broadcast_arrays(np.asarray(i_d, float), np.asarray(i_q, float))
    s = np.sqrt(1 + (i_d / 20) ** 2 + (i_q / 6) ** 2)
    return 0.1 + 0.0075 * i_d / s + 0.002 * i_d + skew * i_q, 3 / 36 * i_q / s + 0.003 * i_q + skew * i_d


def torque(i_d, i_q, skew=2e-4):
    psi_d, psi_q = flux(i_d, i_q, skew)
    return 1.5 * PAIRS * (psi_d * i_q - psi_q * i_d)


def grids(i_d=I_D, i_q=I_Q):
    return np.meshgrid(i_d, i_q, indexing="ij")


def result(sigma=1e-4, **changes):
    """Return this machine as a result, with standard errors of 0.1 mWb."""
    psi_d, psi_q = flux(*grids())
    machine = MachineMap("lopsided", I_D, I_Q, psi_d, psi_q, RESISTANCE, PAIRS, I_MAX, U_DC)
    return exact_result(machine, sigma=sigma, **changes)
