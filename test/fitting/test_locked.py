"""A locked rotor: the flux at its position minus that at zero current, and nothing that needs a turning machine."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import drive_id
from drive_id.bench.drive import build_machine
from drive_id.bench.machines import machine_map
from drive_id.errors import ConfigurationError, DataError, StandstillError
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import accumulate_bags
from drive_id.fitting.simulated import simulate
from drive_id.fitting.sources import Sources

POSITIONS = {"ipm": 0.3, "spm": 1.1, "pmsyrm": 2.0}
LOCKED = drive_id.FitSettings(method="locked")


def locked(machine, position, **settings):
    settings = drive_id.SimulationSettings(start_angle=position, **settings)
    return simulate(machine, 8.0, speed=0.0, noise=1e-3, seed=2, settings=settings)


@cache
def recorded(machine):
    return locked(machine, POSITIONS[machine])


@cache
def fitted(machine):
    return drive_id.fit(recorded(machine), settings=LOCKED)


@pytest.mark.accuracy
@pytest.mark.parametrize("machine", POSITIONS)
def test_the_flux_at_the_position_of_the_rotor_is_found(machine):
    result, found = fitted(machine), fitted(machine).flux_map
    true_machine = build_machine(machine_map(machine), drive_id.SimulationSettings())
    grid, inside = found.grid(), found.inside
    i_dq = grid[inside & (np.hypot(*np.moveaxis(grid, -1, 0)) < 0.98 * true_machine.i_max)]
    at, zero = (true_machine.flux(*x.T, np.full(len(x), POSITIONS[machine])) for x in (i_dq, np.zeros((1, 2))))
    true = at - zero
    psi, sigma = (np.stack(of(*i_dq.T), axis=-1) for of in (found.psi_dq, found.sigma))
    nrmse = np.sqrt(np.mean((psi - true) ** 2, axis=0)) / np.abs(true).max(axis=0)
    assert (nrmse < 3e-3).all()
    mean = true_machine.mean_flux(*i_dq.T) - true_machine.mean_flux(0.0, 0.0)
    assert np.sqrt(np.mean((mean - true) ** 2)) > 2 * np.sqrt(np.mean((psi - true) ** 2))  # which it is not
    assert 0.85 < np.mean(np.abs(psi - true) < 1.96 * sigma) <= 1.0
    assert np.abs(found.psi_dq(0.0, 0.0)).max() < 2e-4 * np.abs(true).max()
    assert abs(result.resistance - recorded(machine).truth.resistance) < 3 * result.sigma_resistance
    assert [said.code for said in result.warnings] == ["locked_rotor"]
    assert np.cos(result.warnings[0].values["angle"] - POSITIONS[machine]) == pytest.approx(1.0, abs=1e-6)


def test_what_needs_a_turning_machine_is_left_out_or_refused(tmp_path):
    result = fitted("ipm")
    names = " ".join(quantity.name for quantity in result.headline)
    assert "L_d at zero current" in names
    assert "ψ_PM" not in names
    assert "Torque" not in names
    assert np.isnan(result.metrics["nrmse_d"])
    for refused in (
        lambda: drive_id.analyze(result),
        lambda: drive_id.export(result, "csv", tmp_path / "map.csv"),
        lambda: drive_id.export(result, "machine", tmp_path / "machine.npz"),
        result.to_machine,
    ):
        with pytest.raises(ConfigurationError, match="The rotor was locked, so the magnets' flux is unknown"):
            refused()
    assert list(tmp_path.iterdir()) == []
    result.save(tmp_path / "result", draw=False)
    with pytest.raises(ConfigurationError, match="is of a locked rotor, without the magnets' flux"):
        drive_id.import_map(tmp_path / "result" / "flux_map.npz")


def test_it_is_compared_with_its_like_only():
    turning = drive_id.fit(simulate("ipm", 2.0, noise=1e-3, seed=1))
    with pytest.raises(ConfigurationError, match="of a locked rotor"):
        drive_id.compare(fitted("ipm"), turning)
    assert drive_id.compare(fitted("ipm"), fitted("ipm")).torque is None


@pytest.mark.accuracy
def test_an_offset_of_the_speed_and_a_noisy_resolver_are_no_motion():
    samples = recorded("ipm")
    rng = np.random.default_rng(5)
    noisy = replace(
        samples, speed=samples.speed + 0.05, angle=samples.angle + np.deg2rad(0.3) * rng.standard_normal(len(samples))
    )
    assert drive_id.fit(noisy, settings=LOCKED).warnings[0].code == "locked_rotor"


def test_recordings_at_several_positions_are_refused():
    other = locked("ipm", 1.9)
    with pytest.raises(DataError, match=r"varies by 91\.7 degrees electrical, so it was not locked at one position"):
        drive_id.fit([recorded("ipm"), other], settings=LOCKED)


@pytest.mark.accuracy
def test_an_information_file_keeps_what_it_was_checked_for(tmp_path):
    for method, speed, other in (("locked", 0.0, "full"), ("full", 500.0, "locked")):
        bag = tmp_path / method
        write_recording(bag, simulate("ipm", 3.0, speed=speed, noise=1e-3, seed=1))
        settings = drive_id.FitSettings(method=method)
        accumulate_bags(Sources([bag]), tmp_path / f"{method}.info", settings)
        assert drive_id.fit(tmp_path / f"{method}.info", settings=settings).method == method
        with pytest.raises(ConfigurationError, match=f"checked for method {method}"):
            drive_id.fit(tmp_path / f"{method}.info", settings=drive_id.FitSettings(method=other))


def test_other_methods_name_it_and_it_refuses_a_turning_rotor():
    with pytest.raises(StandstillError, match="choose method locked"):
        drive_id.fit(recorded("ipm"))
    with pytest.raises(DataError, match=r"it was not locked at one position\. Clamp it"):
        drive_id.fit(simulate("ipm", 1.0), settings=LOCKED)
