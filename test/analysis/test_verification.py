"""A map that is right passes on a recording of its own; what was changed is found, and where."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import drive_id
from drive_id.analysis.verification import GOLDEN, VerificationLimits, verify
from drive_id.bench.settings import SimulationSettings
from drive_id.cli.app import app
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.errors import CoverageError
from drive_id.files.write.writer import write_recording
from drive_id.reporting.page.certificate import verdict

LIMITS = VerificationLimits()


@pytest.fixture(scope="module")
def result():
    return drive_id.fit(drive_id.simulate("ipm", 5.0, noise=1e-3, seed=1))


@pytest.fixture(scope="module")
def other():
    """Another trajectory at another speed, with a torque sensor."""
    settings = SimulationSettings(log_scalars=("shaft_torque",))
    trajectory = Lissajous(frequency_d=5.3, frequency_q=1.9)
    return drive_id.simulate("ipm", 4.0, speed=900.0, noise=1e-3, seed=2, trajectory=trajectory, settings=settings)


def figures(found, limits=LIMITS):
    return {entry.name: entry for entry in found.judged(limits)}


def with_map(result, psi_d):
    flux_map = replace(result.flux_map, psi_d=psi_d)
    return replace(result, drive=replace(result.drive, flux_map=flux_map))


@pytest.mark.accuracy
def test_a_right_map_passes(result, other):
    found = verify(result, other)
    assert all(entry.passed is not False for entry in found.judged(LIMITS))
    assert 0.5 < figures(found)["Flux, rms of all cells"].value < 1.5
    assert np.mean(np.abs(found.in_sigma) < 1.96) > 0.88
    assert abs(found.resistance[0]) < 3 * found.resistance[1]
    assert found.torque.gain == pytest.approx(1.0, abs=3e-3)
    assert found.coverage == pytest.approx(1.0, abs=0.05)


def test_a_dent_is_found_where_it_is(result, other):
    m, radius = result.flux_map, result.i_max
    dent = np.exp(-(((m.i_d[:, None] + 0.5 * radius) ** 2 + (m.i_q - 0.4 * radius) ** 2) / (0.35 * radius) ** 2))
    largest = float(np.nanmax(np.abs(m.psi_d)))
    found = verify(with_map(result, m.psi_d + 0.02 * largest * dent), other)
    worst = found.i_dq[np.argmax(np.abs(found.difference[:, 0]))]
    assert np.hypot(*(worst - radius * np.array([-0.5, 0.4]))) < 0.25 * radius
    assert found.difference[:, 0].min() == pytest.approx(-0.02 * largest, rel=0.4)
    assert figures(found)["Flux, worst cell"].passed is False


def test_a_resistance_is_told_from_a_drop(result, other):
    warm = replace(result, drive=replace(result.drive, resistance=1.1 * result.resistance))
    assert verify(warm, other).resistance[0] == pytest.approx(1 / 1.1 - 1, abs=0.01)
    weak = replace(result.drive, inverter_voltage=0.9 * result.drive.inverter_voltage)
    found = verify(replace(result, drive=weak), other)
    assert found.drop[0] == pytest.approx(1 / 0.9 - 1, abs=0.01)


def test_currents_outside_the_map_are_refused(result, other):
    nowhere = replace(result.flux_map, inside=np.zeros_like(result.flux_map.inside))
    with pytest.raises(CoverageError, match="Hardly any of the recording"):
        verify(replace(result, drive=replace(result.drive, flux_map=nowhere)), other)


def test_command(result, other, tmp_path):
    result.save(tmp_path / "golden", draw=False)
    write_recording(tmp_path / "unit", other, other.truth, scalar_periods={"shaft_torque": other.sample_period})
    call = ["verify", str(tmp_path / "golden"), "--bag", str(tmp_path / "unit")]
    page = tmp_path / "certificate.html"
    passed = CliRunner().invoke(app, [*call, "--output", str(page)])
    assert passed.exit_code == 0, passed.output
    text = page.read_text()
    assert "PASSED</strong> all figures" in text
    assert "sha256" in text
    (tmp_path / "limits.yaml").write_text("flux: 0.001\ntorque: 2\n")
    failed = CliRunner().invoke(app, [*call, "--golden", str(tmp_path / "limits.yaml"), "--json"])
    tree = json.loads(failed.stdout)
    assert (failed.exit_code, tree["passed"]) == (3, False)
    assert {entry["name"]: entry["passed"] for entry in tree["figures"]} == {
        "Flux, rms of all cells": None, "Flux, worst cell": None, "Flux, largest difference": False,
        "Magnet flux": True, "Resistance": True, "Inverter drop": None, "Torque": True, "Disc recorded, at least": True,
    }  # fmt: skip


def test_golden_limits_see_a_weak_magnet_and_do_not_judge_what_was_not_recorded(result, other):
    m, silent = result.flux_map, replace(other, shaft_torque=None)
    magnet = float(m.psi_dq(0.0, 0.0)[0])
    weak = verify(with_map(result, m.psi_d + 0.08 / 0.92 * magnet), silent)
    assert weak.magnet[0] == pytest.approx(-0.08, abs=0.005)
    assert figures(weak, GOLDEN)["Magnet flux"].passed is False
    limits = replace(GOLDEN, torque=3.0)
    good = verify(result, silent).judged(limits)
    assert {entry.passed for entry in good} == {True, None}
    assert verdict(good) == (
        "Passed: all figures that were measured are within their limits. Not judged: torque (no torque was recorded, "
        "or the pole pairs are unknown)."
    )


def test_a_difference_that_no_control_notices_passes_in_any_number_of_standard_errors(result, other):
    found = verify(result, other)
    small = replace(found, sigma=found.sigma / 3)
    assert figures(small)["Flux, rms of all cells"].value > 1.5
    assert figures(small)["Flux, rms of all cells"].passed
    assert figures(small, replace(LIMITS, negligible=0.0))["Flux, rms of all cells"].passed is False
