"""MTPV against the procedure of other tools: the largest torque on contours of the flux over a grid of currents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from exact_results import exact_result
from machine_kinds import KINDS

from drive_id.analysis.machine import MachineModel
from drive_id.analysis.trajectories import mtpv


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
