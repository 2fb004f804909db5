"""An angle recorded at a fraction of the rate: standard errors of method ``full`` on drives whose speed ripples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identify import identify
from drive_id.core.signals.rotor_interpolation import interpolated_rotor
from drive_id.core.signals.signal import Signal
from drive_id.core.validation.metrics import true_flux
from drive_id.fitting.simulated import run_experiment


def simulated(machine, seed=0, **settings):
    simulation = SimulationSettings(current_noise=2e-3, seed=seed, **settings)
    found = run_experiment(machine_map(machine), simulation, None, 3.0)
    return found.samples, found.truth


def with_slow_angle(samples, every):
    angle = np.angle(np.exp(1j * samples.angle[::every]))
    found = interpolated_rotor(Signal("encoder", samples.stamp[::every], angle[:, None]), samples.stamp)
    angle, speed = found.signal.values.T
    return replace(samples.part(0, len(angle)), angle=angle, speed=speed, angle_error=found.error)


def relative_errors(samples, truth):
    """Return the rms of the errors of both fluxes over their standard errors, and the estimated delay."""
    found = identify([samples], FitSettings("full", grid_points=33, harmonic_orders=(6, 12)))
    flux_map = found.flux_map
    grid = flux_map.grid()
    chosen = flux_map.inside & (np.hypot(*np.moveaxis(grid, -1, 0)) <= 0.97 * truth.i_max)
    true = true_flux(truth, grid[chosen])
    return [
        float(np.sqrt(np.mean(((psi[chosen] - true[:, k]) / sigma[chosen]) ** 2)))
        for k, (psi, sigma) in enumerate(((flux_map.psi_d, flux_map.sigma_d), (flux_map.psi_q, flux_map.sigma_q)))
    ], {entry.name: entry for entry in found.calibrations}["voltage_delay"]


@pytest.mark.accuracy
@pytest.mark.parametrize(
    ("machine", "every", "settings"),
    [
        ("spm", 10, {"speeds": (1500.0,), "speed_ripple": 0.1, "ripple_order": 6}),
        ("ipm", 20, {"speeds": (-450.0,), "speed_ripple": 0.05, "ripple_order": 8, "resolver_noise": 2e-3}),
    ],
)
def test_standard_errors_cover_those_by_an_interpolated_angle(machine, every, settings):
    samples, truth = simulated(machine, **settings)
    errors, _ = relative_errors(with_slow_angle(samples, every), truth)
    assert max(errors) < 1.5
    assert min(errors) > 0.4


@pytest.mark.accuracy
def test_a_ripple_at_half_the_rate_of_the_angle_is_not_taken_for_a_voltage_delay():
    samples, truth = simulated("ipm", speeds=(800.0,), speed_ripple=0.1, ripple_order=18)
    slow = with_slow_angle(samples, 20)
    errors, delay = relative_errors(slow, truth)
    assert max(errors) < 1.5
    assert not delay.applied
    _, confident = relative_errors(replace(slow, angle_error=0.0), truth)
    assert abs(confident.value) > 1.9 * confident.sigma, "it would be taken for one if the angle's error were not known"
