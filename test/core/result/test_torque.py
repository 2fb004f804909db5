"""Gain, friction and cogging from a shaft torque that is made of them, and of maps of the bench."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from synthetic import record, saturating_flux

import drive_id
from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.result.torque import fit_torque
from drive_id.fitting.simulated import simulate
from drive_id.types import Samples

PAIRS = 4


@pytest.fixture(scope="module")
def flux_map():
    axis = np.linspace(-315, 315, 33)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    psi, zero = saturating_flux(grid), np.zeros(grid.shape[:2])
    return FluxMap(axis, axis, psi[..., 0], psi[..., 1], zero, zero, np.hypot(*grid.transpose(2, 0, 1)) < 330)


def measured(speeds, *, gain=1.0, friction=0.0, viscous=0.0, offset=0.0, cogging=(), noise=0.0, seconds=4.0):
    """Return one recording per electrical speed, with a torque calculated from the flux in closed form."""
    rng = np.random.default_rng(1)
    found = []
    for number, speed in enumerate(speeds):
        samples = record(speed=speed, duration=seconds)
        i_dq = frames.to_dq(samples.i_abc, samples.angle)
        psi = saturating_flux(i_dq)
        torque = gain * 1.5 * PAIRS * (psi[:, 0] * i_dq[:, 1] - psi[:, 1] * i_dq[:, 0])
        torque += offset - friction * np.sign(speed) - viscous * speed / PAIRS
        for order, amplitude in cogging:
            torque += amplitude * np.cos(order * samples.angle + 0.7)
        torque += noise * rng.standard_normal(len(torque))
        found.append(replace(samples, stamp=samples.stamp + number * 60 * 10**9, shaft_torque=torque))
    return found


def test_everything_is_told_apart_at_speeds_of_both_directions(flux_map):
    cogging = ((6, 0.3), (12, 0.1))
    pieces = measured(
        [209.0, -209.0, 400.0, -500.0], gain=0.985, friction=0.8, viscous=0.004, offset=0.15, cogging=cogging, noise=0.5
    )
    found = fit_torque(flux_map, pieces, PAIRS)
    for value, sigma, true in (
        (found.gain, found.sigma_gain, 0.985),
        (found.friction, found.sigma_friction, 0.8),
        (found.viscous_friction, found.sigma_viscous_friction, 0.004),
        (found.offset, found.sigma_offset, 0.15),
    ):
        assert abs(value - true) < 3.5 * sigma + 1e-6
    assert found.sigma_gain < 2e-4
    assert found.sigma_friction < 0.05
    assert [harmonic.order for harmonic in found.cogging] == [6, 12]
    for harmonic, (_, true) in zip(found.cogging, cogging, strict=True):
        assert abs(harmonic.amplitude - true) < 3.5 * harmonic.sigma
    assert found.rms_residual == pytest.approx(0.5, rel=0.01)
    of_map = np.concatenate([piece.shaft_torque for piece in measured([209.0])])
    assert found.rms_map == pytest.approx(np.hypot(0.5, 0.015 * np.sqrt(np.mean(of_map**2))), rel=0.03)
    assert found.samples == 160_000


def test_one_speed_gives_all_friction_at_once(flux_map):
    found = fit_torque(flux_map, measured([209.0], friction=0.8, viscous=0.004, offset=0.15), PAIRS)
    assert found.friction == pytest.approx(0.8 + 0.004 * 209 / PAIRS - 0.15, abs=1e-3)
    assert found.gain == pytest.approx(1.0, abs=1e-5)
    assert found.viscous_friction is None
    assert found.offset is None
    assert found.cogging == ()


@pytest.mark.accuracy
def test_standard_errors_cover_the_truth(flux_map):
    """With slow noise, as of a torque sensor that drifts, whose neighbouring samples are far from independent."""
    (piece,) = measured([209.0], seconds=2.0)
    z = []
    for seed in range(40):
        steps = np.random.default_rng(seed).standard_normal(len(piece))
        slow = np.convolve(steps, np.exp(-np.arange(500) / 100), "same")
        found = fit_torque(flux_map, [replace(piece, shaft_torque=piece.shaft_torque + slow)], PAIRS)
        z.append((found.gain - 1) / found.sigma_gain)
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.4


def test_sums_in_parts_are_those_of_the_whole(flux_map):
    (piece,) = measured([209.0], gain=0.9, friction=1.0, noise=0.5)
    cuts = [0, 7_000, 20_000, 40_000]
    parts = [piece.part(a, b) for a, b in itertools.pairwise(cuts)]
    one, other = (fit_torque(flux_map, pieces, PAIRS) for pieces in ([piece], parts))
    assert one.gain == pytest.approx(other.gain, rel=1e-9)
    assert one.friction == pytest.approx(other.friction, rel=1e-6)


def test_a_slow_torque_signal_has_no_cogging(flux_map):
    """Interpolated from 100 Hz, nothing is left of order 6 at 33 Hz; the gain is there all the same."""
    (piece,) = measured([209.0], gain=0.97, cogging=((6, 0.5),))
    coarse = slice(None, None, 100)
    torque = np.interp(piece.stamp, piece.stamp[coarse], piece.shaft_torque[coarse])
    found = fit_torque(flux_map, [replace(piece, shaft_torque=torque)], PAIRS)
    assert found.cogging == ()
    assert found.gain == pytest.approx(0.97, abs=3e-3)


def test_unknown_torque_and_too_little_of_it(flux_map):
    (piece,) = measured([209.0], gain=0.97)
    torque = piece.shaft_torque.copy()
    torque[10_000:30_000] = np.nan
    found = fit_torque(flux_map, [replace(piece, shaft_torque=torque)], PAIRS)
    assert found.samples == 20_000
    assert found.gain == pytest.approx(0.97, abs=1e-5)
    assert fit_torque(flux_map, [replace(piece, shaft_torque=np.full(len(piece), np.nan))], PAIRS) is None


# -- with the bench ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def simulated() -> Samples:
    """Current sensors that all read 2 % too much, which the electrical signals cannot show."""
    settings = SimulationSettings(
        current_gain=(1.02, 1.02, 1.02), log_scalars=("shaft_torque",), harmonics=0.0, current_noise=1e-3
    )
    return simulate("ipm", 5.0, settings=settings)


@pytest.mark.accuracy
def test_a_common_gain_that_only_the_torque_can_show(simulated, tmp_path):
    result = drive_id.fit(simulated, output=tmp_path / "result")
    torque = result.drive.torque
    assert torque.gain == pytest.approx(1 / 1.02, abs=4 * torque.sigma_gain)
    assert torque.sigma_gain < 5e-4
    assert abs(torque.friction) < 4 * torque.sigma_friction < 0.1
    assert torque.pole_pairs == 4
    assert any("Voltages and currents alone do not show this" in text for text in result.drive.statements)
    assert "common_gain" not in {said.code for said in result.drive.statements}  # it says that nothing can show it
    assert drive_id.load(tmp_path / "result").drive.torque == torque


def test_pole_pairs_must_be_known(simulated):
    unknown = replace(simulated, truth=None)
    result = drive_id.fit(unknown, method="joint")
    assert result.drive.torque is None
    assert any("the number of pole pairs is unknown: set pole_pairs" in text for text in result.drive.statements)
    given = drive_id.fit(unknown, settings=drive_id.FitSettings(method="joint", pole_pairs=4))
    assert given.drive.torque.gain == pytest.approx(1 / 1.02, abs=2e-3)
    assert given.pole_pairs == 4


def test_a_gain_far_from_one_is_a_warning(simulated):
    wrong = drive_id.fit(replace(simulated, truth=None), settings=drive_id.FitSettings(method="joint", pole_pairs=2))
    assert any("1.96 times that of the map: check its scale" in text for text in wrong.warnings)
    turned = drive_id.fit(replace(simulated, shaft_torque=-simulated.shaft_torque), method="joint")
    assert any("-0.98" in text and "reverse its sign (scale" in text for text in turned.warnings)
