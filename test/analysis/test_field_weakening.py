from __future__ import annotations

import numpy as np
import pytest
from exact_results import exact_result
from machine_kinds import KINDS, mean_flux, mean_torque

from drive_id.analysis.field_weakening import DriveLimits, corner_speed, envelope, references, top_speed
from drive_id.analysis.machine import MachineModel
from drive_id.analysis.operation import Operation
from drive_id.common.messages import Message
from drive_id.core.full.effects.effect import Calibration


def drop(i):
    return 3.0 * np.tanh(i / 2.0)


@pytest.fixture(scope="module", params=KINDS)
def known(request):
    machine = KINDS[request.param]
    limits = DriveLimits(machine.i_max, machine.u_dc / np.sqrt(3))
    return MachineModel.of(exact_result(machine.to_map(), drop=drop)), machine, limits


def voltage(machine, i_d, i_q, speed):
    """The steady voltage, with the fundamental of a drop that is nearly a step: 4/pi of its height."""
    psi_d, psi_q = mean_flux(machine, i_d, i_q)
    size = np.maximum(np.hypot(i_d, i_q), 1e-9)
    fundamental = 4 / np.pi * 3.0 * np.tanh(size)  # off by some 0.1 V near zero current only
    w = machine.pole_pairs * speed
    u_d = machine.resistance * i_d - w * psi_q + fundamental * i_d / size
    u_q = machine.resistance * i_q + w * psi_d + fundamental * i_q / size
    return np.hypot(u_d, u_q)


def plane(machine, sign=1.0, count=601):
    i_d, i_q = np.meshgrid(np.linspace(-1, 1, 2 * count - 1), sign * np.linspace(0, 1, count), indexing="ij")
    i_d, i_q = machine.i_max * i_d.ravel(), machine.i_max * i_q.ravel()
    kept = np.hypot(i_d, i_q) <= machine.i_max
    return i_d[kept], i_q[kept]


@pytest.mark.slow  # five machines, each against all currents of a grid
def test_no_current_within_the_limits_gives_more_torque(known):
    model, machine, limits = known
    sign = -1.0 if machine.i_max > 100 else 1.0
    corner = corner_speed(model, limits)
    speed = corner * np.array([0.0, 0.9, 1.15, 1.6, 2.1])
    found = envelope(model, limits, speed, sign=sign)
    assert (found.current <= limits.i_max * (1 + 1e-6)).all()
    assert (found.voltage <= limits.u_max * (1 + 1e-6)).all()
    i_d, i_q = plane(machine, sign)
    torque = sign * mean_torque(machine, i_d, i_q)
    largest = torque.max()
    for k, w in enumerate(speed):
        best = torque[voltage(machine, i_d, i_q, w) <= limits.u_max].max()
        assert sign * found.torque[k] == pytest.approx(best, abs=8e-3 * largest), w
        assert sign * found.torque[k] >= best - 1e-3 * largest


def test_up_to_the_corner_speed_the_torque_is_that_of_mtpa(known):
    model, _, limits = known
    corner = corner_speed(model, limits)
    found = envelope(model, limits, np.array([0.0, 0.999 * corner, corner, 1.05 * corner]))
    np.testing.assert_allclose(found.torque[:3], found.torque[0], rtol=1e-6)
    assert found.torque[3] < found.torque[0] * (1 - 1e-3)
    assert found.voltage[2] == pytest.approx(limits.u_max, rel=1e-4)
    assert limits.names(found)[:2].tolist() == ["current", "current"]
    assert limits.names(found)[3] in ("both", "voltage")  # MTPV begins soon in some


