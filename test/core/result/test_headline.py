"""The quantities that are asked for first, on a machine whose map is a formula."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from exact_results import exact_result

from drive_id.common.quantity import measured
from drive_id.core.maps.error_modes import ErrorModes
from drive_id.core.result.headline import headline, slopes
from drive_id.types import MachineMap

PSI_PM, L_D, L_Q, I_MAX, PAIRS = 0.066, 1.5e-4, 3.6e-4, 100.0, 4
AXIS = np.linspace(-110.0, 110.0, 56)  # without a node at zero current
FLUX_ERROR, L_ERROR = 2e-5, 3e-7


def flux(i_d, i_q):
    return PSI_PM + L_D * i_d - 3e-9 * i_q**2, (L_Q - 6e-9 * i_d) * i_q - 4e-9 * i_q**3


@pytest.fixture
def drive():
    """A drive with two causes of error: a common psi_d, and an error of L_q."""
    d, q = np.meshgrid(AXIS, AXIS, indexing="ij")
    psi_d, psi_q = flux(d, q)
    machine = MachineMap(
        name="formula", i_d=AXIS, i_q=AXIS, psi_d=psi_d, psi_q=psi_q, resistance=0.01, pole_pairs=PAIRS, i_max=I_MAX,
        u_dc=400.0,
    )  # fmt: skip
    inside = np.hypot(d, q) <= I_MAX + 6.0
    modes = ErrorModes(
        psi_d=np.float32(np.stack([inside * FLUX_ERROR, 0 * d])),
        psi_q=np.float32(np.stack([0 * d, inside * L_ERROR * q])),
        resistance=np.zeros(2),
        inverter_voltage=np.zeros((2, 201)),
        voltage_error=np.zeros(2),
    )
    exact = exact_result(machine, sigma=FLUX_ERROR, error_modes=modes, sigma_resistance=1.1e-5).drive
    return replace(exact, flux_map=replace(exact.flux_map, inside=inside))


def test_the_report_has_the_standard_errors_of_slopes_of_the_headline(drive):
    """At a node and beside the edge; the joint errors hold short waves, which differences of neighbours smooth."""
    axis = np.linspace(-110.0, 110.0, 45)
    d, q = np.meshgrid(axis, axis, indexing="ij")
    psi_d, psi_q = flux(d, q)
    inside = np.hypot(d, q) <= I_MAX
    k = 0.7 / 5.0
    modes = replace(
        drive.error_modes,
        psi_d=np.float32(FLUX_ERROR * inside * np.stack([1 + np.sin(k * d + 0.4), np.cos(k * d - k * q)])),
        psi_q=np.float32(FLUX_ERROR * inside * np.stack([1 + np.sin(k * q), np.cos(k * q + 1.0)])),
    )
    found = replace(drive.flux_map, i_d=axis, i_q=axis, psi_d=psi_d, psi_q=psi_q, inside=inside)
    told = {q.name: q for q in headline(replace(drive, flux_map=found, error_modes=modes))}
    zero = 22
    for name, psi, along in (("L_d", modes.psi_d, -2), ("L_q", modes.psi_q, -1)):
        sigma = np.linalg.norm(slopes(psi, inside, axis, along), axis=0)
        assert sigma[zero, zero] == pytest.approx(told[f"{name} at zero current"].sigma, rel=1e-6)
        assert np.isfinite(sigma[inside & (np.hypot(d, q) < 0.8 * I_MAX)]).all()
        assert np.isnan(sigma[~inside]).all()
        exact = np.linalg.norm(np.gradient(psi, 5.0, axis=along), axis=0)[zero, zero]
        assert sigma[zero, zero] > 1.05 * exact


def named(drive, **known):
    return {quantity.name: quantity for quantity in headline(drive, **known)}


def best_torque(radius):
    angle = np.linspace(0.0, np.pi, 1_000_001)
    i_d, i_q = radius * np.cos(angle), radius * np.sin(angle)
    psi_d, psi_q = flux(i_d, i_q)
    torque = 1.5 * PAIRS * (psi_d * i_q - psi_q * i_d)
    best = torque.argmax()
    return i_d[best], i_q[best], torque[best]


def test_values_and_standard_errors_are_those_of_the_formula(drive):
    found = named(drive, pole_pairs=PAIRS, temperature=20.0)
    assert list(found) == [
        "ψ_PM", "L_d at zero current", "L_q at zero current", "L_d at 95 A, MTPA", "L_q at 95 A, MTPA", "R at 20 °C",
        "Inverter drop", "i_max", "Torque at i_max, MTPA", "Torque per A at i_max, MTPA",
    ]  # fmt: skip
    (d, q, torque), (d_95, q_95, _) = (best_torque(radius) for radius in (I_MAX, 95.0))
    expected = {
        "ψ_PM": (PSI_PM, FLUX_ERROR),
        "L_d at zero current": (L_D, 0.0),
        "L_q at zero current": (L_Q, L_ERROR),
        "L_d at 95 A, MTPA": (L_D, 0.0),
        "L_q at 95 A, MTPA": (L_Q - 6e-9 * d_95 - 12e-9 * q_95**2, L_ERROR),
        "R at 20 °C": (0.01, 1.1e-5),
        "Torque at i_max, MTPA": (torque, 1.5 * PAIRS * math.hypot(FLUX_ERROR * q, L_ERROR * q * d)),
    }
    for name, (value, sigma) in expected.items():
        assert found[name].value == pytest.approx(value, rel=2e-4 if "95" in name else 2e-5), name
        assert found[name].sigma == pytest.approx(sigma, rel=2e-3, abs=1e-10), name
    assert str(found["R at 20 °C"]) == "10.000 ± 0.011 mΩ"
    assert "temperature" not in found["R at 20 °C"].note
    assert named(drive)["R"].note.startswith("At the temperature of the recording. ")


def covered(drive, inside, known=None):
    """The drive with data, and with joint errors where nothing else is said, in a part of the plane only."""
    known = inside if known is None else known
    modes = replace(drive.error_modes, psi_d=drive.error_modes.psi_d * known, psi_q=drive.error_modes.psi_q * known)
    return replace(drive, flux_map=replace(drive.flux_map, inside=inside), error_modes=modes)


def test_what_the_data_do_not_cover_is_left_out(drive):
    inside, (d, q) = drive.flux_map.inside, np.meshgrid(AXIS, AXIS, indexing="ij")
    found = named(covered(drive, inside & (np.hypot(d, q) > 30.0)), pole_pairs=PAIRS)
    assert list(found)[:4] == ["L_d at 95 A, MTPA", "L_q at 95 A, MTPA", "R", "Inverter drop"]
    assert "Torque at i_max, MTPA" in found
    assert "Torque at 80 A, MTPA" in named(covered(drive, np.hypot(d, q) <= 85.0), pole_pairs=PAIRS)
    assert not any("at" in name for name in named(covered(drive, inside & (q < -10.0)), pole_pairs=PAIRS))


def test_what_the_data_enclose_is_told_with_its_standard_error(drive):
    inside, (d, q) = drive.flux_map.inside, np.meshgrid(AXIS, AXIS, indexing="ij")
    whole = named(drive, pole_pairs=PAIRS)
    ring = named(covered(drive, inside & (np.hypot(d, q) > 30.0), inside), pole_pairs=PAIRS)
    for name in ("ψ_PM", "L_d at zero current", "L_q at zero current"):
        assert ring[name].value == whole[name].value
        assert ring[name].sigma == pytest.approx(whole[name].sigma, rel=1e-5, abs=1e-12)
        assert "No sample lies there" in ring[name].note
        assert "No sample" not in whole[name].note
    few = named(covered(drive, inside & (np.hypot(d - 20, q - 70) > 25), inside), pole_pairs=PAIRS)
    assert few["Torque at i_max, MTPA"] == whole["Torque at i_max, MTPA"]


def test_data_that_end_at_zero_current_tell_it_with_the_standard_error_of_the_continuation(drive):
    """A recording of i_d < 0 only, as many are: its last grid point lies before zero."""
    inside, (d, _) = drive.flux_map.inside, np.meshgrid(AXIS, AXIS, indexing="ij")
    drive.error_modes.psi_d[1] = 1e-6 * (-1.0) ** np.arange(len(AXIS))[:, None]
    whole, half = named(drive), named(covered(drive, inside & (d < 0)))
    for name in ("ψ_PM", "L_d at zero current", "L_q at zero current"):
        assert half[name].value == pytest.approx(whole[name].value, rel=1e-4)
        assert half[name].sigma > whole[name].sigma or name == "L_q at zero current"
        assert "The data end beside it" in half[name].note
    assert "ψ_PM" not in named(covered(drive, inside & (d < -5.0)))


def test_slopes_at_large_current_are_told_with_sound_standard_errors_only(drive):
    assert not any("L_q at 95" in name for name in named(replace(drive, method="joint")))
    assert not any("L_q at 95" in name for name in named(replace(drive, error_modes=None)))
    modes = drive.error_modes
    vague = named(replace(drive, error_modes=replace(modes, psi_q=modes.psi_q * np.float32(900.0))))
    assert re.fullmatch(r"2\d\d ± 270 µH", str(vague["L_q at 95 A, MTPA"]))
    assert vague["L_q at 95 A, MTPA"].note.startswith("The data hardly define it. Incremental")
    assert str(vague["L_d at 95 A, MTPA"]) == "150 µH"


def test_what_is_not_known_is_left_out(drive):
    assert not any("Torque" in name for name in named(drive))
    imported = replace(drive, method="imported", resistance=math.nan, error_modes=None)
    found = named(imported, pole_pairs=PAIRS)
    assert "R" not in found
    assert "Inverter drop" not in found
    assert all(math.isnan(found[name].sigma) for name in found if name != "ψ_PM")


def test_a_rated_current_is_where_loaded_values_are_told(drive):
    found = named(drive, pole_pairs=PAIRS, rated=60.0)
    assert list(found)[3:5] == ["L_d at 60 A, MTPA", "L_q at 60 A, MTPA"]
    *_, torque = best_torque(60.0)
    assert found["Torque at 60 A, MTPA"].value == pytest.approx(torque, rel=1e-6)
    assert found["Torque per A at 60 A, MTPA"].value == pytest.approx(torque / 60.0, rel=1e-6)
    assert "Torque at i_max, MTPA" in found
    assert named(drive, rated=99.0).keys() == named(drive).keys()  # beyond where slopes are known


def test_an_offset_of_a_current_is_told_in_the_unit_of_the_currents(drive):
    assert measured(1.1e-4, 9.3e-4, "A", drive.sizes["A"]) == "0.00011 ± 0.00093 A"
