"""MTPV against the procedure of other tools: the largest torque on contours of the flux over a grid of currents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from exact_results import exact_result
from flashed_machines import AXIS, I_MAX, within
from machine_kinds import KINDS

from drive_id.analysis.machine import MachineModel
from drive_id.analysis.trajectories import mtpv
from drive_id.types import MachineMap


@pytest.fixture
def grid_locus(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    from analysis import grid_locus

    return grid_locus


def test_torque_at_equal_flux_is_that_on_contours_of_a_grid(grid_locus):
    """At equal current it is so only on a fine grid, to whose lines the points snap."""
    machine = KINDS["reluctance with magnets"]
    model = MachineModel.of(exact_result(machine.to_map()))
    ours = mtpv(model, 40.0, 401)
    flux = np.hypot(ours.psi_d, ours.psi_q)
    levels = np.linspace(flux[40], flux[-20], 12)
    apart = []
    for points, tolerance in ((81, 5e-3), (641, 3e-4)):
        found = grid_locus(model, np.linspace(-40.0, 40.0, points), np.linspace(0.0, 40.0, points), levels)
        assert np.interp(levels, flux, ours.torque) == pytest.approx(found[:, 2], rel=tolerance)
        at_current = np.interp(np.hypot(found[:, 0], found[:, 1]), ours.current, ours.torque)
        apart.append(np.abs(at_current / found[:, 2] - 1).max())
    assert apart[0] > 2 * apart[1]  # by the step of the grid, up to where on it the points fall


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
