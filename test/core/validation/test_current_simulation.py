"""The open-loop simulation with rotor harmonics and an inverter curve, against the simulated drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from drive_bags import TRAJECTORY
from exact_results import exact_map
from scipy.integrate import solve_ivp

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.maps.flux_map import HarmonicMap
from drive_id.core.validation import current_simulation
from drive_id.core.validation.current_simulation import simulate_current
from drive_id.fitting.simulated import run_experiment

ORDERS = (6, 12)


def experiment(name, rpm, seconds=0.5, **settings):
    return run_experiment(machine_map(name), SimulationSettings(speeds=(rpm,), **settings), TRAJECTORY, seconds=seconds)


def true_model(machine, orders=ORDERS, count=40, nodes=48):
    """Return the map whose harmonics are the true map's Fourier coefficients over the rotor position."""
    axis = np.linspace(-1.15 * machine.i_max, 1.15 * machine.i_max, count)
    theta = 2 * np.pi / 6 * np.arange(nodes) / nodes
    spectrum = np.fft.rfft(machine.flux(axis[:, None, None], axis[:, None], theta), axis=2) / nodes
    waves = [HarmonicMap.of(h, 2 * spectrum[:, :, h // 6].real, -2 * spectrum[:, :, h // 6].imag) for h in orders]
    return exact_map(axis, axis, spectrum[:, :, 0].real, harmonics=tuple(waves))


def simulated(simulation, samples=None, **model):
    truth = simulation.truth
    current = np.linspace(-1.2 * truth.i_max, 1.2 * truth.i_max, 40001)
    return simulate_current(
        simulation.samples if samples is None else samples,
        true_model(simulation.machine, **model),
        truth.resistance,
        (current, np.interp(current, truth.inverter_current, truth.inverter_voltage)),
    )


@pytest.mark.cases
@pytest.mark.parametrize(("name", "rpm"), [("ipm", 500.0), ("spm", 3000.0), ("pmsyrm", -700.0)])
def test_the_true_model_gives_the_measured_current(name, rpm):
    simulation = experiment(name, rpm)
    error = np.abs(simulated(simulation) - simulation.i_dq_true).mean(axis=0) / simulation.machine.i_max
    assert error.max() < 1e-5
    without = simulated(simulation, orders=()) - simulation.i_dq_true
    assert np.abs(without).mean(axis=0).min() / simulation.machine.i_max > 1e-3


def test_without_harmonics_it_solves_the_papers_equation():
    """Against an adaptive solver, in the paper's form: currents in the rotor frame, and an exact tanh."""
    axis, speed, period, scale = np.linspace(-350.0, 350.0, 8), 600.0, 1e-4, 30.0
    flux_map = exact_map(axis, axis, synthetic.saturating_flux(np.stack(np.meshgrid(axis, axis, indexing="ij"), -1)))
    samples = synthetic.record(speed=speed, duration=0.02)
    u_s = frames.space_vector(samples.u_abc)

    def slope(t, i, k, start):
        turn = np.exp(1j * speed * (start + t))
        drop = frames.space_vector(4 * np.tanh(frames.phases(np.array([complex(*i) * turn])) / scale))[0]
        psi = complex(*flux_map.continued(i))
        right = (u_s[k] - drop) * np.conj(turn) - 0.02 * complex(*i) - 1j * speed * psi
        return np.linalg.solve(flux_map.inductances(*i), [right.real, right.imag])

    expected = [frames.to_dq(samples.i_abc, samples.angle)[0]]
    for k in range(len(samples) - 1):
        step = solve_ivp(slope, (0, period), expected[-1], "DOP853", args=(k, k * period), rtol=1e-10, atol=1e-9)
        expected.append(step.y[:, -1])
    x = np.linspace(-10, 10, 4001)
    found = simulate_current(samples, flux_map, 0.02, (scale * x, 4 * np.tanh(x)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)


def test_each_run_starts_at_its_first_sample():
    simulation = experiment("ipm", 500.0, seconds=0.2)
    samples = replace(simulation.samples, run_starts=np.array([0, 1, 1000]))
    whole = simulated(simulation, samples)
    np.testing.assert_allclose(whole[[0, 1, 1000]], simulation.i_dq_true[[0, 1, 1000]], rtol=0, atol=1e-9)
    assert np.abs(whole - simulation.i_dq_true).max() < 0.1


def test_a_model_that_gains_energy_is_told_to_have_diverged():
    simulation = experiment("ipm", 500.0)
    drop = np.array([-1.0, 1.0]), np.array([0.0, 0.0])
    found = simulate_current(simulation.samples, true_model(simulation.machine), -0.3, drop)
    assert np.isnan(found[-1]).all()
    assert np.isfinite(found[0]).all()


def test_noise_and_steps_of_the_resolver_do_not_drive_the_current():
    simulation = experiment("spm", 1000.0)
    step = 2 * np.pi / 4096 * 3
    samples = replace(simulation.samples, angle=step * np.round(simulation.samples.angle / step))
    error = np.abs(simulated(simulation, samples) - simulation.i_dq_true).mean(axis=0) / simulation.machine.i_max
    assert error.max() < 1e-3
    clean = current_simulation._smooth_angle(simulation.samples.angle, simulation.samples.speed, 1e-4)
    np.testing.assert_allclose(np.diff(clean), 1e-4 * simulation.samples.speed[:-1], rtol=1e-6)
    np.testing.assert_allclose(np.exp(1j * clean), np.exp(1j * simulation.samples.angle), rtol=0, atol=1e-9)


def test_the_map_at_an_angle_is_the_sum_of_its_parts():
    random, own = np.random.default_rng(3), (np.linspace(-10, 12, 8), np.linspace(-9, 9, 7))
    mean, *parts = random.normal(size=(5, 8, 7, 2))
    waves = HarmonicMap.of(6, *parts[:2]), HarmonicMap.of(18, *parts[2:])
    flux_map = exact_map(*own, mean, harmonics=waves)
    axes, table = current_simulation.flux_table(flux_map)
    here, point = np.zeros(33 + 2 * 2), np.empty(8)
    for theta in (0.3, -4.0):
        current_simulation.turn_to(theta, np.array([6.0, 18.0]), here)
        shares = [np.cos(6 * theta), np.sin(6 * theta), np.cos(18 * theta), np.sin(18 * theta)]
        total = exact_map(*own, mean + np.tensordot(shares, parts, 1))
        for i in random.uniform(-14, 14, (30, 2)):
            inside = np.clip(i, [-10, -9], [12, 9])
            psi = total.continued(inside) + flux_map.typical_inductances * (i - inside)
            current_simulation.evaluate(*i, here, axes, table, point)
            np.testing.assert_allclose(point[2:4], psi, rtol=0, atol=1e-12)


def test_the_drop_is_interpolated_and_constant_beyond():
    x, y = np.linspace(-5.0, 7.0, 5), np.array([-2.0, -1.5, 0.0, 1.0, 3.0])
    curve = np.array([x[0], x[1] - x[0], *y])
    for i in (-9.0, -5.0, -3.0, -2.0, -1.0, 0.05, 0.1, 6.9, 7.0, 8.0):
        for i_abc in np.array([[[i, -0.7 * i, -0.3 * i]], [[-0.3 * i, i, -0.7 * i]]]):
            i_s = frames.space_vector(i_abc)[0]
            expected = frames.space_vector(0.5 * i_abc + np.interp(i_abc, x, y))[0]
            assert complex(*current_simulation.loss(i_s.real, i_s.imag, 0.5, curve)) == pytest.approx(
                expected, abs=1e-13
            )
