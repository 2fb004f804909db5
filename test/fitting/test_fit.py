"""Simulate, record, fit: the same from Python as from the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from drive_bags import TRAJECTORY
from rich.console import Console

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.accumulation.excerpts import Spans
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identify import score
from drive_id.errors import ConfigurationError, DataError, OutputError, ResultError
from drive_id.files.write.writer import write_recording
from drive_id.fitting import streaming
from drive_id.fitting.fit import accumulate_bags, fit, fit_bags
from drive_id.fitting.simulated import load_machine, run_experiment, simulate, simulate_bag
from drive_id.fitting.sources import Sources
from drive_id.reporting.tables import fit_table
from drive_id.types import Samples

SHORT = SimulationSettings()


def cells(table) -> dict[str, tuple[str, ...]]:
    columns = [list(column.cells) for column in table.columns]
    return {row[0]: tuple(row[1:]) for row in zip(*columns, strict=True)}


@pytest.mark.cases
@pytest.mark.parametrize(("machine", "error"), [("ipm", 2e-3), ("spm", 4e-3), ("pmsyrm", 2e-2)])
def test_simulate_then_fit_recovers_the_truth(machine, error, tmp_path):
    """Ideal but for an inverter of the model's own shape; the pmsyrm saturates more sharply than 8 splines can bend."""
    settings = SimulationSettings(inverter="tanh", inverter_current=1.0, harmonics=0.0)
    simulation = simulate_bag(machine_map(machine), settings, tmp_path / "bag", TRAJECTORY, 2.0)
    fit = fit_bags(Sources([tmp_path / "bag"]), tmp_path / "out", FitSettings(method="joint"))
    truth, found = simulation.truth, fit.drive
    assert max(fit.provenance.nrmse) < error
    assert found.resistance == pytest.approx(truth.resistance, rel=0.05)
    assert found.voltage_error == pytest.approx(truth.inverter_voltage.max(), rel=0.05)
    assert found.i_max == pytest.approx(truth.i_max, rel=1e-5)
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert files == ["diagnostics.npz", "flux_map.npz", "identification.json"]
    psm = fit_bags(Sources([tmp_path / "bag"]), None, FitSettings(method="psm"))
    assert max(psm.provenance.nrmse) > 2 * max(fit.provenance.nrmse)
    assert psm.drive.voltage_error == 0.0


@pytest.mark.accuracy
def test_a_recorded_torque_is_compared_on_every_way_from_bags_to_a_result(tmp_path, monkeypatch):
    """From a bag that is kept whole, an information file, and excerpts of a bag that is too long for that."""
    settings = SimulationSettings(log_scalars=("shaft_torque",), current_gain=(1.02, 1.02, 1.02), harmonics=0.0)
    simulate_bag(machine_map("ipm"), settings, tmp_path / "bag", TRAJECTORY, 2.0)
    fit = FitSettings(method="joint", i_max=300.0)
    whole = fit_bags(Sources([tmp_path / "bag"]), tmp_path / "out", fit)
    accumulate_bags(Sources([tmp_path / "bag"]), tmp_path / "x.info", fit)
    stored = fit_bags(Sources([tmp_path / "x.info"]), None, fit)
    for result in (whole, stored):
        torque = result.drive.torque
        assert torque.gain == pytest.approx(1 / 1.02, abs=3e-3)
        assert torque.samples > 18_000
    tree = json.loads((tmp_path / "out" / "identification.json").read_text())["torque"]
    assert tree["gain"] == whole.drive.torque.gain
    assert cells(fit_table(whole))["Shaft torque / torque of the map"][0].startswith(
        f"{whole.drive.torque.gain:.4f} ± "
    )
    settings = replace(settings, scalar_rate=500.0, log_scalars=("shaft_torque", "winding_temperature"))
    monkeypatch.setattr(streaming, "Spans", partial(Spans, 4000, 8))
    simulate_bag(machine_map("ipm"), settings, tmp_path / "long", TRAJECTORY, 5.0)
    found = fit_bags(Sources([tmp_path / "long"]), None, fit)
    assert found.drive.torque.gain == pytest.approx(1 / 1.02, abs=3e-3)
    assert found.drive.torque.samples <= 32_000
    assert all(piece.winding_temperature is not None for piece in found.excerpts)


