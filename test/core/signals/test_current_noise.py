"""White noise of the currents and of the angle is told from all that rotor and inverter do, at any speed."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.signals.current_noise import angle_variance, noise_variance

SIGMA = 0.2  # A


def recorded(turn, ripple, count=100_000):
    """Return currents, A, that wander over a disc of 100 A with waves of the rotor position, and its angle, rad."""
    rng, angle, place = np.random.default_rng(1), turn * np.arange(count), np.arange(count) / count
    current = 100 * np.sin(2 * np.pi * 7 * place) + 100j * np.sin(2 * np.pi * 8 * place)
    waves = sum(np.exp(1j * order * angle) / abs(order) for order in (-18, -12, -6, 6, 12, 18))
    current = current + ripple * current / 100 * waves + 0.5 * np.exp(-1j * angle) + 0.3 * np.exp(-2j * angle)
    current = current + SIGMA * (rng.standard_normal(count) + 1j * rng.standard_normal(count))
    return np.stack([current.real, current.imag], axis=-1), np.angle(np.exp(1j * angle))


@pytest.mark.parametrize("turn", [0.005, 0.02, 0.06, 0.2, 0.35, 0.5, -0.5])
@pytest.mark.parametrize("ripple", [0.0, 5.0])
def test_it_is_found_beside_ripple(turn, ripple):
    assert np.sqrt(noise_variance(*recorded(turn, ripple))) == pytest.approx(SIGMA, rel=0.1)


@pytest.mark.parametrize("count", [0, 4, 5, 63, 200])
def test_few_samples_tell_what_they_can(count):
    i_dq, angle = recorded(0.01, 0.0)
    found = noise_variance(i_dq[:count], angle[:count])
    assert found == 0.0 if count < 5 else 0.2 < np.sqrt(found) / SIGMA < 2.0


@pytest.mark.parametrize("turn", [0.0, 0.01, 0.2, -0.5])
@pytest.mark.parametrize("noise", [3e-4, 5e-3])
def test_noise_of_the_angle_is_found_beside_errors_of_the_resolver_and_glitches(turn, noise):
    rng, place = np.random.default_rng(2), turn * np.arange(50_000)
    angle = (
        place + np.deg2rad(1.0) * (np.sin(place + 0.3) + np.cos(2 * place)) + noise * rng.standard_normal(len(place))
    )
    angle[::5000] += 0.5
    assert np.sqrt(angle_variance(np.angle(np.exp(1j * angle)))) == pytest.approx(noise, rel=0.1, abs=3e-4)


def test_counts_of_an_encoder_are_noise_of_the_angle():
    count = 2 * np.pi / 4096
    angle = count * np.rint((0.0123 * np.arange(20_000) + np.cos(1e-3 * np.arange(20_000))) / count)
    assert np.sqrt(angle_variance(angle)) == pytest.approx(count / np.sqrt(12), rel=0.2)


@pytest.mark.parametrize("count", [0, 8, 9, 71, 200])
def test_few_angles_tell_what_they_can(count):
    found = angle_variance(1e-3 * np.random.default_rng(3).standard_normal(count))
    assert found == 0.0 if count < 9 else 0.0 < found < 5e-6
