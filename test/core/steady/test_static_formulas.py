"""The formulas of method static, each against a derivation of its own: differences, sums over angles, densities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from steady_state import LinearDrive, disc_points, mean_drop, telemetry

from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.static import identify_static
from drive_id.core.steady.drop import DropShapes
from drive_id.core.steady.effects import ASYMMETRY, DELAY, IRON_LOSS, effect_columns
from drive_id.core.steady.fit import fit_points
from drive_id.core.steady.flux_bases import AffineBasis, affine_rows
from drive_id.core.steady.operating_points import OperatingPoints, operating_points
from drive_id.core.steady.regression import Equations, solved

DRIVE = LinearDrive()
GAMMA = np.array([DRIVE.psi_pm, DRIVE.l_d, DRIVE.l_q])
SPEED = np.array([150.0, -90.0, 310.0, 260.0, -333.0])


def flux(i_dq):
    return np.column_stack(DRIVE.flux(i_dq[:, 0], i_dq[:, 1], 0.0))


def turned(vectors, angle):
    """Rotate (N, 2) by angles (N,), as complex numbers."""
    z = (vectors[:, 0] + 1j * vectors[:, 1]) * np.exp(1j * angle)
    return np.column_stack([z.real, z.imag])


def quarter(vectors):
    return turned(vectors, np.full(len(vectors), np.pi / 2))


@pytest.fixture(scope="module")
def points():
    i_dq = disc_points(np.random.default_rng(1), 80.0, len(SPEED), least=0.2)
    u_dq = DRIVE.resistance * i_dq + SPEED[:, None] * quarter(flux(i_dq))
    return OperatingPoints(i_dq, u_dq, SPEED, None, None, np.ones(len(SPEED), np.int64), 0.0, len(SPEED))


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(5)
    i_dq = disc_points(rng, 90.0, 9, least=0.2)
    speed = rng.choice([-1, 1], 9) * rng.uniform(60, 330, 9)
    curve = lambda i: 2.0 * np.clip(i / 0.5, -1, 1)  # noqa: E731
    return telemetry(DRIVE, i_dq, speed, curve, rng=rng)


def test_the_drop_is_the_mean_of_its_curve_over_a_turn():
    shapes = DropShapes.up_to(100.0, 3.0)
    i_dq = np.vstack([disc_points(np.random.default_rng(2), 100.0, 12), [[0.0, 0.0], [3.0, 0.0]]])
    found = shapes.vectors(i_dq)
    for number in range(len(shapes.scales)):
        wanted = mean_drop(i_dq, lambda i, number=number: shapes(i)[..., number])
        np.testing.assert_allclose(found[..., number], wanted, atol=5e-3)  # both are sums over 720 angles
    np.testing.assert_allclose(np.hypot(*found[0, :, 0]), 4 / np.pi, rtol=1e-4)


def test_the_curves_are_those_of_their_laws():
    shapes = DropShapes.up_to(96.0, 3.0)
    np.testing.assert_allclose(shapes.scales[1:], [1, 2, 4, 8, 16, 0.5, 1, 2, 4, 8])
    at = np.array([0.25, 0.5, 1.0, 2.0, 4.0])
    hard, soft = shapes(at * 8.0)[:, 4], shapes(at * 8.0)[:, -1]
    np.testing.assert_allclose(hard, [0.25, 0.5, 1, 1, 1])
    np.testing.assert_allclose(soft, [0.125, 0.25, 0.5, 0.75, 0.875])
    np.testing.assert_allclose(shapes(-at), -shapes(at))


def test_iron_loss_adds_what_eddy_currents_take_from_the_flux(points):
    """Currents i_e = omega J psi / R_c flow beside those of the windings; its voltage is a derivative by 1 / R_c."""

    def voltage(conductance):
        lost = conductance * points.speed[:, None] * quarter(flux(points.i_dq))
        return points.speed[:, None] * quarter(flux(points.i_dq - lost))

    step = 1e-4
    wanted = (voltage(step) - voltage(-step)) / (2 * step)
    np.testing.assert_allclose(effect_columns(IRON_LOSS, points, AffineBasis(), GAMMA)[..., 0], wanted, rtol=1e-6)


def test_a_delay_turns_the_voltages_by_the_speed(points):
    step = 1e-7
    ahead, behind = (turned(points.u_dq, sign * points.speed * step) for sign in (1, -1))
    wanted = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(effect_columns(DELAY, points, AffineBasis(), GAMMA)[..., 0], wanted, rtol=1e-6)


def test_an_asymmetric_part_is_a_flux_in_q_and_a_common_inductance(points):
    found = effect_columns(ASYMMETRY, points, AffineBasis(), GAMMA)
    in_q = np.tile([0.0, 1.0], (len(points), 1))
    for column, psi in enumerate((in_q, points.i_dq[:, ::-1])):  # L_dq i_q in d, L_dq i_d in q
        np.testing.assert_allclose(found[..., column], points.speed[:, None] * quarter(psi), atol=1e-9)
    rows = affine_rows(points.i_dq)
    np.testing.assert_allclose(rows[..., :3] @ GAMMA, flux(points.i_dq))


@pytest.mark.parametrize("least_scale", [1.0, 0.0])
def test_the_mixture_is_that_of_the_densities_of_the_data(least_scale):
    """Without roughness: y is Gaussian with the drop's prior in its covariance, and flat in the other coefficients."""
    rng = np.random.default_rng(8)
    n, width = 24, 0.7
    columns, drops = rng.standard_normal((n, 3)), rng.standard_normal((n, 2))
    y = columns @ [1.0, -2.0, 0.5] + 0.3 * drops[:, 1] + 0.8 * rng.standard_normal(n)
    none = np.zeros((3, 3))
    found = solved(Equations(y, columns, drops, none, 0, np.zeros((0, 3)), 1 / width, 0.0, least_scale))
    logs, means, amplitudes, squares = [], [], [], []
    for drop in drops.T:
        V = np.eye(n) + width**2 * np.outer(drop, drop)
        W = np.linalg.inv(V)
        information = columns.T @ W @ columns
        beta = np.linalg.solve(information, columns.T @ W @ y)
        rest = float((y - columns @ beta) @ W @ (y - columns @ beta))
        freedom = n - 4  # the drop counts
        scale = max(least_scale, rest / freedom)
        log = np.linalg.slogdet(V)[1] + np.linalg.slogdet(information)[1]
        logs.append(log + rest / scale + freedom * np.log(scale))
        amplitude = width**2 * drop @ W @ (y - columns @ beta)
        whole = np.column_stack([columns, drop])
        prior = np.diag([0.0, 0.0, 0.0, width**-2.0])
        spread = scale * np.linalg.inv(whole.T @ whole + prior)
        means.append([*beta, amplitude])
        amplitudes.append(amplitude)
        squares.append(spread[-1, -1] + amplitude**2)
    share = np.exp(-(np.array(logs) - min(logs)) / 2)
    share /= share.sum()
    assert share.min() > 1e-3, "both shapes count"
    np.testing.assert_allclose(found.shapes, share, rtol=1e-5)
    np.testing.assert_allclose(found.mean, share @ np.array(means), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.drop_mean, amplitudes, rtol=1e-6)
    np.testing.assert_allclose(found.drop_square, squares, rtol=1e-6)