def test_the_truth_of_a_simulation_is_never_used_by_the_fit(simulation, fitted, tmp_path):
    write_recording(tmp_path / "bag", simulation.samples)
    blind = fit_bags(Sources([tmp_path / "bag"]), None, FitSettings(method="joint"))
    assert blind.provenance.nrmse is None
    assert blind.provenance.machine == ""
    assert blind.resistance == fitted.resistance
    assert "Truth" not in [column.header for column in fit_table(blind).columns]


def test_a_map_beyond_thin_data_stays_within_reason():
    """At 50 rpm for 1 s hardly a coefficient is known, and some are 1e9 Wb: they were continued into the map."""
    slow = simulate("ipm", speed=50.0, seconds=1.0, noise=0.001, seed=1)
    found = fit(slow, method="joint").flux_map
    assert np.abs([found.psi_d, found.psi_q]).max() < 5 * found.largest
    i_d, i_q = np.moveaxis(found.grid(), -1, 0)
    between = found.psi_dq(i_d[:-1] + 0.3 * np.diff(i_d, axis=0), i_q[:-1])
    assert np.nanmax(np.abs(between)) < 1.2 * found.largest


def test_bags_of_two_machines_are_not_fitted_together(bag, simulation, tmp_path):
    simulate_bag(machine_map("spm"), SHORT, tmp_path / "spm", TRAJECTORY, 1.0)
    for settings in (FitSettings(method="joint"), FitSettings(method="full", i_max=300.0)):  # and before any check
        with pytest.raises(DataError, match=rf"different machines \(ipm in {bag}, spm in .*spm\): fit each"):
            fit_bags(Sources([bag, tmp_path / "spm"]), None, settings)
    write_recording(tmp_path / "blind", simulation.samples)
    fit = fit_bags(Sources([tmp_path / "blind", tmp_path / "spm"]), None, FitSettings(method="joint"))
    assert fit.provenance.nrmse is None


def test_settings_that_the_method_does_not_look_at_are_named(bag):
    (warning,) = fit_bags(Sources([bag]), None, FitSettings("psm", maps="free", u_dc=(400.0,))).provenance.warnings
    assert warning == "Method psm ignores maps, u_dc: remove them, or use method full."
    with pytest.raises(ConfigurationError, match="u_dc has 2 entries for 1 recording:"):
        fit_bags(Sources([bag]), None, FitSettings(u_dc=(400.0, 300.0)))


def test_nothing_is_simulated_or_fitted_for_an_output_that_cannot_be(bag, tmp_path, monkeypatch):
    def fail(*_args, **_options):
        raise AssertionError("too late")

    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes").touch()
    monkeypatch.setattr("drive_id.fitting.fit.accumulate", fail)
    monkeypatch.setattr("drive_id.bench.drive.simulate", fail)
    with pytest.raises(OutputError):
        fit_bags(Sources([bag]), tmp_path / "full", FitSettings(method="joint"))
    with pytest.raises(OutputError):
        simulate_bag(machine_map("ipm"), SHORT, tmp_path / "full", TRAJECTORY, 1.0)


def test_progress_is_told_in_order(bag, tmp_path):
    told = []
    fit_bags(
        Sources([bag]),
        tmp_path / "out",
        FitSettings(method="joint"),
        tell=lambda what, share: told.append((what, share)),
    )
    assert list(dict.fromkeys(what for what, _ in told)) == [
        "Reading", "Accumulating", "Solving", "Writing",
    ]  # fmt: skip
    shares = [share for what, share in told if what == "Accumulating"]
    assert [share for what, share in told if what in {"Solving", "Writing"}] == [None, None]  # nobody knows how long
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    assert all(0 <= share <= 1 for what, share in told if what in {"Reading", "Accumulating"})


def test_warnings_of_reading_stand_before_those_of_the_fit(simulation, tmp_path):
    cut = [simulation.samples.part(*ends) for ends in ((0, 8000), (8500, 20_000))]
    write_recording(tmp_path / "bag", Samples.joined(cut))
    fit = fit_bags(Sources([tmp_path / "bag"]), tmp_path / "out", FitSettings(method="joint"))
    assert fit.drive.report.gaps == 1
    assert fit.warnings == (*fit.provenance.warnings, *fit.drive.report.warnings)
    assert json.loads((tmp_path / "out" / "identification.json").read_text())["warnings"] == list(fit.warnings)


def test_an_experiment_takes_its_radius_from_settings_or_machine():
    for settings, radius in ((SHORT, 300.0), (replace(SHORT, i_max=120.0), 120.0)):
        simulation = run_experiment(machine_map("ipm"), settings, TRAJECTORY, 0.5)
        reference = np.hypot(*simulation.samples.i_dq_reference.T)
        assert reference.max() == pytest.approx(radius, rel=0.01)
        assert simulation.truth.i_max == radius


