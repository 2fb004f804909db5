"""Residual voltage over the rotor position: zero where the model is the truth, and the right curve where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from drive_bags import TRAJECTORY

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.validation.residuals import Residual, over_angle, over_plane, over_time, residual_voltage
from drive_id.fitting.simulated import run_experiment
from drive_id.types import Samples

CURRENT = np.linspace(-400.0, 400.0, 801)
NO_DROP = (CURRENT, np.zeros(801))
RESISTANCE = 0.02


def flux(i_dq, _):
    return synthetic.saturating_flux(i_dq)


def drop(i_abc):
    return 4.0 * np.clip(i_abc / 20.0, -1, 1)


@pytest.mark.parametrize(("speed", "limit"), [(30.0, 0.01), (-209.0, 0.01), (1000.0, 0.2)])
def test_the_residual_of_the_truth_is_zero(speed, limit):
    """At 1000 rad/s a phase current passes the drop's corner, 4 V high, within one sample."""
    samples = synthetic.record(resistance=RESISTANCE, drop=drop, speed=speed, duration=1.0)
    found = residual_voltage(samples, flux, RESISTANCE, (CURRENT, drop(CURRENT)))
    assert np.abs(found.voltage).max() < limit


def test_what_the_model_lacks_is_left_with_its_sign():
    samples = synthetic.record(resistance=RESISTANCE, duration=1.0)
    found = residual_voltage(samples, flux, RESISTANCE - 1e-3, NO_DROP)
    i_s = frames.space_vector(samples.i_abc)
    length = round(len(samples) / len(found.angle))
    middle = np.array([i_s[k : k + length + 1].mean() for k in range(0, len(samples) - length, length)])
    expected = frames.as_pairs(1e-3 * middle * np.exp(-1j * found.angle))
    np.testing.assert_allclose(found.voltage, expected, atol=5e-3)


def test_curves_of_the_phases_are_told_apart():
    samples = synthetic.record(resistance=RESISTANCE, drop=lambda i: drop(i) * [1.0, 0.5, 1.5], duration=1.0)
    curves = drop(CURRENT)[:, None] * [1.0, 0.5, 1.5]
    assert np.abs(residual_voltage(samples, flux, RESISTANCE, (CURRENT, curves)).voltage).max() < 0.02
    assert np.abs(residual_voltage(samples, flux, RESISTANCE, (CURRENT, curves[:, ::-1])).voltage).max() > 0.5


def with_sixth(samples, amplitude):
    """Add ``amplitude cos(6 theta)`` to psi_d by adding its voltage."""
    angle = np.append(samples.angle, samples.angle[-1] + samples.speed[-1] * samples.sample_period)
    psi_s = amplitude * np.cos(6 * angle) * np.exp(1j * angle)
    u_abc = samples.u_abc + frames.phases(np.diff(psi_s) / samples.sample_period)
    return replace(samples, u_abc=u_abc)


def test_a_harmonic_that_is_left_out_is_its_induced_voltage():
    amplitude, speed = 1e-3, 209.0
    samples = with_sixth(synthetic.record(resistance=RESISTANCE, speed=speed, duration=4.0), amplitude)
    bins = over_angle(residual_voltage(samples, flux, RESISTANCE, NO_DROP))
    expected = speed * amplitude * np.stack([-6 * np.sin(6 * bins.angle), np.cos(6 * bins.angle)], axis=1)
    np.testing.assert_allclose(bins.mean, expected, atol=0.025 * 6 * speed * amplitude)
    np.testing.assert_allclose(bins.rms, np.abs(bins.mean), atol=0.15 * 6 * speed * amplitude)

    def with_harmonic(i_dq, angle):
        return synthetic.saturating_flux(i_dq) + amplitude * np.cos(6 * angle)[:, None] * [1.0, 0.0]

    found = residual_voltage(samples, with_harmonic, RESISTANCE, NO_DROP)
    assert np.abs(found.voltage).max() < 0.01


def test_the_simulated_drive_agrees_with_its_own_machine():
    simulation = run_experiment(machine_map("ipm"), SimulationSettings(current_noise=0.0), TRAJECTORY, seconds=1.0)
    truth = simulation.truth

    def exact(i_dq, angle):
        return simulation.machine.flux(i_dq[:, 0], i_dq[:, 1], angle)

    def averaged(i_dq, _):
        return simulation.machine.mean_flux(i_dq[:, 0], i_dq[:, 1])

    curve = (truth.inverter_current, truth.inverter_voltage)
    whole = over_angle(residual_voltage(simulation.samples, exact, truth.resistance, curve))
    lacking = over_angle(residual_voltage(simulation.samples, averaged, truth.resistance, curve))
    order = np.abs(np.fft.rfft(lacking.mean[:, 0])) / 36
    assert order[1:].argmax() + 1 == 6
    assert order[6] > 20 * np.abs(whole.mean).max()


