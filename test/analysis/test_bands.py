"""Bands against figures computed anew for each cause of error, and against the truth of a simulated fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from erring import erring as changed
from exact_results import exact_result
from machine_kinds import KINDS, mean_torque
from scipy.optimize import root

import drive_id
from drive_id.analysis.field_weakening import DriveLimits, corner_speed, envelope, sigma_envelope
from drive_id.analysis.machine import MachineModel
from drive_id.analysis.operation import Operation, OperationErrors
from drive_id.analysis.trajectories import characteristic_current, mtpa, mtpv
from drive_id.common.messages import Message
from drive_id.core.full.effects.effect import Calibration
from drive_id.core.maps.error_modes import ErrorModes
from drive_id.types import MachineMap

MACHINE = KINDS["surface magnets"]
LIMITS = DriveLimits(MACHINE.i_max, MACHINE.u_dc / np.sqrt(3))


def with_modes(result, size):
    """Return a result whose fluxes err by smooth random functions of the current, with R and the inverter's curve."""
    rng = np.random.default_rng(11)
    grid = result.flux_map.grid() / result.i_max
    terms = np.stack([grid[..., 0] ** a * grid[..., 1] ** b for a in range(4) for b in range(4 - a)])
    psi_d, psi_q = (size * np.tensordot(rng.normal(size=(3, len(terms))), terms, 1) for _ in range(2))
    curve = 0.05 * rng.normal(size=3)[:, None] * np.tanh(result.inverter_curve.current)
    modes = ErrorModes(np.float32(psi_d), np.float32(psi_q), 0.004 * rng.normal(size=3), curve, curve[:, -1])
    flux_map = replace(result.flux_map, sigma_d=np.linalg.norm(psi_d, axis=0), sigma_q=np.linalg.norm(psi_q, axis=0))
    drive = replace(
        result.drive, flux_map=flux_map, error_modes=modes, sigma_resistance=np.linalg.norm(modes.resistance)
    )
    return replace(result, drive=drive)


def both_shifted(result):
    """Return pairs of results, with each cause of error up and down."""
    return [(changed(result, one), changed(result, -one)) for one in np.eye(len(result.drive.error_modes))]


def both_ways(result):
    """Return pairs of models likewise."""
    return [tuple(map(MachineModel.of, pair)) for pair in both_shifted(result)]


@pytest.fixture(scope="module")
def erring():
    return with_modes(exact_result(MACHINE.to_map(), drop=lambda i: 2 * np.tanh(i)), 2e-5)


@pytest.fixture(scope="module")
def pairs(erring):
    return both_ways(erring)


def same(sigma, pairs, figure):
    """Compare standard errors with half the differences of a figure between each pair of models."""
    changes = [0.5 * (np.asarray(figure(up)) - np.asarray(figure(down))) for up, down in pairs]
    np.testing.assert_allclose(sigma, np.linalg.norm(changes, axis=0), rtol=0.02)


def test_bands_of_the_map(erring, pairs):
    model = MachineModel.of(erring)
    i_d, i_q = np.array([-3.0, 8.0, -14.0]), np.array([12.0, -7.0, 9.0])
    same(model.sigma_torque(i_d, i_q), pairs, lambda other: other.torque(i_d, i_q))
    same(model.sigma_inductances(i_d, i_q), pairs, lambda other: other.inductances(i_d, i_q))


@pytest.mark.accuracy
def test_the_band_of_the_saliency_knows_that_both_inductances_err_together(erring, pairs):
    small = drive_id.AnalysisSettings(current_points=3, torque_points=1, speed_points=3)
    figure = drive_id.analyze(erring, small).figures["saliency"]

    def saliency(model):
        slopes = model.inductances(0.0, 0.0)
        return slopes[1, 1] / slopes[0, 0]

    same(figure.sigma, pairs, saliency)
    errors = MachineModel.of(erring).sigma_inductances(0.0, 0.0)
    slopes = MachineModel.of(erring).inductances(0.0, 0.0)
    apart = figure.value * np.hypot(errors[0, 0] / slopes[0, 0], errors[1, 1] / slopes[1, 1])
    assert abs(figure.sigma / apart - 1) > 0.05  # the band of independent errors is another one


