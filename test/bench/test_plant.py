"""The plant against independent integrators, and the balance of its voltages."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import RectBivariateSpline

from drive_id.bench.drive import Drive, build_machine
from drive_id.bench.machines import MACHINES, machine_map
from drive_id.bench.parameters import DriveState
from drive_id.bench.real_drive import integrate
from drive_id.bench.settings import SimulationSettings

T = 1e-4
PHASES = 2 * np.pi / 3 * np.arange(3)


def reference(i_max: float, count: int) -> np.ndarray:
    t = np.arange(count) * T
    q = np.sin(2 * np.pi * 13 * t)
    return i_max * np.stack((np.cos(2 * np.pi * 13 * t) * np.sin(2 * np.pi * 7 * t), q), axis=-1)


def dead_time(i: np.ndarray, voltage: float, charge: float) -> np.ndarray:
    x = np.abs(i) / charge
    return voltage * np.sign(i) * np.where(x < 1, x / 2, 1 - 0.5 / np.maximum(x, 1))


def oracle(flux_and_slopes, drop, resistance, speed, angle, u_abc, i_dq):
    """Integrate di/dt = L^-1 (u - R i - drop - omega J f - omega df/dtheta) in the rotor frame, period by period."""
    out = []
    for u in u_abc:

        def rate(t, i, theta_0=angle, u=u):
            theta = theta_0 + speed * t
            c, s = np.cos(theta - PHASES), np.sin(theta - PHASES)
            phase = c * i[0] - s * i[1]
            v = u - drop(phase)
            f, by_i, by_theta = flux_and_slopes(i[0], i[1], theta)
            turning = speed * np.array([-f[1], f[0]]) + speed * by_theta
            return np.linalg.solve(by_i, np.array([2 / 3 * c @ v, -2 / 3 * s @ v]) - resistance * i - turning)

        i_dq = solve_ivp(rate, (0, T), i_dq, method="DOP853", rtol=1e-11, atol=1e-11, max_step=T / 10).y[:, -1]
        angle += speed * T
        out.append(i_dq)
    return np.array(out)


def test_flat_machine_matches_a_high_order_integrator():
    source = machine_map("pmsyrm")
    settings = SimulationSettings(speeds=(1500.0,), harmonics=0.0)
    splines = [RectBivariateSpline(source.i_d, source.i_q, psi) for psi in (source.psi_d, source.psi_q)]

    def flux_and_slopes(i_d, i_q, _theta):
        f = np.array([s.ev(i_d, i_q) for s in splines])
        return f, np.array([[s.ev(i_d, i_q, dx=1), s.ev(i_d, i_q, dy=1)] for s in splines]), np.zeros(2)

    compare_with_oracle(source, settings, flux_and_slopes, 2e-8)


@pytest.mark.accuracy
def test_turning_machine_matches_the_analytic_one():
    source = machine_map("ipm")
    analytic = MACHINES["ipm"]

    def flux(i_d, i_q, theta):
        return np.array(analytic.flux(i_d, i_q, theta))

    def flux_and_slopes(i_d, i_q, theta):
        by_d = (flux(i_d + 0.05, i_q, theta) - flux(i_d - 0.05, i_q, theta)) / 0.1
        by_q = (flux(i_d, i_q + 0.05, theta) - flux(i_d, i_q - 0.05, theta)) / 0.1
        by_theta = (flux(i_d, i_q, theta + 1e-4) - flux(i_d, i_q, theta - 1e-4)) / 2e-4
        return flux(i_d, i_q, theta), np.stack((by_d, by_q), axis=-1), by_theta

    compare_with_oracle(source, SimulationSettings(speeds=(1000.0,)), flux_and_slopes, 2e-5)


def compare_with_oracle(source, settings, flux_and_slopes, tolerance):
    count = 60  # two electrical periods and more
    machine = build_machine(source, settings)
    i_ref = reference(machine.i_max, 400)[300:]
    drive = Drive(machine, settings, i_dq_start=tuple(i_ref[0]))
    block = drive.step_block(i_ref)
    speed = settings.speeds[0] * np.pi / 30 * machine.pole_pairs
    voltage, charge = 0.01 * machine.u_dc, 0.01 * machine.i_max
    expected = oracle(
        flux_and_slopes,
        lambda i: dead_time(i, voltage, charge),
        machine.resistance,
        speed,
        block.angle_true[0],
        block.samples.u_abc[:count],
        block.i_dq_true[0],
    )
    assert np.ptp(block.i_dq_true[:count], axis=0).max() > 0.1 * machine.i_max
    np.testing.assert_allclose(block.i_dq_true[1 : count + 1], expected, rtol=0, atol=tolerance * machine.i_max)


def replay(drive: Drive, state: DriveState, u_abc: np.ndarray, speed: float, parts: int, substeps: int) -> np.ndarray:
    """Repeat the plant's way under logged voltages in ``parts`` per period: (N * parts + 1, 4) of flux and current."""
    effects, more = drive._effects.copy(), drive._more.copy()
    effects.largest_step = T / substeps
    state = DriveState(*(x.copy() for x in state))
    rows = [np.concatenate((state.flux, state.current))]
    edges = np.linspace(0, T, parts + 1)
    for u in u_abc:
        u_ab = (u @ np.cos(PHASES) * 2 / 3, u @ np.sin(PHASES) * 2 / 3)
        more.motion[:] = 0.0, state.mean_angle[0], speed, 0.0
        for start, stop in pairwise(edges):
            assert integrate(drive._plant, effects, state, more, u_ab, (start, stop))
            rows.append(np.concatenate((state.flux, state.current)))
        state.mean_angle[0] += speed * T
    return np.array(rows)


