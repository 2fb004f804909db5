"""MTPV against all currents of a fine grid: none gives more torque at the same flux."""

from __future__ import annotations

import numpy as np
import pytest
from exact_results import exact_result
from flashed_machines import AXIS, I_MAX, within

from drive_id.analysis.machine import MachineModel
from drive_id.analysis.trajectories import mtpv
from drive_id.types import MachineMap


@pytest.mark.parametrize(("at", "width", "height", "l_q"), [(-6.0, 0.5, 0.02, 8e-3), (-10.0, 1.0, 0.02, 12e-3)])
def test_no_other_current_gives_more_torque_at_the_same_flux(at, width, height, l_q):
    """Where a bridge saturates against the magnet, several currents of a circle have parallel gradients.

    The first of them gives away up to 0.3 of the torque; a coarse grid to choose among them gave away 6e-4.
    """
    d, q = np.meshgrid(AXIS, AXIS, indexing="ij")
    psi_d = 0.06 + 4e-3 * d + height * np.tanh((d - at) / width)
    machine = MachineMap("bridge in the magnet's way", AXIS, AXIS, psi_d, l_q * q, 0.45, 3, I_MAX, 320.0)
    model = MachineModel.of(within(exact_result(machine)))
    found = mtpv(model, I_MAX, 31)
    assert len(found) > 25
    i_d, i_q = np.meshgrid(np.linspace(-I_MAX, I_MAX, 801), np.linspace(0.0, I_MAX, 401))
    disc = np.hypot(i_d, i_q) <= I_MAX
    flux, torque = np.hypot(*model.psi_dq(i_d, i_q))[disc], model.torque(i_d, i_q)[disc]
    for psi_d, psi_q, ours in zip(found.psi_d, found.psi_q, found.torque, strict=True):
        assert torque[flux <= np.hypot(psi_d, psi_q)].max(initial=0.0) <= ours + 3e-4 * found.torque.max()