@pytest.mark.parametrize("seconds", [0.0, -1.0, 1.5e-4, float("nan"), float("inf"), 1e9])
def test_durations_that_are_no_experiment(seconds):
    with pytest.raises(ConfigurationError, match="choose a duration"):
        run_experiment(machine_map("ipm"), SHORT, seconds=seconds)


def test_machines_by_name_and_by_file(tmp_path):
    assert load_machine("spm").name == "spm"
    source = machine_map("spm")
    arrays = {"id": source.i_d, "iq": source.i_q, "psi_d": source.psi_d, "psi_q": source.psi_q}
    np.savez(tmp_path / "mine.npz", **arrays, R=0.35, pole_pairs=3, i_max=20.0, u_dc=325.0)
    np.testing.assert_array_equal(load_machine(str(tmp_path / "mine.npz")).psi_d, source.psi_d)
    for name in ("apm", "", "none.npz", "none.mat", "x" * 300, "a\nb"):
        with pytest.raises(ConfigurationError):
            load_machine(name)
    with pytest.raises(ResultError, match="is not a result folder"):
        load_machine(str(tmp_path))
    assert load_machine("spm", u_dc=100.0, pole_pairs=7).u_dc == 100.0


def test_the_table_says_what_was_found(fitted):
    table = cells(fit_table(fitted))
    truth = fitted.truth
    assert table["R"][1] == "10 mΩ"
    assert (
        table["Inverter drop"][1] == f"{np.interp(truth.i_max, truth.inverter_current, truth.inverter_voltage):.4g} V"
    )
    assert table["Samples used"][0] == "19999 of 20000"
    diverged = replace(fitted.drive.report, mad_d=float("nan"))
    other = replace(fitted, drive=replace(fitted.drive, report=diverged))
    assert cells(fit_table(other))["Mean error of simulated i_d / i_q"][0].startswith("diverged / ")
    short = replace(fitted, drive=replace(fitted.drive, sigma_resistance=float("inf")))
    assert cells(fit_table(short))["R"][0] == f"{1e3 * fitted.resistance:.4g} mΩ"


@pytest.mark.parametrize("width", [60, 80, 120])
def test_names_and_numbers_stay_whole_on_a_narrow_terminal(fitted, width):
    table = fit_table(fitted, verbose=True)
    with Console(width=width).capture() as capture:
        capture._console.print(table)
    lines = capture.get().splitlines()
    for quantity in fitted.headline:
        assert any(f" {quantity.name} " in line and f" {quantity} " in line for line in lines), quantity.name
    assert max(map(len, lines[1:])) <= width


def test_the_true_drop_is_the_one_at_the_radius_of_the_disc(fitted):
    """Where the curve ends at the radius, and goes on rising up to there."""
    current = np.linspace(-300.0, 300.0, 5)
    truth = replace(fitted.truth, inverter_current=current, inverter_voltage=current / 100, i_max=300.0)
    other = replace(fitted, truth=truth)
    assert cells(fit_table(other))["Inverter drop"][1] == "3 V"


def test_only_the_map_with_data_is_scored(fitted):
    """A truth that is far off where the map claims nothing costs nothing."""
    truth, identification = fitted.truth, fitted.drive
    known = identification.flux_map.inside & (identification.flux_map.i_d > 60)[:, None]
    right_half = replace(identification, flux_map=replace(identification.flux_map, inside=known))
    off = replace(truth, psi_d=truth.psi_d + (truth.i_d < 0)[:, None])
    assert max(score(right_half, off)) < 0.05
    assert score(identification, off)[0] > 0.2


def test_joint_errors_add_up_to_those_of_the_map_and_reach_where_data_enclose_a_current():
    settings = SimulationSettings(current_noise=1e-3, seed=1)
    samples = run_experiment(machine_map("ipm"), settings, TRAJECTORY, seconds=2.0).samples
    found = fit(samples).drive
    inside, modes = found.flux_map.inside, found.error_modes
    for errors, sigma in ((modes.psi_d, found.flux_map.sigma_d), (modes.psi_q, found.flux_map.sigma_q)):
        np.testing.assert_allclose(np.linalg.norm(errors, axis=0)[inside], sigma[inside], rtol=0.02)
    assert modes.known[inside].all()
    assert (modes.known & ~inside).sum() > 100