def test_a_rough_map_is_as_likely_as_its_prior_makes_the_data():
    """With roughness: the coefficients are Gaussian beforehand; the weighed penalty inverts their covariance."""
    rng = np.random.default_rng(9)
    n, width = 30, 0.7
    columns, drop = rng.standard_normal((n, 3)), rng.standard_normal(n)
    root = rng.standard_normal((3, 3)) + 2 * np.eye(3)
    penalty = root @ root.T
    y = columns @ [0.6, -0.4, 0.5] + 0.3 * drop + 0.8 * rng.standard_normal(n)
    found = solved(Equations(y, columns, drop[:, None], penalty, 3, np.zeros((0, 3)), 1 / width, 0.0, 1.0))
    unit = np.sum(columns**2) / np.trace(penalty)
    logs, means, effective = [], [], []
    weights = np.geomspace(1e-9, 1e3, 25)
    for weight in unit * weights:
        before = np.linalg.inv(weight * penalty)
        V = np.eye(n) + width**2 * np.outer(drop, drop) + columns @ before @ columns.T
        W = np.linalg.inv(V)
        scale = max(1.0, y @ W @ y / (n - 1))  # the drop counts
        logs.append(np.linalg.slogdet(V)[1] + y @ W @ y / scale + (n - 1) * np.log(scale))
        means.append([*(before @ columns.T @ W @ y), width**2 * drop @ W @ y])
        after = before - before @ columns.T @ W @ columns @ before
        effective.append(4 - np.trace(after @ np.linalg.inv(before)))  # less what the roughness settles
    share = np.exp(-(np.array(logs) - min(logs)) / 2)
    share /= share.sum()
    best = int(np.argmin(logs))
    assert 0 < best < len(weights) - 1, "the data choose"
    assert share.max() < 0.9, "several weights count"
    np.testing.assert_allclose(found.mean, share @ np.array(means), rtol=1e-5)
    assert found.weight == pytest.approx(weights[best])
    assert found.effective == pytest.approx(effective[best], rel=1e-6)