def test_bands_of_operating_points(erring, pairs):
    model = MachineModel.of(erring)
    i_dq, speed = np.array([[-3.0, 12.0], [-10.0, -6.0]]), np.array([200.0, 500.0])
    points = Operation.at(model, i_dq, speed)
    errors = OperationErrors.of(model, points)
    same(errors.torque, pairs, lambda other: Operation.at(other, i_dq, speed).torque)
    same(errors.voltage, pairs, lambda other: Operation.at(other, i_dq, speed).voltage)
    same(errors.efficiency, pairs, lambda other: Operation.at(other, i_dq, speed).efficiency)
    same(
        errors.losses,
        pairs,
        lambda other: Operation.at(other, i_dq, speed).copper + Operation.at(other, i_dq, speed).inverter,
    )


LOSSES = {"iron_loss_conductance": (2e-3, 1e-4), "iron_loss_hysteresis": (0.5, 0.05), "iron_loss_current": (0.01, 0.02)}


def with_losses(result, changed=None, sign=0.0):
    """Return the result with an iron loss of three parts, one of them changed by its standard error."""
    message = Message("analysis_iron_loss")
    parts = {name: (value + sign * sigma * (name == changed), sigma) for name, (value, sigma) in LOSSES.items()}
    found = tuple(Calibration(name, *part, "", True, message) for name, part in parts.items())
    return replace(result, drive=replace(result.drive, calibrations=found))


def test_each_part_of_the_iron_loss_errs_by_its_own_standard_error(erring):
    """At the stator currents of the table; the small part, of which twice its size is uncertain, must not scale all."""
    models = [tuple(map(MachineModel.of, map(with_losses, pair))) for pair in both_shifted(erring)]
    models += [tuple(MachineModel.of(with_losses(erring, name, sign)) for sign in (1, -1)) for name in LOSSES]
    model = MachineModel.of(with_losses(erring))
    i_dq, speed = np.array([[-3.0, 12.0], [-10.0, -6.0], [0.0, 3.0]]), np.array([200.0, 500.0, 800.0])
    points = Operation.at(model, i_dq, speed)

    def at_stator(other, name):
        def away(flat):
            return (Operation.at(other, flat.reshape(-1, 2), speed).stator - points.stator).ravel()

        return getattr(Operation.at(other, root(away, i_dq.ravel()).x.reshape(-1, 2), speed), name)

    errors = OperationErrors.of(model, points)
    for name in ("torque", "voltage", "losses", "efficiency"):
        same(getattr(errors, name), models, lambda other, name=name: at_stator(other, name))


def test_bands_of_optima_are_those_of_optima_found_anew(erring, pairs):
    model = MachineModel.of(erring)
    found, speed = mtpa(model, 18.0, 3), np.array([0.0, 650.0, 900.0])
    same(found.sigma_torque[1:], pairs, lambda other: mtpa(other, 18.0, 3).torque[1:])
    same(
        found.sigma_angle[1:],
        pairs,
        lambda other: np.arctan2(*(getattr(mtpa(other, 18.0, 3), x)[1:] for x in ("i_q", "i_d"))),
    )
    points = envelope(model, LIMITS, speed)
    same(sigma_envelope(model, LIMITS, points), pairs, lambda other: envelope(other, LIMITS, speed).torque)


@pytest.mark.slow  # corner speeds of many maps
def test_the_band_of_the_corner_speed_is_that_of_corner_speeds_found_anew(erring, pairs):
    small = drive_id.AnalysisSettings(current_points=3, torque_points=1, speed_points=3)
    figure = drive_id.analyze(erring, small).figures["corner_speed"]
    assert figure.value == pytest.approx(corner_speed(MachineModel.of(erring), LIMITS), rel=1e-6)
    same(figure.sigma, pairs, lambda other: corner_speed(other, LIMITS))


@pytest.mark.accuracy
def test_bands_of_mtpv_and_of_the_characteristic_current():
    result = with_modes(exact_result(KINDS["reluctance with magnets"].to_map()), 5e-5)
    model, pairs = MachineModel.of(result), both_ways(result)
    size, sigma, inside = characteristic_current(model)
    assert inside
    assert 0 < size < result.i_max
    same(sigma, pairs, lambda other: characteristic_current(other)[0])
    found = mtpv(model, 38.0, 3)
    same(
        found.sigma_angle[-1],
        pairs,
        lambda other: np.arctan2(*(getattr(mtpv(other, 38.0, 3), x)[-1] for x in ("i_q", "i_d"))),
    )