@pytest.mark.parametrize("inverter", ["none", "tanh", "dead_time", "two_stage"])
@pytest.mark.parametrize("rpm", [500.0, -3000.0])
def test_halving_the_step_changes_nothing(inverter, rpm):
    settings = SimulationSettings(speeds=(rpm,), inverter=inverter)
    machine = build_machine(machine_map("ipm"), settings)
    i_ref = reference(machine.i_max, 1000)
    drive = Drive(machine, settings, i_dq_start=tuple(i_ref[0]))
    drive.step_block(i_ref[:500])
    state = DriveState(*(x.copy() for x in drive._state))
    u_abc = drive.step_block(i_ref[500:]).samples.u_abc
    speed = rpm * np.pi / 30 * machine.pole_pairs
    coarse, fine = (replay(drive, state, u_abc, speed, 1, n)[:, :2] for n in (2, 4))
    assert np.abs(coarse - fine).max() < 1e-7 * np.abs(fine).max()


def test_voltages_balance_over_every_sample():
    """psi(t+T) - psi(t) = T u - integral of R i + drop, the integral by fine trapezoids of the plant's currents."""
    settings = SimulationSettings(speeds=(500.0,), inverter="tanh", inverter_current=30.0)
    machine = build_machine(machine_map("ipm"), settings)
    i_ref = reference(machine.i_max, 500)
    drive = Drive(machine, settings, i_dq_start=tuple(i_ref[0]))
    state = DriveState(*(x.copy() for x in drive._state))
    block = drive.step_block(i_ref)
    speed = 500 * np.pi / 30 * machine.pole_pairs
    parts = 40
    fine = replay(drive, state, block.samples.u_abc, speed, parts, 2)
    np.testing.assert_allclose(fine[:-1:parts, 2:], block.i_dq_true, rtol=0, atol=1e-5)
    time = np.arange(len(fine)) * T / parts
    theta = block.angle_true[0] + speed * time
    i_abc = np.cos(theta[:, None] - PHASES) * fine[:, 2:3] - np.sin(theta[:, None] - PHASES) * fine[:, 3:]
    taken = machine.resistance * i_abc + 4.0 * np.tanh(i_abc / 30.0)
    integral = np.stack([x[:-1] + x[1:] for x in taken.T], axis=-1).reshape(len(i_ref), parts, 3).sum(axis=1) / 2
    clarke = 2 / 3 * np.stack((np.cos(PHASES), np.sin(PHASES)))
    expected = (T * block.samples.u_abc - T / parts * integral) @ clarke.T
    steps = np.diff(fine[::parts, :2], axis=0)
    np.testing.assert_allclose(steps, expected, rtol=0, atol=1e-6 * np.abs(steps).max())
    psi = machine.flux(fine[:, 2], fine[:, 3], theta)
    turned = (psi[:, 0] + 1j * psi[:, 1]) * np.exp(1j * theta)
    np.testing.assert_allclose(turned, fine[:, 0] + 1j * fine[:, 1], rtol=0, atol=1e-11)


def test_without_resistance_and_inverter_the_balance_is_exact():
    source = dataclasses.replace(machine_map("spm"), resistance=0.0)
    settings = SimulationSettings(speeds=(700.0,), inverter="none", speed_ripple=0.05)
    machine = build_machine(source, settings)
    block = Drive(machine, settings).step_block(reference(machine.i_max, 300))
    psi = machine.flux(block.i_dq_true[:, 0], block.i_dq_true[:, 1], block.angle_true)
    turned = (psi[:, 0] + 1j * psi[:, 1]) * np.exp(1j * block.angle_true)
    steps = T * 2 / 3 * (block.samples.u_abc @ np.exp(1j * PHASES))
    np.testing.assert_allclose(np.diff(turned), steps[:-1], rtol=0, atol=1e-12)