def test_the_errors_are_those_of_the_mixture_widened_by_students_law(log):
    points = operating_points(log)
    fit = fit_points(points, 90.0)
    widening = stats.t.ppf(0.975, points.freedom) / stats.norm.ppf(0.975)
    assert not fit.misfit > 1.25, "the noise is known, so its degrees of freedom count"
    assert fit.widening == pytest.approx(widening, rel=1e-6)
    current = np.array([-40.0, -0.3, 0.2, 7.0])
    mean, sigma = fit.drop_curve(current)
    for k, i in enumerate(current):
        value = fit.shapes(np.array([i]))[0]
        first = sum(p * v * a for p, v, a in zip(fit.posterior.shapes, value, fit.posterior.drop_mean, strict=True))
        second = sum(
            p * v**2 * a for p, v, a in zip(fit.posterior.shapes, value, fit.posterior.drop_square, strict=True)
        )
        assert mean[k] == pytest.approx(first)
        assert sigma[k] == pytest.approx(widening * np.sqrt(second - first**2), rel=1e-6)
    value, spread = fit.coefficient(0)
    assert (value, spread) == pytest.approx(
        (fit.posterior.mean[0], widening * np.sqrt(fit.posterior.covariance[0, 0])), rel=1e-6
    )
    rows = affine_rows(np.array([[10.0, -20.0]]))[..., : fit.basis.parameters]
    psi, error = fit.of(rows)
    block = fit.posterior.covariance[1:4, 1:4]
    for axis in range(2):
        assert psi[0, axis] == pytest.approx(rows[0, axis] @ fit.posterior.mean[1:4])
        assert error[0, axis] == pytest.approx(widening * np.sqrt(rows[0, axis] @ block @ rows[0, axis]), rel=1e-6)


def test_the_report_and_the_linear_machine_follow_from_map_and_points(log):
    points = operating_points(log)
    drive = identify_static(points, FitSettings(method="static", i_max=90.0))
    explained = drive.resistance * points.i_dq + points.speed[:, None] * quarter(drive.flux_map.continued(points.i_dq))
    explained += mean_drop(points.i_dq, lambda i: np.interp(i, drive.inverter_current, drive.inverter_voltage))
    rms = np.sqrt(np.mean((points.u_dq - explained) ** 2))
    assert drive.report.residual_rms == pytest.approx(rms, rel=0.05)
    assert drive.report.rows == 2 * len(points) == 2 * 9
    assert drive.report.samples_used == points.count.sum() < drive.report.samples_read == len(log)
    assert drive.voltage_error == pytest.approx(drive.inverter_voltage[-1], rel=0.01)
    zero, ahead = (drive.flux_map.continued(np.array([[d, 0.0]]))[0] for d in (0.0, 1.0))
    assert drive.linear.psi_pm == pytest.approx(zero[0], rel=1e-6)
    assert drive.linear.l_d == pytest.approx(ahead[0] - zero[0], rel=1e-4)
    assert drive.linear.l_q == pytest.approx(drive.flux_map.continued(np.array([[0.0, 1.0]]))[0, 1] - zero[1], rel=1e-4)
