"""Valid recordings of a free shaft pass the checks, and a swing within a revolution is refused with its cure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import drive_id
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.bench.swing import Swing, simulate_swing
from drive_id.core.checks.prescan import Prescan
from drive_id.core.checks.rotor import speed_lag
from drive_id.errors import DataError, StandstillError
from drive_id.types import Samples

DRIVE = SimulationSettings(
    free_shaft=True, current_noise=1e-3, current_bandwidth=120.0, controller_inductance=0.7, controller_flux=0.9
)


def swung(machine: str, observer: float = 0.0, seconds: float = 4.0, mean_speed: float = 0.0, **swing) -> Samples:
    settings = replace(DRIVE, speed_observer=observer)
    return simulate_swing(machine_map(machine), settings, Swing(mean_speed=mean_speed, **swing), seconds).samples


def checked(samples: Samples) -> list[str]:
    prescan = Prescan()
    prescan.add(samples)
    return [finding.code for finding in prescan.check()]


@pytest.fixture(scope="module")
def lagging() -> Samples:
    return swung("ipm", observer=100.0, frequency=20.0, mean_speed=60.0)


@pytest.fixture(scope="module")
def exact() -> Samples:
    return swung("ipm", frequency=20.0, mean_speed=60.0)


def test_a_speed_that_lags_is_accepted(lagging):
    assert checked(lagging) == []


@pytest.mark.parametrize("bandwidth", [60.0, 100.0, 200.0])
def test_the_lag_of_a_tracking_observer_is_found(bandwidth):
    samples = swung("pmsyrm", observer=bandwidth, seconds=1.0, frequency=20.0)
    assert speed_lag([samples]) == pytest.approx(2 / (2 * np.pi * bandwidth), rel=0.15)


@pytest.mark.parametrize("factor", [0.25, 0.5, 0.75, 4 / 3, 2.0, -1.0])
def test_a_wrong_factor_is_refused_with_and_without_lag(exact, lagging, factor):
    for samples in (exact, lagging):
        with pytest.raises(DataError, match="times as fast as the logged speed"):
            checked(replace(samples, speed=factor * samples.speed))


@pytest.mark.parametrize("factor", [0.95, 1.06])
def test_without_lag_a_factor_of_a_few_percent_is_refused(exact, factor):
    with pytest.raises(DataError, match="times as fast as the logged speed"):
        checked(replace(exact, speed=factor * exact.speed))


def test_a_speed_by_the_angle_is_accepted(lagging):
    derived = np.gradient(np.unwrap(lagging.angle), lagging.sample_period)
    assert checked(replace(lagging, speed=derived)) == []


def test_a_swing_within_a_revolution_is_refused_with_its_cure():
    with pytest.raises(StandstillError, match=r"swings within 0\.\d\d electrical revolutions.*slow rotation.*inertia"):
        checked(swung("ipm", frequency=60.0))


def test_a_locked_rotor_is_refused_with_the_reason():
    drive = replace(DRIVE, inertia=1e6)
    samples = simulate_swing(machine_map("ipm"), drive, Swing(frequency=5.0), 2.0).samples
    with pytest.raises(StandstillError, match=r"turned by only 0\.00 electrical revolutions"):
        checked(samples)


@pytest.mark.accuracy
def test_the_same_swing_is_accepted_while_it_creeps():
    assert checked(swung("ipm", frequency=60.0, mean_speed=60.0, seconds=6.0)) == []


def test_a_reluctance_machine_with_magnets_has_no_offset_of_the_currents():
    assert "current_offset" not in checked(swung("pmsyrm", seconds=8.0, frequency=5.0, mean_speed=40.0))


@pytest.mark.slow  # 10 s of a swinging shaft are simulated
def test_currents_locked_to_the_position_are_no_offset():
    """Over turns that repeat forth and back, they had a constant part of 21 A."""
    samples = simulate_swing(machine_map("ipm"), replace(DRIVE, controller_inductance=1.0), Swing(), 10.0).samples
    assert checked(samples) == []


@pytest.mark.slow  # 20 s of a swinging shaft are simulated
def test_reversals_within_a_turn_are_no_offset():
    """Parts of turns, with one sign of the current at the same angles again and again, looked like 2.7 V."""
    drive = replace(DRIVE, inertia=7.02e-4, inverter="tanh", inverter_voltage=6.5, speed_observer=100.0, seed=1)
    samples = simulate_swing(machine_map("spm"), drive, Swing(), 20.0).samples
    assert checked(samples) == []


@pytest.mark.accuracy
def test_an_offset_is_still_found_on_a_free_shaft():
    samples = swung("pmsyrm", seconds=8.0, frequency=20.0, mean_speed=900.0)
    i_max = float(np.abs(samples.i_abc).max())
    wrong = replace(samples, i_abc=samples.i_abc + 0.3 * i_max * np.array([1.0, -0.5, -0.5]))
    assert "current_offset" in checked(wrong)


@pytest.mark.accuracy
def test_an_offset_of_the_sensors_is_traced_in_the_flux():
    """The mean slope of the drop, which does not act on a constant voltage here, gave 0.11 ± 0.004 A of 1 A."""
    drive = replace(DRIVE, inverter="tanh", inverter_voltage=6.5, current_offset=(1.0, -0.5, -0.5), seed=1)
    samples = simulate_swing(machine_map("ipm"), drive, Swing(), 5.0).samples
    found = drive_id.fit(samples, settings=drive_id.FitSettings(pole_pairs=3, harmonic_orders=(6, 12)))
    offset = {each.name: each for each in found.calibrations}["current_offset_alpha"]
    assert offset.applied
    assert offset.value == pytest.approx(1.0, abs=3 * offset.sigma)
    assert offset.sigma < 0.15
