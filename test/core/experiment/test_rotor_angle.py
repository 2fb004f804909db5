"""First start: the angle is found within its error, or refused; the truth is the simulated drive's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drive_id.bench.drive import Drive, build_machine
from drive_id.bench.effects import DEFAULT_ACCELERATION
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.experiment.first_start import first_start, shaft_acceleration
from drive_id.core.experiment.free_shaft import FreeShaft, RotatingVector
from drive_id.errors import ExperimentError


def drive(name, **settings):
    settings = {"free_shaft": True, "current_noise": 0.001, "start_angle": 1.0} | settings
    settings = SimulationSettings(**settings)
    return Drive(build_machine(machine_map(name), settings), settings)


def turned(name, share=0.15, **settings):
    """Return the samples of a first start."""
    own = drive(name, **settings)
    vector = RotatingVector(share * own.machine.i_max)
    own.stator_frame = True
    return own.step_block(vector(np.arange(round(vector.duration * 1e4)) * 1e-4)).samples


def shaken(name, offset, believed, **settings):
    """Return the samples of a shake at 40 Hz of a drive whose angle is believed to be ``believed`` ahead."""
    own = drive(name, resolver_offset=offset, **settings)
    figure = FreeShaft(0.2 * own.machine.i_max, 40.0, 1.0)
    i_dq = figure(np.arange(round(figure.duration * 1e4)) * 1e-4)
    vector = (i_dq[:, 0] + 1j * i_dq[:, 1]) * np.exp(-1j * believed)
    return own.step_block(np.stack([vector.real, vector.imag], axis=-1)).samples


@pytest.mark.accuracy
@pytest.mark.parametrize(
    ("name", "offset", "friction"), [("ipm", 0.7, None), ("spm", -3.0, None), ("spm", -3.0, 0.0), ("ipm", 3.1, 0.0)]
)
def test_the_angle_is_found_within_its_error(name, offset, friction):
    found = first_start(turned(name, resolver_offset=offset, coulomb_friction=friction))
    error = math.remainder(found.angle_offset - offset, 2 * math.pi)
    assert abs(error) < 3 * found.angle_sigma + math.radians(0.05)
    assert abs(error) < math.radians(0.3)
    assert (found.direction, found.turns_per_angle) == (1, 1)


@pytest.mark.accuracy
def test_a_controller_that_knows_neither_machine_nor_inverter_is_good_enough():
    """The rotor swings about the vector and takes the currents with it."""
    poor = {"current_bandwidth": 120.0, "controller_inductance": 0.7, "controller_flux": 0.9, "inverter": "tanh"}
    found = first_start(turned("ipm", resolver_offset=0.7, **poor, inverter_voltage=0.02 * machine_map("ipm").u_dc))
    assert found.angle_offset == pytest.approx(0.7, abs=math.radians(0.3))


def test_exchanged_phases_and_an_angle_of_the_shaft_are_noticed():
    found = first_start(turned("ipm", resolver_offset=0.3, angle_reversed=True, angle_factor=0.25))
    assert (found.direction, found.turns_per_angle) == (-1, 4)
    # measured = -true / 4 + 0.3, so -4 measured = true - 1.2
    assert found.angle_offset == pytest.approx(-1.2, abs=0.005)


@pytest.mark.cases
@pytest.mark.parametrize("share", [0.1, 0.16, 0.3, 0.6, 0.9])
def test_a_weakly_aligned_machine_is_refused(share):
    """The rotor of this machine settles up to 79 degrees beside the vector, and both ways on the same side."""
    with pytest.raises(ExperimentError, match=r"saliency"):
        first_start(turned("pmsyrm", share, resolver_offset=0.7))


def test_a_locked_rotor_is_refused():
    with pytest.raises(ExperimentError, match=r"does not follow the current vector"):
        first_start(turned("ipm", inertia=1e6))


def test_the_acceleration_is_that_of_the_torque():
    """SPM: T = 1.5 p psi i_q, whatever i_d."""
    simulated = drive("spm")
    machine = simulated.machine
    inertia = float(simulated.truth().details["inertia"])
    psi = float(machine.mean_flux(0.0, 0.0)[0])
    expected = 1.5 * machine.pole_pairs**2 * psi / inertia
    largest, own = shaft_acceleration(shaken("spm", 0.4, 0.4), 40.0, 0.4)
    assert own == pytest.approx(expected, rel=0.05)
    assert own < largest < 1.25 * expected


def test_the_acceleration_holds_reluctance_torque():
    """Most of the largest torque is from saliency, which the swing at the frequency of i_q misses."""
    own = drive("pmsyrm")
    samples = own.step_block(FreeShaft(0.8 * own.machine.i_max, 25.0, 1.0)(np.arange(10_000) * 1e-4)).samples
    largest = DEFAULT_ACCELERATION * own.machine.pole_pairs
    found, by_magnets = shaft_acceleration(samples, 25.0)
    assert own.machine.i_max * found == pytest.approx(largest, rel=0.15)
    assert by_magnets < 0.5 * found


def test_an_offset_that_is_wrong_by_half_a_turn_is_refused():
    with pytest.raises(ExperimentError, match=r"wrong by half a turn"):
        shaft_acceleration(shaken("spm", 0.4, 0.4 - math.pi), 40.0, 0.4 - math.pi)


def test_a_shaft_that_does_not_swing_is_refused():
    with pytest.raises(ExperimentError, match=r"does not swing with the torque"):
        shaft_acceleration(shaken("spm", 0.0, 0.5 * math.pi), 40.0, 0.5 * math.pi)
