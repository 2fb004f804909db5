"""What a fit by method full is told about a faulty experiment, and what it traces back to a sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from machine_kinds import mean_flux
from synthetic import every, only

from drive_id.bench.machines import MACHINES, machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full import selection
from drive_id.core.full.order_search import distinct_orders
from drive_id.core.result.identify import identify, score
from drive_id.fitting.simulated import run_experiment

I_MAX = 300.0


def simulate(seconds=5.0, **options):
    return run_experiment(machine_map("ipm"), SimulationSettings(current_noise=2e-3, **options), seconds=seconds)


@pytest.fixture(scope="module")
def good():
    return simulate()


def fitted(samples, **settings):
    return identify([samples], FitSettings("full", i_max=I_MAX, harmonic_orders=(6, 12), **settings))


def told(samples):
    return " ".join(fitted(samples).report.warnings)


def named(identification, name):
    found = {entry.name: entry for entry in identification.calibrations}
    return complex(found[f"{name}_alpha"].value, found[f"{name}_beta"].value), found[f"{name}_alpha"].applied


@pytest.mark.accuracy
def test_a_good_recording_is_told_nothing(good):
    assert told(good.samples) == ""


@pytest.mark.accuracy
def test_a_constant_voltage_is_no_offset_of_the_currents(good):
    """The flux would show that of the currents; both are taken out, so that the simulated current stays right."""
    offset = np.array([0.5, -0.2, -0.3])
    of_voltages = fitted(replace(good.samples, u_abc=good.samples.u_abc + offset))
    value, applied = named(of_voltages, "voltage_offset")
    assert applied
    assert abs(value - frames.space_vector(offset[None])[0]) < 0.02
    assert named(of_voltages, "current_offset") == (0, False)
    assert of_voltages.report.mad_d < 0.5
    of_currents = fitted(replace(good.samples, i_abc=good.samples.i_abc + 4 * offset))
    value, applied = named(of_currents, "current_offset")
    assert applied
    assert abs(value - 4 * frames.space_vector(offset[None])[0]) < 0.3
    assert any("This is large: check the sensor." in warning for warning in of_currents.report.warnings)


@pytest.mark.accuracy
def test_one_wrong_gain_leaves_that_of_all_phases_open(good):
    """The mean gain is off by a third of it, which no signal shows; the errors of R and of the flux hold it."""
    wrong = fitted(replace(good.samples, i_abc=good.samples.i_abc * [1.0, 1.06, 1.0]))
    machine, flux_map = good.machine, wrong.flux_map
    assert abs(wrong.resistance - machine.resistance) < 2.5 * wrong.sigma_resistance
    d, q = (int(np.argmin(np.abs(axis + 0.4 * I_MAX))) for axis in (flux_map.i_d, flux_map.i_q))
    true = np.array(mean_flux(MACHINES["ipm"], flux_map.i_d[d], flux_map.i_q[q])).ravel()
    error = np.array([flux_map.psi_d[d, q], flux_map.psi_q[d, q]]) - true
    sigma = np.array([flux_map.sigma_d[d, q], flux_map.sigma_q[d, q]])
    assert np.all(np.abs(error) < 2.5 * sigma)
    assert sigma.max() > 2e-3 * flux_map.psi_d[d, q]


def logged_late(samples, late):
    """Return samples with voltages that were recorded ``late`` samples before they acted."""
    names = ("stamp", "i_abc", "angle", "speed", "i_dq_reference")
    arrays = {name: getattr(samples, name)[: len(samples) - late] for name in names}
    return replace(samples, **arrays, u_abc=samples.u_abc[late:])


def delay_of(identification):
    (entry,) = (entry for entry in identification.calibrations if entry.name == "voltage_delay")
    return entry


@pytest.mark.accuracy
def test_delays_of_several_samples_are_taken_out():
    """More than the simulation's log can be late: the record is moved."""
    simulation = simulate(voltage_delay=0.5)
    found = fitted(logged_late(simulation.samples, 3))
    assert delay_of(found).applied
    assert delay_of(found).value == pytest.approx(3.5, abs=0.05)
    assert max(score(found, simulation.truth)) < 1e-3


@pytest.mark.accuracy
def test_a_decimated_log_is_recognized_by_its_delay():
    """Where the checks before the fit cannot tell: at 2.5 kHz, 5 degrees per sample."""
    samples = replace(simulate(speeds=(520.0,)).samples, i_dq_reference=None)
    assert "the log may hold every n-th sample only" in told(every(samples, 4))


@pytest.mark.accuracy
def test_a_delay_beyond_what_can_be_taken_out_is_told(good, monkeypatch):
    monkeypatch.setattr(selection, "_REFINEMENTS", 0)  # dividing cells in vain would take ten seconds
    found = fitted(logged_late(good.samples.part(0, 20_000), 7))
    assert delay_of(found).doubtful
    assert any("at the limit of what can be corrected" in warning for warning in found.report.warnings)


@pytest.mark.accuracy
def test_a_slow_rotor_is_told():
    assert "electrical within a window" in told(simulate(speeds=(10.0,)).samples)


@pytest.mark.accuracy
def test_without_generating_currents_there_is_no_mirror(good):
    samples = replace(good.samples, i_dq_reference=None)
    one_sided = only(samples, frames.to_dq(samples.i_abc, samples.angle)[:, 1] > 0)
    (entry,) = (entry for entry in fitted(one_sided).calibrations if entry.name == "resolver_offset")
    assert not entry.applied
    assert "only one sign of i_q" in entry.message


def test_only_exact_coincidences_confound_orders():
    assert distinct_orders((1, 2, 6, 12, 18, 24), 2 * np.pi / 50) == (1, 2, 6, 12, 18, 24)
    assert distinct_orders((6, 12, 18, 24, 26, 48, 50), 2 * np.pi / 50) == (6, 12, 18, 24, 48)
    assert distinct_orders((6, 12, 18, 24), 2 * np.pi / 21.4) == (6, 12, 18, 24)
    assert distinct_orders((6, 12, 18, 24), 2 * np.pi / 24) == (6, 12)


@pytest.mark.accuracy
def test_a_voltage_of_the_wrong_size_is_named_with_its_phase_and_is_no_mismatch_of_the_currents(good):
    """A gain of one phase implies a common part, which no data show: the map is off by it, and the user is told."""
    found = fitted(replace(good.samples, u_abc=good.samples.u_abc * [1.0, 1.0, 0.98]))
    assert not named(found, "current_gain_mismatch")[1]
    mismatch = next(entry for entry in found.calibrations if entry.name == "voltage_gain_mismatch")
    assert mismatch.applied
    assert abs(mismatch.value) == pytest.approx(0.02 / 3, rel=0.1)
    (sentence,) = (warning for warning in found.report.warnings if "voltages' gains differ" in warning)
    assert "as if phase c were -2 % off" in sentence
    assert "cannot be detected" in sentence
