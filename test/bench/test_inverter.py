"""The inverter's laws: closed forms and the properties that every law shares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid

from drive_id.bench.inverter import drop_curve, phase_drop_of
from drive_id.bench.kernels import phase_drops
from drive_id.bench.settings import INVERTERS, SimulationSettings

U_DC, I_MAX = 400.0, 300.0
CURRENT = np.linspace(-1.2 * I_MAX, 1.2 * I_MAX, 4001)


def drop(**settings: object) -> np.ndarray:
    return phase_drops(phase_drop_of(SimulationSettings(**settings), U_DC, I_MAX), CURRENT)  # type: ignore[arg-type]


@pytest.mark.parametrize("law", INVERTERS)
def test_every_law_is_odd_monotone_and_takes_power(law):
    u = drop(inverter=law)
    np.testing.assert_allclose(u, -u[::-1], atol=1e-12)
    assert np.all(np.diff(u) >= 0)
    assert np.all(u * CURRENT >= 0)


def test_none_is_zero():
    assert not drop(inverter="none").any()


def test_tanh_as_printed():
    u = drop(inverter="tanh", inverter_voltage=5.0, inverter_current=1.0)
    np.testing.assert_allclose(u, 5.0 * np.tanh(CURRENT), atol=1e-14)


def test_dead_time_is_the_volt_seconds_of_a_charging_leg():
    """Oracle: integrate the output of a leg over the dead time, its capacitance charged linearly by the current."""
    charge, fraction = 3.0, np.linspace(0, 1, 20001)
    u = drop(inverter="dead_time", inverter_voltage=4.0, inverter_current=charge)
    for k in (2000, 2005, 2015, 2100, 3000, 4000):
        left_over = np.clip(1 - CURRENT[k] / charge * fraction, 0, 1)  # of the DC link, after switching off
        np.testing.assert_allclose(u[k], 4.0 * (1 - trapezoid(left_over, fraction)), atol=1e-7)


def test_two_stage_adds_threshold_and_slope():
    chosen = {"inverter_voltage": 4.0, "inverter_current": 3.0}
    both = drop(inverter="two_stage", device_voltage=0.9, device_resistance=0.002, **chosen)
    difference = both - drop(inverter="dead_time", **chosen)
    np.testing.assert_allclose(difference, 0.9 * np.tanh(CURRENT / 3.0) + 0.002 * CURRENT, atol=1e-12)


def test_defaults_scale_with_the_drive():
    small = phase_drop_of(SimulationSettings(inverter="two_stage"), U_DC, I_MAX)
    large = phase_drop_of(SimulationSettings(inverter="two_stage"), 2 * U_DC, I_MAX)
    np.testing.assert_allclose(phase_drops(large, CURRENT), 2 * phase_drops(small, CURRENT), atol=1e-12)
    assert 3.0 < phase_drops(small, np.array([I_MAX]))[0] < 7.0


def test_curve_of_the_truth_covers_the_currents_and_resolves_the_bend():
    current, voltage = drop_curve(phase_drop_of(SimulationSettings(inverter="tanh"), U_DC, I_MAX), I_MAX)
    assert current[0] == -1.2 * I_MAX
    assert current[-1] == 1.2 * I_MAX
    assert np.all(np.diff(current) > 0)
    np.testing.assert_allclose(np.interp(CURRENT, current, voltage), 4.0 * np.tanh(CURRENT / 3.0), atol=2e-3)
