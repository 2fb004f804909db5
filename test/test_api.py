"""The public API as a user types it: fit, load, ask, draw, save, simulate."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drive_bags import TRAJECTORY

import drive_id
from drive_id.core.validation.metrics import nrmse
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import accumulate_bags
from drive_id.fitting.sources import Sources


@pytest.fixture(scope="module")
def result(bag):
    """A fit of a bag by the default method."""
    return drive_id.fit(bag)


@pytest.fixture(scope="module")
def saved(result, tmp_path_factory):
    """Its result folder; read only."""
    folder = tmp_path_factory.mktemp("results") / "saved"
    result.save(folder)
    return folder


def maps_agree(one, other, rel=1e-12):
    for name in ("i_d", "i_q", "psi_d", "psi_q", "sigma_d", "sigma_q"):
        first, second = (getattr(found.flux_map, name) for found in (one, other))
        np.testing.assert_allclose(first, second, rtol=rel, atol=rel * np.nanmax(np.abs(first)), err_msg=name)
    np.testing.assert_array_equal(one.flux_map.inside, other.flux_map.inside)


# -- import ----------------------------------------------------------------------------------------------------------


def test_importing_the_package_loads_nothing():
    code = "import sys, drive_id; print(*sys.modules)"
    modules = set(
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    )
    assert "drive_id" in modules
    assert not {name for name in modules if name.startswith("drive_id.")}
    assert not modules & {"numpy", "scipy", "numba", "yaml", "matplotlib"}


def test_importing_the_package_takes_under_50_ms():
    code = "import time; start = time.perf_counter(); import drive_id; print(time.perf_counter() - start)"
    ran = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(5)]
    assert min(float(one.stdout) for one in ran) < 0.05


def test_all_public_names_are_there():
    for name in drive_id.__all__:
        assert getattr(drive_id, name).__doc__, name
        assert name in dir(drive_id)
    with pytest.raises(AttributeError, match="module 'drive_id' has no attribute 'fitt'"):
        _ = drive_id.fitt


# -- fit -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow  # two fits by the default method
def test_fit_and_the_command_line_give_the_same_numbers(bag, result, run, tmp_path):
    assert run("fit", bag, "--output", tmp_path / "out", "--quiet").code == 0
    drive_id.fit(str(bag), output=tmp_path / "mine")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "mine").iterdir())
    trees = [json.loads((tmp_path / name / "identification.json").read_text()) for name in ("out", "mine")]
    for tree in trees:
        del tree["date"], tree["files"]["flux_map.npz"]  # which holds the date, too
    assert trees[0] == trees[1]
    maps_agree(drive_id.load(tmp_path / "out"), result, rel=0.0)


def test_a_fit_takes_paths_lists_samples_and_information_files(bag, tmp_path):
    options = {"method": "joint", "i_max": 300.0}
    one = drive_id.fit(bag, **options)
    accumulate_bags(Sources([bag]), tmp_path / "one.info", one.provenance.settings)
    for recordings in ([bag], [str(bag)], str(tmp_path / "one.info")):
        found = drive_id.fit(recordings, **options)
        maps_agree(found, one, rel=1e-9)
        assert found.resistance == pytest.approx(one.resistance, rel=1e-9)
    samples = drive_id.read_bag(bag)
    for recordings in (samples, [samples]):
        found = drive_id.fit(recordings, **options)
        maps_agree(found, one, rel=1e-6)
        assert found.metrics["nrmse_d"] == pytest.approx(one.metrics["nrmse_d"], rel=1e-6)
    other = drive_id.simulate("ipm", 1.0, speed=900, noise=1e-3, seed=4, trajectory=TRAJECTORY)
    write_recording(tmp_path / "other", other, other.truth)
    mixed = drive_id.fit([tmp_path / "one.info", tmp_path / "other"], **options)
    together = drive_id.fit([samples, other], **options)
    assert mixed.resistance == pytest.approx(together.resistance, rel=1e-4)
    assert mixed.speed_range == pytest.approx((500 * 4 * np.pi / 30, 900 * 4 * np.pi / 30), rel=1e-3)


def test_the_machine_has_a_name_and_a_serial_number(simulation):
    found = drive_id.fit(simulation.samples, method="psm", machine="EM 3", serial="007")
    assert repr(found).startswith("<Identification: EM 3, serial 007, method psm")


def test_settings_signals_and_stored_settings_are_used(bag, tmp_path):
    topics = "currents: {topic: /phase_currents, fields: [a, b, c], sample_period: sample_period}\n"
    topics += "voltages: {topic: /phase_voltages, fields: [a, b, c], sample_period: sample_period}\n"
    topics += (
        "resolver: {topic: /resolver, angle: angle, mechanical: true, pole_pairs: 1, sample_period: sample_period}\n"
    )
    (tmp_path / "signals.yaml").write_text(topics)
    settings = drive_id.FitSettings("psm", grid_points=33)
    found = drive_id.fit(bag, signals=tmp_path / "signals.yaml", settings=settings, method="joint")
    assert (found.method, found.flux_map.psi_d.shape) == ("joint", (33, 33))
    assert found.i_max != 300.0  # the signals file names no references
    accumulate_bags(Sources([bag]), tmp_path / "x.info", replace(settings, splines_d=6))
    assert drive_id.fit(tmp_path / "x.info").provenance.settings.splines_d == 6


@pytest.mark.parametrize(
    ("recordings", "options", "said"),
    [
        ("none", {}, "There is no none here"),
        ("none", {"method": "best"}, "method is 'best': it must be one of psm, joint, full, locked, static."),
        ("none", {"i_max": -3.0}, "i_max is -3.0 A: it must be at least 0.001 A and at most 1000000.0 A."),
        ([], {}, "No bag is given"),
        (3, {}, "drive_id.fit cannot read recordings from a int: give paths or Samples."),
        ([None], {}, "neither all paths nor all Samples"),
        (
            pd.DataFrame({"a": [1.0]}),
            {},
            "drive_id.fit cannot read recordings from a DataFrame: give paths or Samples.",
        ),
        ("none", {"signals": {"currents": {}}}, "signals is of type dict: give the path of a signals file"),
        ("none.info", {}, "none.info cannot be read"),
        ("none", {"signals": "none.yaml"}, "none.yaml"),
        ("none", {"workers": 0}, "The number of workers is 0: give 1 or more."),
    ],
)
def test_what_cannot_be_fitted_is_said_in_one_sentence(recordings, options, said):
    with pytest.raises(drive_id.DriveIdError) as caught:
        drive_id.fit(recordings, **options)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_samples_are_not_mixed_with_paths_nor_with_options_for_bags(bag, simulation):
    with pytest.raises(drive_id.DriveIdError, match="neither all paths nor all Samples"):
        drive_id.fit([bag, simulation.samples])
    with pytest.raises(drive_id.DriveIdError, match="are about bags: leave them out"):
        drive_id.fit(simulation.samples, namespace="left")


def test_warnings_of_a_recording_are_python_warnings(simulation, tmp_path):
    cut = drive_id.Samples.joined([simulation.samples.part(0, 8000), simulation.samples.part(8500, 20000)])
    write_recording(tmp_path / "bag", cut)
    with pytest.warns(UserWarning, match="gap"):
        samples = drive_id.read_bag(tmp_path / "bag")
    assert samples.truth is None
    assert repr(samples) == "<Samples: 19500 at 10 kHz, 1.95 s, 2 runs, with references>"


# -- the result ------------------------------------------------------------------------------------------------------


def test_a_result_has_what_an_engineer_asks_for(result, simulation):
    truth = simulation.truth
    assert result.resistance == pytest.approx(truth.resistance, rel=0.02)
    assert result.sigma_resistance < 0.02 * truth.resistance
    assert result.voltage_error == pytest.approx(4.0, rel=0.02)
    curve = result.inverter_curve
    assert curve.current.shape == curve.voltage.shape == curve.sigma.shape
    true_drop = np.interp(curve.current, truth.inverter_current, truth.inverter_voltage)
    assert np.abs(curve.voltage - true_drop)[np.abs(curve.current) > 20].max() < 0.1
    assert (result.method, result.machine, result.pole_pairs, result.u_dc) == ("full", "ipm", 4, 400.0)
    assert result.speed_range == pytest.approx([500 * 4 * np.pi / 30] * 2, rel=1e-3)
    assert result.duration == pytest.approx(2.0)
    assert result.i_max == pytest.approx(300.0, rel=1e-6)
    assert {6, 12} <= {harmonic.order for harmonic in result.harmonics}
    assert result.metrics["nrmse_d"] < 2e-3
    assert 0.5 < result.metrics["coverage"] < 1
    assert any(message.kind == "advice" for message in result.statements)
    assert result.warnings == (*result.provenance.warnings, *result.drive.report.warnings)


def test_a_result_is_loaded_as_it_was_saved(result, saved, tmp_path):
    loaded = drive_id.load(saved)
    assert isinstance(loaded, drive_id.Identification)
    maps_agree(loaded, result, rel=0.0)
    for name in (
        "method", "machine", "resistance", "sigma_resistance", "voltage_error", "sigma_voltage_error", "i_max",
        "pole_pairs", "u_dc", "speed_range", "duration", "date", "warnings", "statements", "calibrations", "metrics",
    ):  # fmt: skip
        assert repr(getattr(loaded, name)) == repr(getattr(result, name)), name  # NaN is NaN
    for name in ("current", "voltage", "sigma"):
        np.testing.assert_array_equal(getattr(loaded.inverter_curve, name), getattr(result.inverter_curve, name))
    for one, other in zip(loaded.harmonics, result.harmonics, strict=True):
        assert one.order == other.order
        np.testing.assert_array_equal(one.psi_q_sin, other.psi_q_sin)
    i_d, i_q = np.linspace(-200, 200, 41)[:, None], np.linspace(-150, 250, 37)
    for one, other in zip(loaded.flux_map.psi_dq(i_d, i_q), result.flux_map.psi_dq(i_d, i_q), strict=True):
        np.testing.assert_array_equal(one, other)
    loaded.save(tmp_path / "again", draw=False)
    for name in ("identification.json", "flux_map.npz", "harmonics.npz"):
        assert (tmp_path / "again" / name).read_bytes() == (saved / name).read_bytes(), name


def test_what_is_no_result_folder_is_said(tmp_path, bag):
    for path in (tmp_path, bag, tmp_path / "none", str(tmp_path)):
        with pytest.raises(drive_id.DriveIdError, match="is not a result folder"):
            drive_id.load(path)
    with pytest.raises(drive_id.DriveIdError, match="None is not the path of a result folder"):
        drive_id.load(None)


def test_short_words_for_a_result(result, saved):
    assert repr(result).startswith("<Identification: ipm, method full, ")
    assert "\n" not in repr(result)
    assert "500 rpm" in repr(drive_id.load(saved))
    assert repr(result.flux_map).startswith("<FluxMap 65 x 65, i_d ")
    table = result._repr_html_()
    assert table.startswith("<table>")
    assert str(next(found for found in result.headline if found.name == "R")) in table
    hostile = replace(result, provenance=replace(result.provenance, machine="<script>"))
    assert "<script>" not in hostile._repr_html_()
    assert repr(drive_id.simulate("spm", 0.1)) == "<Samples: 1000 at 10 kHz, 0.1 s, with references, truth of spm>"


def test_a_result_can_be_pickled(result):
    assert pickle.loads(pickle.dumps(result)).flux_map.psi_dq(10, 20) == result.flux_map.psi_dq(10, 20)


# -- the flux map ----------------------------------------------------------------------------------------------------


def test_fluxes_at_grid_points_are_the_stored_ones(result):
    found = result.flux_map
    psi_d, psi_q = found.psi_dq(found.i_d[:, None], found.i_q)
    for psi, stored in ((psi_d, found.psi_d), (psi_q, found.psi_q)):
        np.testing.assert_allclose(psi[found.inside], stored[found.inside], rtol=1e-12, atol=1e-15)
        assert np.isnan(psi[~(found.inside | found.enclosed)]).all()
        assert np.isfinite(psi[found.enclosed]).all()
    for sigma, stored in zip(found.sigma(found.i_d[:, None], found.i_q), (found.sigma_d, found.sigma_q), strict=True):
        np.testing.assert_array_equal(sigma, stored)


def test_fluxes_between_grid_points_are_those_of_the_machine(result, simulation):
    rng = np.random.default_rng(0)
    i_dq = rng.uniform(-200, 200, (500, 2))
    psi = np.stack(result.flux_map.psi_dq(*i_dq.T), axis=-1)
    known = np.isfinite(psi).all(axis=1)
    assert known.mean() > 0.5
    assert max(nrmse(psi[known], simulation.machine.mean_flux(*i_dq[known].T))) < 2e-3


@pytest.mark.parametrize(
    ("shape_d", "shape_q", "shape"),
    [
        ((), (), ()),
        ((3,), (), (3,)),
        ((), (4,), (4,)),
        ((3, 1), (4,), (3, 4)),
        ((2, 3), (2, 3), (2, 3)),
        ((0,), (), (0,)),
    ],
)
def test_currents_broadcast(result, shape_d, shape_q, shape):
    i_d, i_q = np.full(shape_d, -40.0), np.full(shape_q, 30.0)
    for values in (*result.flux_map.psi_dq(i_d, i_q), *result.flux_map.sigma(i_d, i_q)):
        assert np.shape(values) == shape
    assert result.flux_map.inductances(i_d, i_q).shape == (*shape, 2, 2)


def test_numbers_and_lists_are_currents(result):
    psi_d, psi_q = result.flux_map.psi_dq(-40, 30)
    assert isinstance(psi_d, float)
    assert isinstance(psi_q, float)
    np.testing.assert_array_equal(result.flux_map.psi_dq([-40, -40], 30)[0], [psi_d, psi_d])


def test_inductances_are_the_slopes_of_the_fluxes(result):
    found, step = result.flux_map, 1e-3
    i_d, i_q = np.array([-60.0, -40.0, 13.0, 90.0]), np.array([80.0, -170.0, 7.0, 120.0])
    assert np.isfinite(found.psi_dq(i_d, i_q)).all()
    up, down = (found.psi_dq(i_d + sign * step, i_q) for sign in (1, -1))
    right, left = (found.psi_dq(i_d, i_q + sign * step) for sign in (1, -1))
    expected = np.array([[up[k] - down[k], right[k] - left[k]] for k in range(2)]) / (2 * step)
    np.testing.assert_allclose(found.inductances(i_d, i_q), np.moveaxis(expected, -1, 0), rtol=1e-6, atol=1e-11)


def test_outside_of_the_data_there_is_nan_or_an_error(result):
    found = result.flux_map
    for i_d, i_q in ((400.0, 0.0), (-299.0, 299.0), (np.nan, 0.0), (0.0, np.inf)):
        assert np.isnan(found.psi_dq(i_d, i_q)).all()
        assert np.isnan(found.sigma(i_d, i_q)).all()
        assert np.isnan(found.inductances(i_d, i_q)).all()
        for ask in (found.psi_dq, found.sigma, found.inductances):
            with pytest.raises(drive_id.DriveIdError, match="has no data at i_d = "):
                ask([10.0, i_d], [10.0, i_q], outside="raise")
    assert np.isfinite(found.psi_dq(10.0, 10.0, "raise")).all()
    with pytest.raises(drive_id.DriveIdError, match="outside is 'zero': it must be 'nan' or 'raise'"):
        found.psi_dq(0, 0, outside="zero")
    for i_d, i_q in (([1, 2], [1, 2, 3]), ("a", 1), (None, {})):
        with pytest.raises(drive_id.DriveIdError, match="are not real currents of shapes that broadcast"):
            found.psi_dq(i_d, i_q)


def test_a_current_is_inside_when_all_corners_of_its_cell_are():
    axis = np.arange(5.0)
    inside = np.ones((5, 5), np.bool_)
    inside[2, 2] = False
    plane = axis[:, None] + 10 * axis
    found = drive_id.FluxMap(axis, axis, plane, -plane, plane, np.where(inside, plane, np.nan), inside)
    grid = np.linspace(0, 4, 41)
    psi_d, psi_q = found.psi_dq(grid[:, None], grid)
    distance = np.maximum(np.abs(grid[:, None] - 2), np.abs(grid - 2))
    np.testing.assert_array_equal(np.isnan(psi_d), distance < 1 - 1e-12)
    known = ~np.isnan(psi_d)
    expected = grid[:, None] + 10 * grid
    np.testing.assert_allclose(psi_d[known], expected[known], atol=1e-12)
    np.testing.assert_allclose(psi_q[known], -expected[known], atol=1e-12)
    np.testing.assert_allclose(found.sigma(grid[:, None], grid)[0][known], expected[known], atol=1e-12)
    infinite = replace(found, sigma_d=np.full((5, 5), np.inf))
    assert infinite.sigma(0.5, 0.5)[0] == infinite.sigma(0.0, 0.0)[0] == np.inf


# -- simulations -----------------------------------------------------------------------------------------------------


def test_simulated_samples_carry_their_truth_and_are_scored():
    samples = drive_id.simulate(
        "spm", 1.0, speed=[800, -800], noise=1e-3, seed=2, inverter="tanh", trajectory=TRAJECTORY
    )
    assert (samples.truth.machine, samples.truth.details["inverter"]) == ("spm", "tanh")
    assert samples.speed.min() == pytest.approx(-800 * 3 * np.pi / 30)
    found = drive_id.fit(samples, method="joint")
    assert 0 < found.metrics["nrmse_q"] < 0.05
    blind = drive_id.fit(replace(samples, truth=None), method="joint")
    assert blind.resistance == found.resistance
    assert np.isnan(blind.metrics["nrmse_q"])
    assert (blind.pole_pairs, blind.u_dc) == (None, None)


def test_what_cannot_be_simulated_is_said(result):
    for arguments, said in (
        ({"machine": "apm"}, "There is no machine 'apm'"),
        ({"inverter": "ideal"}, "inverter is 'ideal'"),
        ({"machine": replace(result, provenance=replace(result.provenance, pole_pairs=None))}, "give pole_pairs"),
    ):
        with pytest.raises(drive_id.DriveIdError, match=said):
            drive_id.simulate(**arguments)


@pytest.mark.accuracy
def test_a_result_is_simulated_and_fitted_again(saved):
    """The machine of a result is the result: what is fitted on it agrees within 0.5 %."""
    loaded = drive_id.load(saved)
    machine = loaded.to_machine()
    assert min(-machine.i_d[0], machine.i_d[-1], -machine.i_q[0], machine.i_q[-1]) >= 1.25 * loaded.i_max
    assert (np.diff(machine.psi_d, axis=0) > 0).all()
    assert (np.diff(machine.psi_q, axis=1) > 0).all()
    samples = drive_id.simulate(saved, 2.0, noise=1e-3, seed=7, trajectory=TRAJECTORY)
    again = drive_id.fit(samples)
    grid = loaded.flux_map.grid()[loaded.flux_map.inside]
    grid = grid[np.hypot(*grid.T) <= loaded.i_max]
    assert max(nrmse(again.flux_map.continued(grid), loaded.flux_map.continued(grid))) < 5e-3
    assert max(again.provenance.nrmse) < 5e-3
    assert again.resistance == pytest.approx(loaded.resistance, rel=0.02)
    assert (again.pole_pairs, again.u_dc, again.i_max) == (4, 400.0, pytest.approx(300.0, rel=1e-3))


def test_a_map_is_continued_sanely_where_half_of_the_disc_has_no_data(result):
    """As a recording with i_d < 0 only leaves it."""
    found = result.flux_map
    half = replace(found, inside=found.inside & (found.i_d < 0)[:, None])
    machine = replace(result, drive=replace(result.drive, flux_map=half)).to_machine()
    assert (np.diff(machine.psi_d, axis=0) > 0).all()
    assert (np.diff(machine.psi_q, axis=1) > 0).all()
    start = int(np.searchsorted(machine.i_d, found.i_d[0])), int(np.searchsorted(machine.i_q, found.i_q[0]))
    same = machine.psi_d[start[0] : start[0] + 65, start[1] : start[1] + 65]
    np.testing.assert_array_equal(same[half.inside], found.psi_d[half.inside])
    jump = np.abs(np.diff(machine.psi_d, n=2, axis=0)).max() / np.abs(np.diff(machine.psi_d, axis=0)).max()
    assert jump < 0.5  # no kink