@pytest.mark.slow  # five machines, each against all currents of a grid
def test_references_give_the_torque_with_the_least_current(known):
    model, machine, limits = known
    corner = corner_speed(model, limits)
    speed = corner * np.array([0.3, 1.3, 1.8])
    ends = [envelope(model, limits, speed, sign=sign) for sign in (1.0, -1.0)]
    wanted = ends[0].torque[0] * np.array([-1.0, -0.45, 0.0, 0.3, 0.7])
    found = references(model, limits, wanted, *ends)
    reached = np.clip(wanted, ends[1].torque[:, None], ends[0].torque[:, None])
    np.testing.assert_allclose(found.torque, reached, atol=1e-5 * ends[0].torque[0])
    assert (found.current <= limits.i_max * (1 + 1e-6)).all()
    assert (found.voltage <= limits.u_max * (1 + 1e-6)).all()
    for column, goal in ((1, wanted[1]), (3, wanted[3])):
        i_d, i_q = plane(machine, np.sign(goal))
        enough = np.sign(goal) * mean_torque(machine, i_d, i_q) >= abs(goal)
        for k, w in enumerate(speed):
            allowed = enough & (voltage(machine, i_d, i_q, w) <= limits.u_max)
            if allowed.any():
                least = np.hypot(i_d, i_q)[allowed].min()
                assert found.current[k, column] <= least + 1e-3 * machine.i_max


def test_power_is_balanced_also_with_iron_loss():
    machine = KINDS["interior magnets"]
    losses = [
        ("iron_loss_conductance", 0.08, "S"),
        ("iron_loss_hysteresis", 20.0, "S rad/s"),
        ("iron_loss_current", 1.5, "A"),
    ]
    found = tuple(Calibration(name, value, 0.01, unit, True, Message.told("")) for name, value, unit in losses)
    model = MachineModel.of(exact_result(machine.to_map(), drop=drop, calibrations=found))
    limits = DriveLimits(machine.i_max, machine.u_dc / np.sqrt(3))
    i_dq = np.array([[-120.0, 180.0], [-200.0, -90.0], [-150.0, 0.0]])
    points = Operation.at(model, i_dq, np.array([300.0, 700.0, 900.0]))
    assert (points.iron > 10.0).all()
    lost = points.copper + points.iron + points.inverter
    np.testing.assert_allclose(points.power, points.mechanical + lost, rtol=1e-9)
    np.testing.assert_allclose(points.mechanical, points.torque * points.speed)
    # phase by phase over one turn, from the stator current and the induced voltage
    w = machine.pole_pairs * 700.0
    psi = np.array(mean_flux(machine, -200.0, -90.0)).ravel()
    e = w * np.array([-psi[1], psi[0]])
    taken = 0.08 + 20.0 / w + 1.5 / np.hypot(*e)
    np.testing.assert_allclose(points.stator[1] - i_dq[1], taken * e, rtol=1e-4)
    assert points.efficiency[0] == pytest.approx(points.mechanical[0] / points.power[0])
    assert points.efficiency[1] == pytest.approx(points.power[1] / points.mechanical[1])
    assert 0.8 < points.efficiency[0] < 1.0
    at_most = envelope(model, limits, np.array([600.0]))
    assert at_most.current[0] <= limits.i_max * (1 + 1e-6)  # of the stator
    table = references(
        model, limits, at_most.torque * [0.5], at_most, envelope(model, limits, np.array([600.0]), sign=-1.0)
    )
    around = np.linspace(-1, 1, 201) * 0.05 * limits.i_max
    tried = Operation.at(model, table.i_dq[0, 0] + np.stack(np.meshgrid(around, around), -1), np.array(600.0))
    allowed = (tried.torque >= table.torque[0, 0]) & (limits.broken(tried) == 0)
    assert table.current[0, 0] <= tried.current[allowed].min() + 1e-6 * limits.i_max


def test_a_machine_that_cannot_weaken_its_magnet_has_a_highest_speed():
    machine = KINDS["surface magnets"]
    model = MachineModel.of(exact_result(machine.to_map()))
    limits = DriveLimits(machine.i_max, machine.u_dc / np.sqrt(3))
    highest = top_speed(model, limits, 1e5)
    smallest = np.hypot(*mean_flux(machine, -machine.i_max, 0.0))[0]
    drop_of_r = machine.resistance * machine.i_max
    expected = np.sqrt(limits.u_max**2 - drop_of_r**2) / smallest / machine.pole_pairs
    assert highest == pytest.approx(expected, rel=0.02)
    beyond = envelope(model, limits, np.array([1.1 * expected]))
    assert np.isnan(beyond.torque).all()
    assert limits.names(beyond).tolist() == ["unreachable"]
