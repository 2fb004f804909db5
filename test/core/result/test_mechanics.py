"""Inertia, friction, load and cogging from the motion of simulated free shafts whose mechanics are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import drive_id
from drive_id.bench.drive import Simulation
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.bench.swing import Swing, simulate_swing
from drive_id.core.fit_settings import FitSettings
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.result.identification import Mechanics
from drive_id.core.result.mechanics import fit_mechanics
from drive_id.files.results.identification import read_results
from drive_id.fitting.simulated import simulate
from drive_id.types import Samples

INERTIA = 0.0318  # kg m^2: the largest torque of machine ipm, 127 Nm, accelerates it by 4000 rad/s^2


def swung(seconds: float = 6.0, inertia: float = INERTIA, swing: Swing | None = None, **drive) -> Simulation:
    """Without rotor-position harmonics, whose torque is no part of the model."""
    plain = {"harmonics": 0.0, "current_noise": 1e-3, "current_bandwidth": 120.0, "speed_observer": 100.0}
    settings = SimulationSettings(free_shaft=True, inertia=inertia, **(plain | drive))
    return simulate_swing(machine_map("ipm"), settings, swing or Swing(), seconds)


def true_map(simulation: Simulation, gain: float = 1.0) -> FluxMap:
    """The map of voltages that are too small by a gain."""
    machine = simulation.machine
    axis = np.linspace(-1.2 * machine.i_max, 1.2 * machine.i_max, 65)
    grid = np.meshgrid(axis, axis, indexing="ij")
    psi, zero = machine.mean_flux(*grid) / gain, np.zeros(grid[0].shape)
    return FluxMap(axis, axis, psi[..., 0], psi[..., 1], zero, zero, np.hypot(*grid) < 1.3 * machine.i_max)


def fitted(simulation: Simulation) -> Mechanics:
    found = fit_mechanics(true_map(simulation), [simulation.samples], simulation.machine.pole_pairs)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def swing() -> Simulation:
    return swung()


def test_a_large_swing_tells_inertia_and_both_frictions(swing):
    found, true = fitted(swing), swing.truth.details
    assert found.inertia == pytest.approx(true["inertia"], rel=2e-4)
    assert found.friction == pytest.approx(true["coulomb_friction"], abs=max(3 * found.sigma_friction, 0.03))
    assert found.viscous_friction == pytest.approx(true["viscous_friction"], rel=0.05)
    assert found.cogging == ()
    assert found.gain is None
    assert found.explained > 0.999


@pytest.mark.accuracy
@pytest.mark.parametrize(("frequency", "mean_speed", "tolerance"), [(20.0, 0.0, 1e-3), (60.0, 60.0, 5e-3)])
def test_fast_swings_tell_the_inertia(frequency, mean_speed, tolerance):
    simulation = swung(swing=Swing(frequency=frequency, mean_speed=mean_speed))
    assert fitted(simulation).inertia == pytest.approx(INERTIA, rel=tolerance)


@pytest.mark.accuracy
def test_a_flywheel_that_never_reverses_has_one_friction_with_its_load():
    simulation = swung(10.0, 10 * INERTIA, Swing(speed_max=600.0, mean_speed=300.0), load_torque=1.0)
    later = simulation.samples.part(40_000, len(simulation.samples))
    found = fit_mechanics(true_map(simulation), [later], simulation.machine.pole_pairs)
    assert found.inertia == pytest.approx(10 * INERTIA, rel=1e-3)
    assert found.load is None
    assert found.friction == pytest.approx(1.27 + 1.0, rel=0.1)


@pytest.mark.accuracy
def test_the_load_is_not_told_by_the_run_up_of_a_flywheel():
    """Its first swings reverse, which is too little to tell a load from friction."""
    found = fitted(swung(10.0, 10 * INERTIA, Swing(speed_max=600.0, mean_speed=300.0)))
    assert found.load is None
    assert found.friction is None or abs(found.friction - 1.27) < 3 * found.sigma_friction


@pytest.mark.accuracy
def test_friction_that_changes_its_sign_slowly_is_not_taken_for_less():
    """Within 0.1 rad/s of rest the simulated friction is less than Coulomb's, and the swing reaches 5 rad/s only."""
    swing = Swing(speed_max=100.0, frequency=25.0)
    found = fitted(swung(8.0, 5 * INERTIA, swing, coulomb_friction=6.4, seed=1))
    assert found.friction == pytest.approx(6.4, rel=0.01)
    assert abs(found.friction - 6.4) < 2 * found.sigma_friction


@pytest.mark.accuracy
def test_a_load_is_told_from_friction_where_the_shaft_reverses():
    found = fitted(swung(load_torque=2.0))
    assert found.load == pytest.approx(2.0, rel=0.1)
    assert found.friction == pytest.approx(1.27, rel=0.1)


@pytest.mark.accuracy
def test_cogging_is_visible():
    found = fitted(swung(10.0, cogging_torque=2.0))
    assert [harmonic.order for harmonic in found.cogging] == [6]
    assert found.cogging[0].amplitude == pytest.approx(2.0, abs=max(4 * found.cogging[0].sigma, 0.1))


def test_a_known_inertia_closes_the_common_gain(swing):
    pieces = [swing.samples]
    found = fit_mechanics(true_map(swing, 1.03), pieces, swing.machine.pole_pairs, inertia=INERTIA)
    assert found.gain == pytest.approx(1.03, rel=5e-4)
    assert (found.inertia, found.sigma_inertia) == (INERTIA, 0.0)
    assert found.friction == pytest.approx(1.27, rel=0.05)


@pytest.mark.accuracy
def test_a_disc_closes_the_common_gain_and_tells_the_inertia(swing):
    disc = 0.5 * INERTIA
    with_disc = swung(inertia=INERTIA + disc)
    pieces = [swing.samples, with_disc.samples]
    found = fit_mechanics(true_map(swing, 0.97), pieces, swing.machine.pole_pairs, (0.0, disc))
    assert found.gain == pytest.approx(0.97, rel=2e-3)
    assert found.inertia == pytest.approx(INERTIA, rel=3e-3)
    assert abs(found.gain - 0.97) < 4 * found.sigma_gain + 1e-3


def test_with_a_load_machine_nothing_is_claimed(swing):
    samples = simulate("ipm", 4.0, noise=1e-3)
    assert fit_mechanics(true_map(swing), [samples], swing.machine.pole_pairs) is None


def test_too_little_data_claim_nothing(swing):
    assert fit_mechanics(true_map(swing), [swing.samples.part(0, 50)], swing.machine.pole_pairs) is None


def wrong(samples: Samples, gain: float) -> Samples:
    return replace(samples, u_abc=samples.u_abc / gain)


@pytest.mark.accuracy
def test_a_fit_reports_mechanics_saves_them_and_closes_the_gain(swing, tmp_path):
    samples = wrong(replace(swing.samples, truth=None), 1.02)
    settings = FitSettings(pole_pairs=swing.machine.pole_pairs, inertia=INERTIA, search_orders=False)
    found = drive_id.fit(samples, output=tmp_path / "out", settings=settings)
    assert found.mechanics.gain == pytest.approx(1.02, abs=2e-3)
    assert abs(found.mechanics.gain - 1.02) < 3 * found.mechanics.sigma_gain + 5e-4
    assert any("off by 2 % together" in said for said in found.drive.statements)
    stored, _ = read_results(tmp_path / "out")
    assert stored.mechanics == found.mechanics
