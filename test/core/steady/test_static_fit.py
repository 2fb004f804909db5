"""Method static on a simulated steady state: accuracy, honest errors, effects, and what points do not tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from steady_state import LinearDrive, disc_points, machine, mean_flux, telemetry

from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.static import identify_static
from drive_id.core.steady.operating_data import OperatingData
from drive_id.core.steady.operating_points import operating_points
from drive_id.errors import ConfigurationError, CoverageError, StandstillError, UnexplainedError

STATIC = FitSettings(method="static")
J = np.array([[0.0, -1.0], [1.0, 0.0]])


def identified(data, settings=STATIC):
    return identify_static(operating_points(data), settings)


def dead_time(voltage, current):
    return lambda i: voltage * np.clip(i / current, -1, 1)


def some_speeds(rng, count, fastest=370.0):
    return rng.choice([-1, 1], count) * rng.uniform(0.15, 1, count) * fastest


@pytest.mark.cases
@pytest.mark.parametrize(("name", "count", "bound"), [("ipm", 60, 0.004), ("spm", 60, 0.004), ("pmsyrm", 60, 0.02)])
def test_sixty_points_give_maps_resistance_and_drop(name, count, bound):
    drive, rng = machine(name), np.random.default_rng(7)
    i_dq = disc_points(rng, drive.i_max, count)
    voltage = 0.01 * drive.u_dc
    found = identified(
        telemetry(drive, i_dq, some_speeds(rng, count), dead_time(voltage, 0.02 * drive.i_max), rng=rng, samples=12)
    )
    assert found.resistance == pytest.approx(drive.resistance, rel=0.03)
    assert abs(found.resistance - drive.resistance) < 3 * found.sigma_resistance
    assert abs(found.voltage_error - voltage) < 4 * found.sigma_voltage_error < 0.2 * voltage
    grid = found.flux_map.grid()[found.flux_map.inside]
    truth, psi = mean_flux(drive, grid), found.flux_map.continued(grid)
    assert np.sqrt(np.mean((psi - truth) ** 2)) < bound * np.abs(truth).max()
    errors = [found.flux_map.sigma_d[found.flux_map.inside], found.flux_map.sigma_q[found.flux_map.inside]]
    assert np.mean(np.abs(psi - truth) < 1.96 * np.column_stack(errors)) > 0.8
    zero, linear = mean_flux(drive, np.zeros((1, 2)))[0, 0], found.linear
    assert abs(linear.psi_pm - zero) < max(0.02 * zero, 3 * linear.sigma_psi_pm)


@pytest.mark.accuracy
def test_a_handful_of_points_gives_parameters_whose_errors_hold():
    """Coverage of +-1.96 sigma over 100 logs of seven points, with a drop in every other log."""
    drive, hits = LinearDrive(), []
    truth = np.array([drive.resistance, drive.psi_pm, drive.l_d, drive.l_q])
    for seed in range(100):
        rng = np.random.default_rng(seed)
        i_dq = disc_points(rng, drive.i_max, 7, np.pi / 2, 3 * np.pi / 2, least=0.2)
        curve = dead_time(2.0 * (seed % 2), 0.1)
        found = identified(telemetry(drive, i_dq, some_speeds(rng, 7), curve, rng=rng))
        linear = found.linear
        value = np.array([found.resistance, linear.psi_pm, linear.l_d, linear.l_q])
        sigma = np.array([found.sigma_resistance, linear.sigma_psi_pm, linear.sigma_l_d, linear.sigma_l_q])
        hits.append(np.abs(value - truth) < 1.96 * sigma)
    coverage = np.mean(hits, axis=0)
    assert (coverage >= 0.9).all()
    assert 0.9 <= np.mean(hits) <= 0.99
    assert "constant L_d and L_q" in found.statements[0]


def test_means_without_a_time_do_as_well():
    drive, rng = LinearDrive(), np.random.default_rng(3)
    points = operating_points(telemetry(drive, disc_points(rng, 100, 8, least=0.2), some_speeds(rng, 8), rng=rng))
    found = identified(OperatingData(points.i_dq, points.u_dq, points.speed))
    assert found.linear.psi_pm == pytest.approx(drive.psi_pm, rel=0.01)
    assert abs(found.linear.l_q - drive.l_q) < 4 * found.linear.sigma_l_q


def test_saturation_that_inductances_cannot_hold_is_said_and_widens_the_errors():
    drive, rng = machine("ipm"), np.random.default_rng(2)
    i_dq = disc_points(rng, drive.i_max, 8, np.pi / 2, np.pi, least=0.2)
    found = identified(telemetry(drive, i_dq, some_speeds(rng, 8), rng=rng))
    assert any("saturation" in warning for warning in found.report.warnings)
    assert abs(found.resistance - drive.resistance) < 3 * found.sigma_resistance


def test_one_speed_is_said_and_still_works_for_a_machine_without_iron_loss():
    drive, rng = machine("ipm"), np.random.default_rng(11)
    found = identified(telemetry(drive, disc_points(rng, 300, 40), np.full(40, 300.0), rng=rng))
    assert found.resistance == pytest.approx(drive.resistance, rel=0.03)
    assert any("one speed" in statement and "iron loss" in statement for statement in found.statements)


def test_points_of_one_amplitude_leave_drop_and_resistance_together():
    drive, rng = LinearDrive(), np.random.default_rng(4)
    angle = np.linspace(1.7, 3.1, 6)
    i_dq = 80 * np.column_stack([np.cos(angle), np.sin(angle)])
    found = identified(telemetry(drive, i_dq, some_speeds(rng, 6), dead_time(1.5, 0.1), rng=rng))
    assert abs(found.resistance - drive.resistance) < 1.96 * found.sigma_resistance
    assert any("do not separate the inverter's drop from R" in statement for statement in found.statements)


def test_an_inductance_without_its_current_is_unknown():
    drive, rng = LinearDrive(), np.random.default_rng(4)
    i_dq = np.column_stack([np.zeros(6), [-90.0, -60.0, -30.0, 30.0, 60.0, 90.0]])
    found = identified(telemetry(drive, i_dq, some_speeds(rng, 6), rng=rng, noise=1e-4))
    assert found.linear.l_q == pytest.approx(drive.l_q, rel=0.01)
    assert np.isfinite(found.linear.sigma_l_q)
    if np.isfinite(found.linear.sigma_l_d):
        assert abs(found.linear.l_d - drive.l_d) < 4 * found.linear.sigma_l_d
    else:
        assert any("do not determine L_d" in statement for statement in found.statements)
    assert found.flux_map.psi_dq(0.0, 45.0)[1] == pytest.approx(drive.l_q * 45, rel=0.02)
    assert np.isnan(found.flux_map.psi_dq(40.0, 45.0)[1])


@pytest.mark.accuracy
def test_iron_loss_and_a_delay_of_the_voltages_are_found():
    drive, rng = machine("spm"), np.random.default_rng(6)
    i_m, speed = disc_points(rng, drive.i_max, 50), some_speeds(rng, 50, 700.0)
    data = telemetry(drive, i_m, speed, rng=rng)
    eddy = 0.004 * data.speed[:, None] * (np.repeat(mean_flux(drive, i_m), 10, axis=0) @ J.T)
    lossy = replace(data, i_dq=data.i_dq + eddy, u_dq=data.u_dq + drive.resistance * eddy)
    found = identified(lossy)
    assert any("Iron loss is significant" in statement for statement in found.statements)
    assert found.resistance == pytest.approx(drive.resistance, rel=0.03)
    (loss,) = found.calibrations  # from where analyses and reports take it
    assert (loss.name, loss.unit, loss.applied) == ("iron_loss_conductance", "S", True)
    assert loss.value == pytest.approx(0.004, abs=max(4 * loss.sigma, 4e-4))
    behind = data.u_dq + 60e-6 * data.speed[:, None] * (data.u_dq @ J.T)
    found = identified(replace(data, u_dq=behind))
    assert any("dq frame of the voltages lags" in warning for warning in found.report.warnings)
    assert found.calibrations == ()
    assert found.resistance == pytest.approx(drive.resistance, rel=0.03)


@pytest.mark.accuracy
def test_two_speeds_tell_a_delay_from_the_fluxes_and_one_does_not():
    drive, rng = machine("spm"), np.random.default_rng(6)
    i_dq = disc_points(rng, drive.i_max, 50)
    for speed, told in ((np.resize([250.0, 700.0], 50), True), (np.full(50, 700.0), False)):
        data = telemetry(drive, i_dq, speed, rng=rng)
        found = identified(replace(data, u_dq=data.u_dq + 60e-6 * data.speed[:, None] * (data.u_dq @ J.T)))
        assert any("dq frame of the voltages lags" in warning for warning in found.report.warnings) == told


@pytest.mark.accuracy
def test_an_angle_that_is_off_is_said():
    drive, rng = machine("ipm"), np.random.default_rng(9)
    data = telemetry(drive, disc_points(rng, drive.i_max, 40), some_speeds(rng, 40), rng=rng)
    cosine, sine = np.cos(0.05), np.sin(0.05)
    turned = np.array([[cosine, -sine], [sine, cosine]])
    found = identified(replace(data, i_dq=data.i_dq @ turned.T, u_dq=data.u_dq @ turned.T))
    assert any("angle of the dq frame is off" in warning for warning in found.report.warnings)


def test_temperatures_refer_the_resistance_to_20_degrees():
    drive, rng = LinearDrive(), np.random.default_rng(8)
    hot = replace(drive, resistance=drive.resistance * (1 + 0.00393 * 80))
    data = telemetry(hot, disc_points(rng, 100, 12, least=0.2), some_speeds(rng, 12), rng=rng, noise=5e-4)
    found = identified(replace(data, winding_temperature=np.full(len(data), 100.0)))
    assert found.resistance == pytest.approx(drive.resistance, rel=0.03)


def test_wrong_signs_standstill_and_too_few_points_are_refused():
    drive, rng = LinearDrive(), np.random.default_rng(1)
    i_dq, speed = disc_points(rng, 100, 8, least=0.2), some_speeds(rng, 8)
    data = telemetry(drive, i_dq, speed, rng=rng)
    with pytest.raises(UnexplainedError, match="direction of the speed"):
        identified(replace(data, speed=-data.speed))
    with pytest.raises(UnexplainedError, match="signs of d and q"):
        identified(replace(data, i_dq=data.i_dq[:, ::-1], u_dq=data.u_dq[:, ::-1]))
    with pytest.raises(StandstillError, match="while the machine turns"):
        identified(replace(data, speed=0 * data.speed))
    with pytest.raises(CoverageError, match="at least 4 points"):
        identified(telemetry(drive, i_dq[:2], speed[:2], rng=rng))
    with pytest.raises(CoverageError, match="record points with current"):
        identified(OperatingData(0 * i_dq, np.ones((8, 2)), speed))


def test_settings_that_the_method_ignores_are_named():
    assert replace(STATIC, maps="free", splines_d=9, monotone=True).idle() == ["maps", "splines_d", "monotone"]
    assert replace(STATIC, temperatures=(20.0,), u_dc=(400.0,), rows_are_points=True).idle() == []
    assert FitSettings(rows_are_points=True).idle() == ["rows_are_points"]
    with pytest.raises(ConfigurationError, match="psm, joint, full, locked, static"):
        FitSettings(method="statics")
