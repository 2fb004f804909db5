"""Plans for a free shaft keep the speeds, name what a light rotor needs, and work in the simulation."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from itertools import product

import numpy as np
import pytest

from drive_id.bench.machine import default_amplitude
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.bench.swing import Swing, simulate_swing
from drive_id.core.planning import free_shaft
from drive_id.core.planning.free_shaft import plan_free_shaft
from drive_id.core.planning.settings import PlanSettings, RoughMachine
from drive_id.errors import ConfigurationError

RPM = 30 / math.pi
INERTIA = 0.0318  # kg m^2: 4000 rad/s^2 by the largest torque of ipm


def rough(machine: str = "ipm", **settings) -> PlanSettings:
    known = machine_map(machine)
    return PlanSettings(**asdict(RoughMachine.from_map(known, default_amplitude(known))), **settings)


@pytest.mark.parametrize("heavier", [0.3, 1.0, 3.0, 10.0, 100.0])
def test_the_speeds_stay_in_the_band(heavier):
    found = plan_free_shaft(rough(), heavier * INERTIA)
    assert abs(found.mean_speed) + found.swing / 0.85 <= found.speed_max * (1 + 1e-9)
    assert 5.0 <= found.frequency <= 50.0  # a quarter of the bandwidth


def test_a_heavy_rotor_is_a_flywheel():
    found = plan_free_shaft(rough(), 10 * INERTIA)
    assert found.mean_speed == pytest.approx(0.5 * found.speed_max)
    assert any("flywheel" in said for said in found.statements())


def test_a_light_rotor_says_what_to_add():
    found = plan_free_shaft(rough(), 0.02 * INERTIA)
    (warning,) = found.warnings()
    assert f"add {found.added_inertia:.3g} kg m^2" in warning
    assert plan_free_shaft(rough(), 1.001 * found.inertia).warnings() == []


def test_a_swing_within_a_revolution_creeps_for_ten():
    found = plan_free_shaft(rough(), 0.1 * INERTIA)
    turns = found.mean_speed / (2 * math.pi) * found.machine.pole_pairs * found.duration
    assert turns >= 10 - 1e-9
    assert any("creeps" in said for said in found.statements())


def test_the_voltage_limits_the_speed():
    settings = replace(rough(speed_max=1400.0), u_dc=80.0)
    found = plan_free_shaft(settings, INERTIA)
    assert found.speed_max * RPM < 1400.0
    assert found.machine.steady_voltage(found.speed_max * RPM) == pytest.approx(0.9 * 80.0 / math.sqrt(3), rel=1e-6)


@pytest.mark.parametrize(
    ("settings", "inertia", "said"),
    [
        (PlanSettings(), INERTIA, "The plan needs"),
        (rough(), None, "needs inertia"),
        (rough(), -1.0, "must be positive"),
        (rough(current_bandwidth=10.0), INERTIA, "a swing needs at least 20 Hz"),
        (replace(rough(), magnet_flux=0.0, inductance_q=1e-3, inductance_d=1e-3, u_dc=1e4), INERTIA, "no torque"),
    ],
)
def test_what_cannot_be_planned_is_refused(settings, inertia, said):
    with pytest.raises(ConfigurationError, match=said):
        plan_free_shaft(settings, inertia)


SLOTLESS = PlanSettings(
    i_max=6.8, pole_pairs=3, resistance=0.031, inductance_d=5e-5, inductance_q=5e-5, magnet_flux=0.0033, u_dc=24.0,
    current_bandwidth=120.0,
)  # fmt: skip


@pytest.mark.slow  # several swings are planned
def test_a_current_controller_that_would_lose_the_currents_must_be_faster():
    found = plan_free_shaft(SLOTLESS, 2e-4)
    assert 120.0 < found.bandwidth <= 0.2 / (2 * math.pi * 1e-4)
    assert any(f"raise its bandwidth from 120 to {found.bandwidth:.3g} Hz" in said for said in found.warnings())
    faster = plan_free_shaft(replace(SLOTLESS, current_bandwidth=found.bandwidth), 2e-4)
    assert not any("bandwidth" in said for said in faster.warnings())
    with pytest.raises(ConfigurationError, match="Currents would not follow a swing"):
        plan_free_shaft(replace(SLOTLESS, inductance_d=5e-6, inductance_q=5e-6), 2e-4)


POOR = [(0.7, 0.85), (1.2, 1.1)]
"""What controllers assume, relative to the machine's inductances and magnet flux."""


def test_a_plan_counts_on_the_controllers_that_are_simulated_below():
    assert set(POOR) <= set(free_shaft._ASSUMED)
    inductances, fluxes = zip(*POOR, strict=True)
    assert set(free_shaft._ASSUMED) == set(product(inductances, fluxes))


@pytest.mark.accuracy
@pytest.mark.parametrize(("inductance", "magnet"), POOR)
@pytest.mark.parametrize("machine", ["ipm", "spm", "pmsyrm"])
def test_currents_follow_a_controller_of_poor_parameters_at_a_late_speed(machine, inductance, magnet):
    """Limits beyond which such controllers were seen to reach 1.3 and 1.8 i_max."""
    settings = rough(machine, current_bandwidth=120.0, speed_max=3000.0)
    found = plan_free_shaft(
        settings, 1.5 * settings.pole_pairs * settings.i_max * max(settings.magnet_flux, 0.05) / 4e3
    )
    swing = Swing(found.speed_max * RPM, found.mean_speed * RPM, found.frequency)
    poor = {"controller_inductance": inductance, "controller_flux": magnet, "speed_observer": 60.0}
    drive = SimulationSettings(
        free_shaft=True, inertia=found.inertia, current_bandwidth=found.bandwidth, i_max=settings.i_max, **poor
    )
    simulation = simulate_swing(machine_map(machine), drive, swing, 4.0)
    assert np.hypot(*simulation.i_dq_true.T).max() < 1.2 * settings.i_max
    distance = np.hypot(*(simulation.i_dq_true - simulation.samples.i_dq_reference).T).mean()
    assert distance < 0.25 * settings.i_max


@pytest.mark.accuracy
@pytest.mark.parametrize("machine", ["ipm", "spm", "pmsyrm"])
def test_the_planned_swing_stays_below_the_trips_in_the_simulation(machine):
    settings = rough(machine)
    inertia = 1.5 * settings.pole_pairs * settings.i_max * max(settings.magnet_flux, 0.05) / 4000.0
    found = plan_free_shaft(settings, inertia)
    swing = Swing(speed_max=found.speed_max * RPM, mean_speed=found.mean_speed * RPM, frequency=found.frequency)
    drive = SimulationSettings(free_shaft=True, inertia=found.inertia, current_bandwidth=120.0, i_max=settings.i_max)
    simulation = simulate_swing(machine_map(machine), drive, swing, 4.0)
    angle = np.unwrap(simulation.angle_true) / simulation.machine.pole_pairs
    speed = np.gradient(angle, simulation.samples.sample_period)
    assert np.abs(speed).max() < 1.2 * found.speed_max
    assert np.hypot(*simulation.i_dq_true.T).max() < 1.2 * settings.i_max
