from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exact_results import exact_result
from machine_kinds import KINDS, mean_flux, mean_torque

from drive_id.analysis.machine import MachineModel
from drive_id.analysis.trajectories import characteristic_current, mtpa, mtpv
from drive_id.bench.machines import CoEnergyMachine

LINEAR = CoEnergyMachine("linear", 0.1, 0.0, (1e-9, 1e-9), 1.0, (4e-3, 4e-3), (), 0.1, 3, 40.0, 300.0)


@pytest.fixture(scope="module", params=KINDS)
def known(request):
    machine = KINDS[request.param]
    return MachineModel.of(exact_result(machine.to_map())), machine


def test_mtpa_is_the_best_of_many_angles(known):
    model, machine = known
    found = mtpa(model, machine.i_max, 9)
    np.testing.assert_allclose(found.current, np.linspace(0, machine.i_max, 9))
    np.testing.assert_allclose(np.hypot(found.i_d, found.i_q), found.current, atol=1e-9)
    angle = np.linspace(0.0, np.pi, 40001)
    for k in range(1, 9):
        torque = mean_torque(machine, found.current[k] * np.cos(angle), found.current[k] * np.sin(angle))
        assert found.torque[k] == pytest.approx(torque.max(), rel=3e-4)
        mine = np.arctan2(found.i_q[k], found.i_d[k])
        assert mine == pytest.approx(angle[torque.argmax()], abs=np.deg2rad(0.2))
    assert found.inside.all()
    assert np.isnan(found.sigma_torque).all()


def test_the_most_negative_torque_is_its_mirror_image(known):
    model, machine = known
    motor, brake = mtpa(model, machine.i_max, 5), mtpa(model, machine.i_max, 5, sign=-1.0)
    np.testing.assert_allclose(brake.torque, -motor.torque, atol=1e-6 * motor.torque.max())
    np.testing.assert_allclose(brake.i_q, -motor.i_q, atol=1e-3 * machine.i_max)


def test_mtpv_has_the_largest_torque_of_all_currents_with_its_flux(known):
    model, machine = known
    found = mtpv(model, machine.i_max, 6)
    ring = np.linspace(0, np.pi, 721)
    radius = np.linspace(0, 1.3 * machine.i_max, 1041)
    i_d, i_q = radius[:, None] * np.cos(ring), radius[:, None] * np.sin(ring)
    flux, torque = np.hypot(*mean_flux(machine, i_d, i_q)), mean_torque(machine, i_d, i_q)
    smallest = np.hypot(*mean_flux(machine, *(machine.i_max * f(ring) for f in (np.cos, np.sin)))).min()
    if not len(found):  # no circle within the limit is tangent to a curve of constant flux
        assert characteristic_current(model)[0] > machine.i_max
        assert smallest == pytest.approx(np.hypot(*mean_flux(machine, -machine.i_max, 0.0))[0], rel=1e-6)
        return
    assert characteristic_current(model)[0] == pytest.approx(found.current[0], rel=2e-3, abs=1e-3 * machine.i_max)
    assert found.current[-1] == pytest.approx(machine.i_max)
    for k in range(1, len(found)):
        level = np.hypot(found.psi_d[k], found.psi_q[k])
        best = 0.0
        for column in range(len(ring)):  # all crossings of this flux along each ray
            below = np.flatnonzero(np.diff(np.sign(flux[:, column] - level)) != 0)
            for low in below:
                share = (level - flux[low, column]) / (flux[low + 1, column] - flux[low, column])
                best = max(best, torque[low, column] + share * (torque[low + 1, column] - torque[low, column]))
        assert found.torque[k] == pytest.approx(best, rel=2e-3)


def test_the_linear_machine_without_saliency_is_as_in_the_textbook():
    model = MachineModel.of(exact_result(LINEAR.to_map(), sigma=1e-4))
    short = 0.1 / 4e-3
    assert characteristic_current(model)[0] == pytest.approx(short)
    at_most, beyond = mtpa(model, 40.0, 7), mtpv(model, 40.0, 7)
    np.testing.assert_allclose(at_most.i_d, 0.0, atol=1e-3)
    np.testing.assert_allclose(at_most.torque, 1.5 * 3 * 0.1 * at_most.current, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(beyond.i_d, -short, rtol=1e-3)
    np.testing.assert_allclose(beyond.i_q, np.sqrt(np.maximum(beyond.current**2 - short**2, 0)), atol=0.05)


def test_points_beyond_the_data_are_marked():
    machine = KINDS["interior magnets"]
    result = exact_result(machine.to_map(), sigma=1e-5)
    grid = result.flux_map.grid()
    known = replace(result.flux_map, inside=np.hypot(grid[..., 0], grid[..., 1]) <= 220.0)
    model = MachineModel.of(replace(result, drive=replace(result.drive, flux_map=known)))
    found = mtpa(model, 300.0, 7)
    np.testing.assert_array_equal(found.inside, found.current < 205)
    np.testing.assert_array_equal(np.isfinite(found.sigma_torque), found.inside)
    assert np.isfinite(found.torque).all()