def test_what_samples_only_enclose_is_known_by_its_error(erring):
    """Also to a simulation of the result; without the joint errors of a fit, the hole stays one."""
    found = erring.flux_map
    hole = np.hypot(*np.moveaxis(found.grid(), -1, 0)) < 0.3 * erring.i_max
    sigmas = {name: np.where(hole, np.nan, getattr(found, name)) for name in ("sigma_d", "sigma_q")}
    drive = replace(erring.drive, flux_map=replace(found, inside=found.inside & ~hole, **sigmas))
    holed = replace(erring, drive=drive)
    assert np.isnan(drive.flux_map.psi_dq(0.0, 0.0)[0])
    assert holed.flux_map.psi_dq(0.0, 0.0) == found.psi_dq(0.0, 0.0)
    np.testing.assert_allclose(holed.flux_map.sigma(0.5, 1.0), found.sigma(0.5, 1.0), rtol=1e-3)
    np.testing.assert_array_equal(holed.flux_map.inductances(0.5, 1.0), found.inductances(0.5, 1.0))
    assert not holed.flux_map.inside[hole].any(), "which tells where samples are"
    assert np.isnan(holed.flux_map.psi_dq(9.0 * erring.i_max, 0.0)[0])
    assert erring.flux_map.whole is erring.flux_map
    model, whole = MachineModel.of(holed), MachineModel.of(erring)
    i_d, i_q = np.array([0.0, -2.0, 1.0]), np.array([0.5, 2.0, -3.0])
    assert model.inside(i_d, i_q).all()
    np.testing.assert_array_equal(model.torque(i_d, i_q), whole.torque(i_d, i_q))
    np.testing.assert_array_equal(model.sigma_torque(i_d, i_q), whole.sigma_torque(i_d, i_q))
    np.testing.assert_array_equal(holed.to_machine().psi_q, erring.to_machine().psi_q)
    ignorant = replace(holed, drive=replace(drive, error_modes=None))
    assert not MachineModel.of(ignorant).inside(i_d, i_q).any()
    assert np.isnan(ignorant.flux_map.psi_dq(0.0, 0.0)[0])


def test_without_correlations_torque_bands_are_wide_and_slopes_have_none():
    result = exact_result(MACHINE.to_map(), sigma=1e-4, sigma_resistance=0.01)
    model = MachineModel.of(result)
    factor = 1.5 * MACHINE.pole_pairs * 1e-4
    assert model.sigma_torque(-5.0, 5.0) >= factor * (5.0 + 5.0) * (1 - 1e-9)  # even if both fluxes err alike
    assert model.sigma_torque(-5.0, 5.0) == pytest.approx(np.sqrt(2) * factor * np.hypot(5.0, 5.0))
    assert np.isnan(model.sigma_inductances(-5.0, 5.0)).all()
    assert np.isnan(mtpa(model, 20.0, 5).sigma_angle).all()
    assert np.isfinite(mtpa(model, 20.0, 5).sigma_torque).all()
    unknown = MachineModel.of(exact_result(MACHINE.to_map()))
    assert np.isnan(unknown.sigma_torque(-5.0, 5.0))
    points = Operation.at(unknown, np.array([[-3.0, 12.0]]), np.array([200.0]))
    assert np.isnan(OperationErrors.of(unknown, points).voltage).all()


@pytest.mark.accuracy
def test_bands_of_a_fit_hold_the_truth(simulation):
    fitted = drive_id.fit(simulation.samples)
    truth = simulation.truth
    names = ("i_d", "i_q", "psi_d", "psi_q", "resistance", "pole_pairs", "i_max")
    known = MachineMap(name="truth", u_dc=400.0, **{name: getattr(truth, name) for name in names})
    real, model = MachineModel.of(exact_result(known)), MachineModel.of(fitted, pole_pairs=truth.pole_pairs)
    grid = fitted.flux_map.grid()
    disc = fitted.flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= truth.i_max)
    i_d, i_q = grid[disc].T
    true_torque = mean_torque(KINDS["interior magnets"], i_d, i_q)
    np.testing.assert_allclose(real.torque(i_d, i_q), true_torque, atol=1e-3 * true_torque.max())
    error = model.torque(i_d, i_q) - true_torque
    assert np.abs(error).max() < 2e-3 * np.abs(true_torque).max()
    assert np.mean(np.abs(error) <= 1.96 * model.sigma_torque(i_d, i_q)) > 0.9
    found, wanted = mtpa(model, truth.i_max, 21), mtpa(real, truth.i_max, 21)
    angle = np.rad2deg(np.arctan2(found.i_q, found.i_d) - np.arctan2(wanted.i_q, wanted.i_d))[1:]
    assert np.abs(angle).max() < 0.5
    covered = np.abs(np.deg2rad(angle)) <= 1.96 * found.sigma_angle[1:]
    assert covered[np.isfinite(found.sigma_angle[1:])].mean() >= 0.8