def test_nothing_is_integrated_across_a_gap():
    samples = synthetic.record(resistance=RESISTANCE, duration=0.5)
    gapped = Samples.joined([samples.part(0, 2000), samples.part(3000, 5000)])
    assert np.abs(residual_voltage(gapped, flux, RESISTANCE, NO_DROP).voltage).max() < 0.01


def test_standstill_and_single_samples_are_no_reason_to_fail():
    samples = synthetic.record(resistance=RESISTANCE, speed=0.0, duration=0.1)
    found = residual_voltage(samples, flux, RESISTANCE, NO_DROP)
    assert len(found.angle) == 9  # windows of 10 ms
    assert np.abs(found.voltage).max() < 0.01
    alone = replace(samples.part(0, 3), run_starts=np.array([0, 1, 2]))
    assert residual_voltage(alone, flux, RESISTANCE, NO_DROP).voltage.shape == (0, 2)


def test_bins_hold_mean_and_rms_of_their_angles():
    angle = np.array([0.1, 0.2, 0.1 - 2 * np.pi, 3.2, 3.3])
    voltage = np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [0.0, 2.0], [0.0, -2.0]])
    bins = over_angle(Residual.none()._replace(angle=angle, voltage=voltage), bins=4)
    np.testing.assert_allclose(bins.angle, [0.4 / 3, 3 * np.pi / 4, 3.25, 7 * np.pi / 4])
    np.testing.assert_allclose(bins.mean, [[2, 0], [np.nan] * 2, [0, 0], [np.nan] * 2])
    np.testing.assert_allclose(bins.rms, [[np.sqrt(14 / 3), 0], [np.nan] * 2, [0, 2], [np.nan] * 2])


def test_cells_of_the_plane_hold_what_happened_in_them():
    """Against a loop over the windows; the share is that of one component of the voltage."""
    rng = np.random.default_rng(1)
    residual = Residual(
        np.zeros(4000),
        rng.normal(size=(4000, 2)),
        np.zeros(4000),
        rng.uniform(-7.0, 7.0, (4000, 2)),
        np.full(4000, 50.0),
    )
    bins = over_plane(residual, 6.0, bins=6)
    np.testing.assert_allclose(bins.i_d, [-5, -3, -1, 1, 3, 5])
    assert bins.commanded == pytest.approx(50 / np.sqrt(2))
    nearest = [[int(np.abs(bins.i_d - x).argmin()) for x in point] for point in residual.i_dq]
    chosen = residual.voltage[[at == [1, 4] for at in nearest]]
    np.testing.assert_allclose(bins.mean[1, 4], chosen.mean(axis=0))
    np.testing.assert_allclose(bins.rms[1, 4], np.sqrt((chosen**2).mean(axis=0)))
    assert np.isnan(over_plane(Residual.none(), 6.0).rms).all()


def test_windows_know_their_current_and_voltage():
    samples = synthetic.record(resistance=RESISTANCE, duration=0.5)
    found = residual_voltage(samples, flux, RESISTANCE, NO_DROP)
    measured = frames.to_dq(samples.i_abc, samples.angle)
    at = np.rint(found.time / samples.sample_period).astype(int)
    assert np.abs(found.i_dq - measured[at]).max() < 0.05 * np.abs(measured).max()
    commanded = np.abs(frames.space_vector(samples.u_abc))
    assert np.sqrt(np.mean(found.commanded**2)) == pytest.approx(np.sqrt(np.mean(commanded**2)), rel=0.01)


def test_bins_over_time_find_when_it_happened():
    """A voltage error of 2 V in q for a tenth of the time, in data with a gap, which does not count as time."""
    samples = synthetic.record(resistance=RESISTANCE, duration=1.0)
    half = len(samples) // 2
    gapped = replace(samples, stamp=samples.stamp + np.where(np.arange(len(samples)) < half, 0, 10**10))
    gapped = replace(gapped, run_starts=np.array([0, half]))
    time = np.arange(len(samples)) * samples.sample_period
    wrong = (time > 0.7) & (time < 0.8)
    added = frames.phases(2j * np.exp(1j * samples.angle)) * wrong[:, None]
    bins = over_time(residual_voltage(replace(gapped, u_abc=gapped.u_abc + added), flux, RESISTANCE, NO_DROP), bins=20)
    assert len(bins.time) == 20
    assert bins.time[-1] == pytest.approx(0.975, abs=0.01)
    inside = (bins.time > 0.71) & (bins.time < 0.79)
    np.testing.assert_allclose(bins.mean[inside, 1], 2.0, rtol=0.1)
    outside = (bins.time < 0.65) | (bins.time > 0.85)
    assert np.abs(bins.mean[outside]).max() < 0.05
    assert (bins.rms[inside, 1] > bins.rms[inside, 0]).all()


def test_bins_over_time_of_nothing_are_empty():
    bins = over_time(Residual.none())
    assert np.isnan(bins.mean).all()
