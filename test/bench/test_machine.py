"""The machines: splines against scipy, fluxes against their co-energy, truth against the average over the rotor."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from machine_kinds import co_energy, inductances
from scipy.interpolate import RectBivariateSpline, RegularGridInterpolator, make_interp_spline

from drive_id.bench.machine import Machine, default_amplitude
from drive_id.bench.machines import MACHINES, machine_map
from drive_id.bench.splines import extend, interpolate, interpolate_periodic
from drive_id.errors import ConfigurationError
from drive_id.types import MachineMap

NAMES = tuple(MACHINES)


def simple_map(i_d: np.ndarray, i_q: np.ndarray, i_max: float = 9.0) -> MachineMap:
    d, q = i_d[:, None], i_q[None, :]
    s = np.sqrt(1 + (d / 7) ** 2 + (q / 5) ** 2)
    return MachineMap("simple", i_d, i_q, 0.1 + 0.02 * d / s, 0.05 * q / s, 0.1, 2, i_max, 100.0)


def points(i_max: float, count: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.uniform(-i_max, i_max, count), rng.uniform(-i_max, i_max, count), rng.uniform(-9, 9, count)


def test_interpolation_is_scipys_not_a_knot_spline():
    values = np.random.default_rng(1).normal(size=11)
    spline = make_interp_spline(np.arange(11.0), values, k=3)
    c = interpolate(values, 0)
    nodes = np.arange(11)
    np.testing.assert_allclose((c[:-2] + 4 * c[1:-1] + c[2:])[nodes] / 6, values, atol=1e-13)
    np.testing.assert_allclose((c[2:] - c[:-2]) / 2, spline(nodes, nu=1), atol=1e-12)


def test_periodic_interpolation_hits_its_samples_and_closes():
    values = np.random.default_rng(2).normal(size=(3, 10))
    c = interpolate_periodic(values)
    np.testing.assert_allclose((c[:, :10] + 4 * c[:, 1:11] + c[:, 2:12]) / 6, values, atol=1e-14)
    np.testing.assert_array_equal(c[:, -3:], c[:, :3])


def test_extension_is_a_straight_line():
    c = extend(np.array([[1.0, 4.0], [3.0, 4.5], [4.0, 6.0]]), 0, 2)
    np.testing.assert_array_equal(c[:, 0], [-3, -1, 1, 3, 4, 5, 6])


def test_flat_machine_is_scipys_bivariate_spline():
    i_d, i_q = np.linspace(-10, 10, 21), np.linspace(-12, 12, 17)
    source = simple_map(i_d, i_q)
    machine = Machine.from_map(source)
    d, q, theta = points(9.9)
    inductance = inductances(machine, d, q, theta)
    for k, psi in enumerate((source.psi_d, source.psi_q)):
        oracle = RectBivariateSpline(i_d, i_q, psi)
        np.testing.assert_allclose(machine.flux(d, q, theta)[:, k], oracle.ev(d, q), atol=1e-14)
        np.testing.assert_allclose(inductance[:, k, 0], oracle.ev(d, q, dx=1), atol=1e-14)
        np.testing.assert_allclose(inductance[:, k, 1], oracle.ev(d, q, dy=1), atol=1e-14)


def test_turning_machine_is_a_tensor_spline():
    flat = simple_map(np.linspace(-10, 10, 9), np.linspace(-12, 12, 7))
    theta = 0.1 + np.arange(8) * (np.pi / 3 / 8)
    noise = 0.01 * np.random.default_rng(3).normal(size=(9, 7, 8))
    turning = dataclasses.replace(
        flat, theta=theta, psi_d_theta=flat.psi_d[..., None] + noise, psi_q_theta=flat.psi_q[..., None] - noise
    )
    machine = Machine.from_map(turning)
    closed = np.concatenate((turning.psi_q_theta, turning.psi_q_theta[..., :1]), axis=2)
    along = make_interp_spline(np.append(theta, 0.1 + np.pi / 3), closed, k=3, axis=2, bc_type="periodic")
    for d, q, angle in np.transpose(points(9.9, 40)):
        sheet = along(0.1 + (angle - 0.1) % (np.pi / 3))
        oracle = RectBivariateSpline(flat.i_d, flat.i_q, sheet).ev(d, q)
        np.testing.assert_allclose(machine.flux(d, q, angle)[1], oracle, atol=1e-13)


def test_unequal_axes_are_resampled():
    i_d = 10 * np.sign(np.linspace(-1, 1, 31)) * np.abs(np.linspace(-1, 1, 31)) ** 1.3
    source = simple_map(i_d, np.linspace(-12, 12, 33))
    machine = Machine.from_map(source)
    d, q, _ = points(9.9)
    oracle = RegularGridInterpolator((source.i_d, source.i_q), source.psi_d, method="cubic")
    np.testing.assert_allclose(machine.mean_flux(d, q)[:, 0], oracle((d, q)), atol=5e-6)


def test_beyond_the_map_flux_goes_on_straight():
    machine = Machine.from_map(simple_map(np.linspace(-10, 10, 21), np.linspace(-12, 12, 17)))
    far = machine.mean_flux(np.array([14.0, 19.0, 24.0, 400.0]), 1.0)[:, 0]
    np.testing.assert_allclose(np.diff(far[:3])[0], np.diff(far[:3])[1], rtol=1e-10)
    np.testing.assert_allclose(far[3] - far[2], 376 / 5 * (far[1] - far[0]), rtol=1e-7)
    assert np.all(np.linalg.det(inductances(machine, np.linspace(-20, 20, 50), 15.0, 0.0)) > 0)


@pytest.mark.parametrize("name", NAMES)
def test_flux_is_the_gradient_of_the_co_energy(name):
    machine = MACHINES[name]
    d, q, theta = points(machine.i_max)
    h = 1e-4 * machine.i_max
    by_d = (co_energy(machine, d + h, q, theta) - co_energy(machine, d - h, q, theta)) / (2 * h)
    by_q = (co_energy(machine, d, q + h, theta) - co_energy(machine, d, q - h, theta)) / (2 * h)
    psi_d, psi_q = machine.flux(d, q, theta)
    np.testing.assert_allclose(psi_d, by_d, rtol=0, atol=2e-8)
    np.testing.assert_allclose(psi_q, by_q, rtol=0, atol=2e-8)


@pytest.mark.parametrize("name", NAMES)
def test_spline_follows_the_analytic_machine_and_is_reciprocal(name):
    machine = Machine.from_map(machine_map(name))
    d, q, theta = points(machine.i_max)
    exact = np.stack(MACHINES[name].flux(d, q, theta), axis=-1)
    np.testing.assert_allclose(machine.flux(d, q, theta), exact, rtol=0, atol=3e-5 * np.abs(exact).max())
    inductance = inductances(machine, d, q, theta)
    np.testing.assert_allclose(inductance[:, 0, 1], inductance[:, 1, 0], atol=1e-4 * inductance[:, 1, 1].max())
    assert np.all(np.linalg.eigvalsh(inductance) > 0)


@pytest.mark.parametrize("name", NAMES)
def test_machines_are_mirror_symmetric_with_the_magnet_on_d(name):
    machine = Machine.from_map(machine_map(name))
    d, q, theta = points(machine.i_max)
    np.testing.assert_allclose(machine.flux(d, -q, -theta), machine.flux(d, q, theta) * [1, -1], atol=1e-12)
    assert machine.mean_flux(0, 0)[0] > 0


@pytest.mark.parametrize("name", NAMES)
def test_truth_is_the_average_over_the_rotor(name):
    machine = Machine.from_map(machine_map(name))
    d, q, _ = points(machine.i_max, 50)
    # Simpson's rule is exact on each cubic piece: 24 pieces over one period
    theta = np.linspace(0, np.pi / 3, 49)
    weights = np.array([1, *([4, 2] * 23), 4, 1]) / (3 * 48)
    average = np.einsum("h,nhc->nc", weights, machine.flux(d[:, None], q[:, None], theta))
    np.testing.assert_allclose(machine.mean_flux(d, q), average, atol=1e-14)


def test_harmonics_scale_and_switch_off():
    source = machine_map("ipm")
    full, half, none = (Machine.from_map(source, harmonics=x) for x in (1.0, 0.5, 0.0))
    d, q, theta = points(source.i_max)
    mean = full.mean_flux(d, q)
    np.testing.assert_allclose(half.flux(d, q, theta) - mean, 0.5 * (full.flux(d, q, theta) - mean), atol=1e-13)
    np.testing.assert_allclose(none.flux(d, q, theta), mean, atol=1e-13)
    assert none.table.coefficients.shape[3] == 1
    assert np.abs(full.flux(d, q, theta) - mean).max() > 0.01 * np.abs(mean).max()


@pytest.mark.parametrize("harmonics", [0.0, 1.0])
def test_sixth_harmonic_is_added_without_touching_the_truth(harmonics):
    source = machine_map("spm")
    plain = Machine.from_map(source, harmonics=harmonics)
    machine = Machine.from_map(source, harmonics=harmonics, sixth_harmonic=0.01)
    d, q, theta = points(source.i_max)
    mean = plain.mean_flux(d, q)
    np.testing.assert_allclose(machine.mean_flux(d, q), mean, atol=1e-15)
    added = machine.flux(d, q, theta) - plain.flux(d, q, theta)
    np.testing.assert_allclose(added, 0.01 * mean * np.cos(6 * theta)[:, None], atol=1e-6)


def test_unknown_name_lists_the_machines():
    with pytest.raises(ConfigurationError, match="no machine 'imp': choose one of ipm, spm, pmsyrm"):
        machine_map("imp")


def test_amplitude_is_what_the_map_covers():
    axis = np.linspace(-8, 8, 9)
    assert default_amplitude(simple_map(axis, axis, 9.0)) == 8.0
    assert default_amplitude(simple_map(axis, axis, 7.0)) == 7.0
    left = simple_map(np.linspace(-8, 0, 9), axis)
    with pytest.raises(ConfigurationError, match="covers a disc of only 0 A around zero current where i_max is 9 A"):
        Machine.from_map(left)
    assert Machine.from_map(left, i_max=5.0).i_max == 5.0


@pytest.mark.parametrize(
    ("theta", "message"),
    [
        (np.radians([0.0, 10, 20, 35]), "not equally spaced"),
        (np.radians([0.0, 20, 40]), "fewer than 4"),
        (np.radians([0.0, 15, 30, 45, 60]), "fill 75 degrees, which is no period"),
    ],
)
def test_angles_must_fill_a_period(theta, message):
    flat = simple_map(np.linspace(-10, 10, 5), np.linspace(-10, 10, 5))
    psi_d, psi_q = (np.repeat(x[..., None], len(theta), axis=2) for x in (flat.psi_d, flat.psi_q))
    turning = dataclasses.replace(flat, theta=theta, psi_d_theta=psi_d, psi_q_theta=psi_q)
    with pytest.raises(ConfigurationError, match=message):
        Machine.from_map(turning)
