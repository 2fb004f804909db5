"""Method ``full`` against the truth of simulated drives, and against ``joint``: the goals that it was built for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from store import stored

from drive_id.bench.drive import simulate
from drive_id.bench.machines import MACHINES, machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full.model import ModelSpec
from drive_id.core.full.solver import CurrentNoise, Solver, noise_products
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identify import gather, identify, score
from drive_id.core.validation.metrics import true_flux
from drive_id.fitting.simulated import run_experiment
from drive_id.types import MachineMap

pytestmark = pytest.mark.accuracy

FULL, JOINT = FitSettings(method="full"), FitSettings(method="joint")
IPM = machine_map("ipm")
NOISY = SimulationSettings(current_noise=2e-3)


def errors(simulation, settings=FULL):
    """Fit; return the identification and the NRMSE of both fluxes in percent."""
    found = identify([simulation.samples], settings)
    return found, 100 * np.array(score(found, simulation.truth))


def calibration(found, name):
    (entry,) = (entry for entry in found.calibrations if entry.name == name)
    return entry


def distorted(machine, change):
    """Return a machine whose fluxes ``change(psi_d, psi_q, i_d, i_q)`` replaces, harmonics included."""
    i_d, i_q = np.meshgrid(machine.i_d, machine.i_q, indexing="ij")
    mean = change(machine.psi_d, machine.psi_q, i_d, i_q)
    turning = change(machine.psi_d_theta, machine.psi_q_theta, i_d[..., None], i_q[..., None])
    return replace(machine, psi_d=mean[0], psi_q=mean[1], psi_d_theta=turning[0], psi_q_theta=turning[1])


def linear_machine():
    axis = np.linspace(-360.0, 360.0, 13)
    i_d, i_q = np.meshgrid(axis, axis, indexing="ij")
    return MachineMap("linear", axis, axis, 0.06 + 1.5e-4 * i_d, 2.5e-4 * i_q, 1e-2, 4, 300.0, 400.0)


def fit_of(name):
    """Return what the default method finds of a shipped machine, and its NRMSE in percent."""
    return errors(run_experiment(machine_map(name), replace(NOISY, current_noise=1e-3), seconds=3.0))


@pytest.mark.essential
@pytest.mark.parametrize("name", MACHINES)
def test_one_drive_of_each_family(name):
    found, full_errors = stored(fit_of, name)
    assert full_errors.max() < 0.1
    truth = machine_map(name)
    assert found.resistance == pytest.approx(truth.resistance, abs=3 * found.sigma_resistance)
    assert found.resistance == pytest.approx(truth.resistance, rel=0.02)
    assert [harmonic.order for harmonic in found.flux_map.harmonics] == [6, 12]
    assert found.report.warnings == ()
    judged = {"voltage_delay", "resolver_offset", "current_offset_alpha", "current_gain_mismatch_alpha"}
    assert judged <= {entry.name for entry in found.calibrations}


@pytest.mark.parametrize("name", ["ipm", "pmsyrm"])
def test_errors_of_inductances_hold_after_one_second(name):
    """The 25 batches of a second are too few for slopes of the map: their errors need more than these."""
    ratios = []
    for seed in range(2):
        simulation = run_experiment(machine_map(name), replace(NOISY, current_noise=1e-3, seed=seed), seconds=1.0)
        found = identify([simulation.samples], FULL)
        flux_map, modes = found.flux_map, found.error_modes
        true = true_flux(simulation.truth, flux_map.grid())
        for axis, psi in enumerate(("psi_d", "psi_q")):
            within = flux_map.inside.copy()  # with both neighbours, between which the slope is taken
            for step in (1, -1):
                within &= np.roll(flux_map.inside, step, axis=axis)
            error = np.gradient(getattr(flux_map, psi) - true[..., axis], axis=axis)[within]
            sigma = np.linalg.norm(np.gradient(getattr(modes, psi), axis=axis + 1), axis=0)[within]
            ratios.append(error / sigma)
    ratio = np.abs(np.concatenate(ratios))
    ratio = ratio[np.isfinite(ratio)]  # the true map ends at i_max
    assert 0.55 < np.sqrt(np.mean(ratio**2)) < 1.15
    assert np.mean(ratio < 1.96) > 0.91


def test_all_faults_of_the_sensors_together_leave_two_tenths_of_a_percent():
    settings = replace(
        NOISY, resolver_offset=np.deg2rad(1.0), voltage_delay=1.0, current_gain=(1.004, 1.0, 0.998),
        current_offset=(0.9, -0.45, 0.2),
    )  # fmt: skip
    simulation = run_experiment(IPM, settings, seconds=4.0)
    found, full_errors = errors(simulation)
    assert full_errors.max() < 0.2
    assert found.resistance == pytest.approx(simulation.truth.resistance, rel=0.02)
    assert calibration(found, "voltage_delay").value == pytest.approx(1.0, abs=0.1)
    assert calibration(found, "resolver_offset").value == pytest.approx(np.deg2rad(1.0), rel=0.1)


def test_with_everything_ideal_a_hundredth_of_a_percent_is_left():
    simulation = run_experiment(IPM, SimulationSettings(inverter="none", harmonics=0.0), seconds=3.0)
    found, full_errors = errors(simulation)
    assert full_errors.max() < 0.01
    assert found.resistance == pytest.approx(simulation.truth.resistance, rel=1e-3)
    assert np.abs(found.inverter_voltage).max() < 0.01
    assert found.flux_map.harmonics == ()


def test_an_asymmetric_machine_refuses_the_calibration_of_the_angle():
    cross = 0.05 * np.abs(IPM.psi_d).max() / IPM.i_max  # reciprocal, but psi_d is not even in i_q
    machine = distorted(IPM, lambda psi_d, psi_q, i_d, i_q: (psi_d + cross * i_q, psi_q + cross * i_d))
    found, full_errors = errors(run_experiment(machine, replace(NOISY, current_noise=1e-3), seconds=3.0))
    angle = calibration(found, "resolver_offset")
    assert not angle.applied
    assert angle.message in found.report.warnings
    assert full_errors.max() < 0.1


def test_an_asymmetric_machine_with_a_late_angle_is_corrected_for_its_lateness_and_warned_of():
    cross, latency = 0.05 * np.abs(IPM.psi_d).max() / IPM.i_max, 1.5e-4
    machine = distorted(IPM, lambda psi_d, psi_q, i_d, i_q: (psi_d + cross * i_q, psi_q + cross * i_d))
    settings = replace(NOISY, current_noise=1e-3, speed_ripple=0.03, resolver_latency=latency)
    found, full_errors = errors(run_experiment(machine, settings, seconds=5.0))
    angle = calibration(found, "resolver_offset")
    speed = np.deg2rad(6 * settings.speeds[0]) * IPM.pole_pairs
    assert angle.applied
    assert abs(angle.value + latency * speed) < 3 * angle.sigma < 0.1 * latency * speed
    assert angle.message in found.report.warnings
    assert "mirror-symmetric" in angle.message
    assert full_errors.max() < 0.3  # of 3 % by an angle that is off


@pytest.mark.parametrize(
    ("machine", "changes", "trajectory"),
    [
        pytest.param(linear_machine(), {}, None, id="a linear machine without harmonics"),
        pytest.param(IPM, {"sample_period": 1e-3}, None, id="1 kHz"),
        pytest.param(IPM, {}, Lissajous(frequency_d=2.0, frequency_q=1.0), id="a figure that covers 8 % of the disc"),
        pytest.param(IPM, {}, Lissajous(frequency_d=100 / 3, frequency_q=25 / 3), id="a figure in step with the rotor"),
        pytest.param(
            IPM, {"harmonics": 0.0, "current_noise": 0.0, "inverter_compensation": True}, None, id="compensated only"
        ),
    ],
)
def test_never_worse_than_joint(machine, changes, trajectory):
    simulation = run_experiment(machine, replace(NOISY, **changes), trajectory, seconds=3.0)
    _, joint_errors = errors(simulation, JOINT)
    _, full_errors = errors(simulation)
    assert np.all(full_errors < joint_errors)


def test_what_a_compensating_drive_leaves_of_its_inverter_does_not_bend_the_map():
    found, full_errors = errors(run_experiment(IPM, replace(NOISY, inverter_compensation=True), seconds=5.0))
    assert any("compensates the inverter's drop" in sentence for sentence in found.statements)
    simulation = run_experiment(IPM, NOISY, seconds=5.0)
    truth, (plain, plain_errors) = simulation.truth, errors(simulation)
    assert plain_errors.max() < 0.1
    assert plain.resistance == pytest.approx(truth.resistance, rel=0.01)
    true_drop = np.interp(plain.inverter_current, truth.inverter_current, truth.inverter_voltage)
    assert np.sqrt(np.mean((plain.inverter_voltage - true_drop) ** 2)) < 0.02 * true_drop.max()
    assert [harmonic.order for harmonic in plain.flux_map.harmonics] == [6, 12]
    assert plain.report.warnings == ()
    assert not any("compensates the inverter's drop" in sentence for sentence in plain.statements)
    assert np.all(full_errors < 1.5 * plain_errors)
    away = np.abs(found.inverter_current) > 0.03 * IPM.i_max  # nearer to zero, noise makes the curve uncertain
    assert np.abs(found.inverter_voltage[away]).max() < 0.02 * np.abs(plain.inverter_voltage).max()
    assert np.all(np.abs(found.inverter_voltage) < 4 * found.sigma_inverter_voltage + 1e-3)


def along_a_ring(machine, settings, seconds, turns=1.1, share=1.0, against=0.0):
    """Simulate a current that turns in the rotor's frame, after a short way from rest.

    With a part that turns ``against`` it, the ring of constant amplitude becomes an ellipse.
    """
    t = settings.sample_period * np.arange(round(seconds / settings.sample_period))
    turn = np.exp(2j * np.pi * turns * t)
    ring = machine.i_max * (share * turn + against * turn.conj()) * np.minimum(t / 0.2, 1.0)
    return simulate(machine, settings, np.stack([ring.real, ring.imag], axis=-1))


def test_the_way_from_rest_to_a_ring_does_not_decide_what_the_ring_is_fitted_with():
    simulation = along_a_ring(machine_map("pmsyrm"), NOISY, 10.0)
    _, joint_errors = errors(simulation, JOINT)
    found, full_errors = errors(simulation)
    assert np.all(full_errors < 0.7 * joint_errors)
    assert found.resistance == pytest.approx(simulation.truth.resistance, rel=0.03)
    assert not any("reciprocal" in warning for warning in found.report.warnings)


def test_a_delay_that_only_the_penalty_decides_on_is_not_taken_out():
    simulation = along_a_ring(IPM, NOISY, 3.0)
    delay = calibration(identify([simulation.samples], FULL), "voltage_delay")
    assert not delay.applied
    assert delay.sigma > 0.1


@pytest.mark.parametrize("late", [0.0, 1.0])
def test_noise_does_not_pass_for_a_delay(late):
    """The controller answers noise with voltage: 5 times the usual noise looked like a delay of 0.3 samples."""
    simulation = run_experiment(IPM, replace(NOISY, current_noise=1e-2, voltage_delay=late), seconds=4.0)
    delay = calibration(identify([simulation.samples], FULL), "voltage_delay")
    assert delay.applied == bool(late)
    assert delay.value == pytest.approx(late, abs=min(2.5 * delay.sigma, 0.3))


@pytest.mark.parametrize(
    ("changes", "turns", "share"),
    [
        pytest.param({"current_noise": 5e-3, "speeds": (2500.0,)}, -0.7, 0.5, id="at the end of the range"),
        pytest.param({"current_noise": 1e-3, "speeds": (1200.0,), "inverter": "none"}, 1.1, 1.0, id="of three samples"),
    ],
)
def test_on_a_ring_noise_does_not_pass_for_a_delay_either(changes, turns, share):
    settings = replace(NOISY, harmonics=0.0, **changes)
    simulation = along_a_ring(machine_map("spm"), settings, 6.0, turns, share)
    _, joint_errors = errors(simulation, JOINT)
    found, full_errors = errors(simulation)
    assert not calibration(found, "voltage_delay").applied
    assert np.all(full_errors < joint_errors)
    assert abs(found.resistance - simulation.truth.resistance) < 2.5 * found.sigma_resistance


def test_next_to_nothing_does_not_make_a_machine_non_reciprocal():
    """Without noise, a ring leaves residuals of 1e-5 of the voltage, and free maps a third less."""
    settings = replace(NOISY, speeds=(-2500.0,), inverter="two_stage", harmonics=0.0, current_noise=0.0)
    # A ring of constant amplitude covers 4.9 or 5.0 % of the disc, as rounding has it; 5 % are needed.
    simulation = along_a_ring(machine_map("pmsyrm"), settings, 6.0, -0.7, against=0.005)
    _, joint_errors = errors(simulation, JOINT)
    found, full_errors = errors(simulation)
    assert not any("reciprocal" in warning for warning in found.report.warnings)
    assert np.all(full_errors < 0.5 * joint_errors)


def test_on_a_thin_ellipse_free_maps_do_not_win_by_following_noise():
    """Across it, noise alone moves the current: a map that is flat there leaves less of it, and is wrong."""
    settings = replace(NOISY, speeds=(2500.0,), inverter="none", seed=5)
    simulation = along_a_ring(machine_map("pmsyrm"), settings, 6.0, 1.3, 0.65, 0.25)
    _, joint_errors = errors(simulation, JOINT)
    found, full_errors = errors(simulation)
    assert not any("reciprocal" in warning for warning in found.report.warnings)
    assert np.all(full_errors < joint_errors)


def test_how_far_noise_has_moved_a_delay_is_foreseen_from_its_products():
    """Twice the noise, by adding as much once more to the recorded currents, against twice the noise by expectation."""
    settings = replace(NOISY, current_noise=5e-3, speeds=(2500.0,), harmonics=0.0)
    machine = machine_map("spm")
    samples = run_experiment(machine, settings, seconds=4.0).samples
    noise = np.random.default_rng(1).normal(scale=settings.current_noise * machine.i_max, size=samples.i_abc.shape)
    recordings = (samples, replace(samples, i_abc=samples.i_abc + noise))
    once, twice = (gather([each], FULL).windows.finished() for each in recordings)
    choice = ModelSpec(reciprocal=True, orders=(), penalty=1e-3)
    solver = Solver.over(once)
    solution = solver.solve(choice)
    delay, _, squares = solver.delay(solution)
    variance = 2 / 3 * (settings.current_noise * machine.i_max) ** 2
    products = noise_products(solver, solution, CurrentNoise.met(variance, once.kept()), squares)
    foreseen = solver.delay(solver.solve(choice, products))[0] - delay
    solver = Solver.over(twice)
    assert solver.delay(solver.solve(choice))[0] - delay == pytest.approx(foreseen, rel=0.35)
    assert 2 * delay - (delay + foreseen) == pytest.approx(0.0, abs=0.5 * delay)


def test_currents_at_speeds_and_in_a_direction_never_seen_are_predicted():
    seen = [run_experiment(IPM, replace(NOISY, speeds=(speed,)), seconds=2.0).samples for speed in (400.0, -900.0)]
    gathered = {method: gather(seen, FitSettings(method=method)) for method in ("joint", "full")}
    noise = 0.8 * np.sqrt(2 / 3) * 2e-3 * IPM.i_max  # mean absolute noise of i_d
    for speed in (1500.0, -1500.0):
        unseen = run_experiment(IPM, replace(NOISY, speeds=(speed,), seed=7), seconds=1.5).samples
        mad = {
            method: np.array([report.mad_d, report.mad_q])
            for method, evidence in gathered.items()
            for report in [conclude(evidence, [unseen]).report]
        }
        assert np.all(3 * mad["full"] < mad["joint"])
        assert np.all(mad["full"] < 2 * noise)
