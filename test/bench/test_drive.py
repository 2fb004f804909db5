"""The drive as a whole: reproducible, tracking, and each fault exactly as declared."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from bench_runs import IPM, PHASES, T, run

from drive_id.bench.drive import Drive, Simulation, build_machine, simulate
from drive_id.bench.machines import MACHINES, machine_map
from drive_id.bench.profile import SpeedProfile
from drive_id.bench.settings import SimulationSettings
from drive_id.core.frames import wrapped
from drive_id.errors import ConfigurationError, DataError
from drive_id.types import MachineMap


def true_i_abc(simulation: Simulation) -> np.ndarray:
    theta = simulation.angle_true[:, None] - PHASES
    return np.cos(theta) * simulation.i_dq_true[:, :1] - np.sin(theta) * simulation.i_dq_true[:, 1:]


NOISY = {"current_noise": 1e-3, "resolver_noise": 1e-3, "speed_noise": 0.5, "speeds": (500.0, -300.0)}


def test_same_seed_same_bits_other_seed_other_noise():
    first, second, other = run(**NOISY), run(**NOISY), run(**NOISY, seed=1)
    for name in ("stamp", "i_abc", "u_abc", "angle", "speed"):
        np.testing.assert_array_equal(getattr(first.samples, name), getattr(second.samples, name))
    assert np.abs(first.samples.i_abc - other.samples.i_abc).max() > 0.1


@pytest.mark.accuracy
@pytest.mark.parametrize("name", list(MACHINES))
@pytest.mark.parametrize("rpm", [500.0, -500.0, 3000.0, -3000.0, 0.0])
def test_controller_tracks(name, rpm):
    simulation = run(10000, machine_map(name), speeds=(rpm,), current_noise=1e-3)
    error = simulation.i_dq_true - simulation.samples.i_dq_reference
    i_max = simulation.truth.i_max
    assert np.sqrt(np.mean(error**2)) < 0.04 * i_max
    assert np.hypot(*simulation.i_dq_true.T).max() < 1.15 * i_max
    assert np.abs(error[:5]).max() < 0.05 * i_max


def test_beyond_the_voltage_limit_the_drive_stays_calm_and_recovers():
    weak = dataclasses.replace(machine_map("pmsyrm"), u_dc=270.0)
    simulation = run(12000, weak, speeds=(3000.0, 500.0))
    u_ab = simulation.samples.u_abc @ np.exp(1j * PHASES) * 2 / 3
    assert np.abs(u_ab).max() <= 270 / np.sqrt(3) * (1 + 1e-9)
    assert np.hypot(*simulation.i_dq_true.T).max() < 1.2 * simulation.truth.i_max
    late = (simulation.i_dq_true - simulation.samples.i_dq_reference)[8000:]
    assert np.sqrt(np.mean(late**2)) < 0.04 * simulation.truth.i_max


def test_current_sensors():
    faults = {"current_gain": (1.02, 0.99, 1.0), "current_offset": (0.5, -1.0, 2.0)}
    simulation = run(**faults)
    expected = true_i_abc(simulation) * faults["current_gain"] + faults["current_offset"]
    np.testing.assert_allclose(simulation.samples.i_abc, expected, atol=1e-9)


def test_current_noise_is_white_and_of_its_size():
    simulation = run(20000, current_noise=2e-3)
    noise = simulation.samples.i_abc - true_i_abc(simulation)
    np.testing.assert_allclose(noise.std(axis=0), 0.6, rtol=0.03)
    assert np.abs(np.corrcoef(noise.T) - np.eye(3)).max() < 0.03
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.03 * 0.36


def test_quantization():
    simulation = run(current_quantization=0.25)
    steps = simulation.samples.i_abc / 0.25
    np.testing.assert_array_equal(steps, np.rint(steps))
    assert np.abs(simulation.samples.i_abc - true_i_abc(simulation)).max() <= 0.125 + 1e-9


def test_faults_act_inside_the_loop():
    clean, faulty = run(), run(current_gain=(1.05, 1.0, 1.0))
    assert np.abs(clean.i_dq_true - faulty.i_dq_true).max() > 2.0


def test_resolver():
    simulation = run(10000, resolver_offset=0.05, resolver_noise=2e-3, speed_noise=0.7)
    angle, speed = simulation.samples.angle, simulation.samples.speed
    assert np.all((angle >= -np.pi) & (angle < np.pi))
    error = wrapped(angle - simulation.angle_true)
    assert error.mean() == pytest.approx(0.05, abs=1e-4)
    assert error.std() == pytest.approx(2e-3, rel=0.05)
    true_speed = 500 * np.pi / 30 * 4
    assert speed.mean() == pytest.approx(true_speed, abs=0.03)
    assert speed.std() == pytest.approx(0.7, rel=0.05)


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 1.75, -0.5, -1.0, -2.25, -4.0])
def test_voltages_act_later_than_the_log_says(delay):
    """Without resistance and drop, each flux step is the voltage truly held, which is the log shifted."""
    source = dataclasses.replace(machine_map("spm"), resistance=0.0)
    simulation = run(400, source, inverter="none", voltage_delay=delay)
    i_dq, theta = simulation.i_dq_true, simulation.angle_true
    psi = simulation.machine.flux(i_dq[:, 0], i_dq[:, 1], theta)
    steps = np.diff((psi[:, 0] + 1j * psi[:, 1]) * np.exp(1j * theta))
    logged = simulation.samples.u_abc @ np.exp(1j * PHASES) * 2 / 3
    whole = int(np.floor(delay))
    part = delay - whole
    k = np.arange(5, 390)
    held = part * logged[k - whole - 1] + (1 - part) * logged[k - whole]
    np.testing.assert_allclose(steps[k], T * held, rtol=0, atol=1e-12)


def test_compensation_adds_the_drop_on_top_of_the_log():
    source = dataclasses.replace(machine_map("spm"), resistance=0.0)

    def unexplained(compensation: bool) -> float:
        simulation = run(4000, source, inverter="dead_time", inverter_compensation=compensation)
        i_dq, theta = simulation.i_dq_true, simulation.angle_true
        psi = simulation.machine.flux(i_dq[:, 0], i_dq[:, 1], theta)
        steps = np.diff((psi[:, 0] + 1j * psi[:, 1]) * np.exp(1j * theta))
        logged = simulation.samples.u_abc[:-1] @ np.exp(1j * PHASES) * 2 / 3
        return float(np.sqrt(np.mean(np.abs(steps / T - logged) ** 2)))

    assert unexplained(False) == pytest.approx(3.25 * 1.27, rel=0.1)
    assert unexplained(True) < 0.1 * unexplained(False)


def test_speed_ripple_is_consistent_with_the_angle():
    simulation = run(6000, speeds=(600.0,), speed_ripple=0.03, ripple_order=2)
    mean = 600 * np.pi / 30 * 4
    theta, speed = np.unwrap(simulation.angle_true), simulation.samples.speed
    np.testing.assert_allclose((theta[2:] - theta[:-2]) / (2 * T), speed[1:-1], rtol=1e-5)
    np.testing.assert_allclose([speed.min(), speed.max()], [0.97 * mean, 1.03 * mean], rtol=1e-4)
    spectrum = np.abs(np.fft.rfft(speed - speed.mean()))
    assert np.argmax(spectrum) == round(2 * 10 * 0.6)  # two per revolution, ten revolutions per second, 0.6 s


def test_speeds_share_the_time_and_ramp():
    simulation = run(3000, speeds=(500.0, -200.0, 0.0), ramp_time=0.05)
    rpm = simulation.samples.speed * 30 / np.pi / 4
    np.testing.assert_allclose(
        rpm[[0, 1000, 1250, 1500, 1999, 2250, 2500, 2999]], [500, 500, 150, -200, -200, -100, 0, 0]
    )
    theta = np.unwrap(simulation.angle_true)
    mean = 0.5 * (simulation.samples.speed[1:] + simulation.samples.speed[:-1])
    np.testing.assert_allclose(np.diff(theta), T * mean, atol=1e-9)


def test_given_durations_and_an_open_end():
    settings = SimulationSettings(speeds=(100.0, 300.0), segment_durations=(0.2, 0.5), ramp_time=0.1)
    profile = SpeedProfile.from_settings(settings, None)
    rpm = profile.electrical(np.array([-1, 0.2, 0.25, 0.3, 50]), 2) * 30 / np.pi / 2
    np.testing.assert_allclose(rpm, [100, 100, 200, 300, 300])


def test_truth_travels_beside_the_samples():
    simulation = run(inverter="tanh", inverter_voltage=5.0, inverter_current=1.0, i_max=250.0)
    truth = simulation.truth
    assert (truth.machine, truth.resistance, truth.i_max, truth.pole_pairs) == ("ipm", 10e-3, 250.0, 4)
    psi = simulation.machine.mean_flux(truth.i_d[:, None], truth.i_q[None, :])
    np.testing.assert_array_equal(truth.psi_d, psi[..., 0])
    np.testing.assert_array_equal(truth.psi_q, psi[..., 1])
    assert truth.i_d[-1] == 250.0
    np.testing.assert_allclose(truth.inverter_voltage, 5.0 * np.tanh(truth.inverter_current), atol=1e-12)
    assert truth.details["inverter"] == "tanh"
    assert truth.details["seed"] == 0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"inverter": "igbt"}, "inverter is 'igbt': it must be one of none, tanh"),
        ({"speeds": ()}, "speeds is empty"),
        ({"speeds": (1.0, 2.0), "segment_durations": (1.0,)}, "1 entry for 2 speeds"),
        ({"voltage_delay": 2.0}, "voltage_delay is 2.0 samples"),
        ({"i_max": 0.0}, "i_max is 0 A"),
        ({"harmonics": 1.5}, "harmonics is 1.5"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        SimulationSettings(**settings)


def test_impossible_profiles_are_refused():
    with pytest.raises(ConfigurationError, match=r"A speed lasts 0\.05 s, less than its ramp of 0\.1 s"):
        run(1000, speeds=(100.0, 200.0))
    settings = SimulationSettings(speeds=(100.0, 200.0))
    with pytest.raises(ConfigurationError, match="no duration for 2 speeds"):
        Drive(build_machine(IPM, settings), settings)


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), np.zeros((0, 2)), np.full((4, 2), np.nan)])
def test_references_are_checked(bad):
    with pytest.raises(DataError, match="references"):
        simulate(IPM, SimulationSettings(), bad)


def test_a_map_that_cannot_be_inverted_is_reported():
    axis = np.linspace(-10, 10, 21)
    d, q = np.meshgrid(axis, axis, indexing="ij")
    folded = MachineMap("folded", axis, axis, 0.1 + 0.1 * np.sin(d / 3), 0.05 * np.sin(q / 3), 0.1, 2, 10.0, 300.0)
    with pytest.raises(ConfigurationError, match="no current belongs to the flux on the map of machine 'folded'"):
        run(2000, folded)
