"""The analysis as its user meets it: the object, the files, the command, and bad input."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from exact_results import exact_result
from machine_kinds import co_energy, mean_torque

import drive_id
from drive_id.analysis.field_weakening import DriveLimits
from drive_id.analysis.maps import CurrentMaps
from drive_id.analysis.ripple import TorqueRipple
from drive_id.bench.machines import MACHINES, machine_map
from drive_id.core.maps.flux_map import HarmonicMap
from drive_id.errors import ConfigurationError, DataError, OutputError, ResultError

SMALL = drive_id.AnalysisSettings(current_points=5, torque_points=2, speed_points=4)
MACHINE = MACHINES["pmsyrm"]


def harmonics_of(machine, i_d, i_q):
    """Return the harmonics of the analytic machine by Fourier's integrals over the rotor position."""
    theta = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    d, q = np.meshgrid(i_d, i_q, indexing="ij")
    fluxes = machine.flux(d[..., None], q[..., None], theta)
    out = []
    for order, _, _ in machine.harmonics:
        parts = [2 * np.mean(psi * wave(order * theta), axis=-1) for psi in fluxes for wave in (np.cos, np.sin)]
        out.append(HarmonicMap(order, *parts))
    return tuple(out)


@pytest.fixture(scope="module")
def result():
    known = machine_map("pmsyrm")
    harmonics = harmonics_of(MACHINE, known.i_d, known.i_q)
    return exact_result(known, sigma=1e-4, drop=lambda i: 2 * np.tanh(i), harmonics=harmonics, sigma_resistance=0.002)


@pytest.fixture(scope="module")
def analysis(result):
    return drive_id.analyze(result, SMALL)


@pytest.fixture(scope="module")
def folder(analysis, tmp_path_factory):
    path = tmp_path_factory.mktemp("analysis") / "out"
    analysis.save(path)
    return path


def table(path):
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    return {name: np.array(values) if name == "limit" else np.array(values, float) for name, values in columns.items()}


def test_the_files_are_as_agreed(folder):
    starts = {
        "mtpa.csv": ["current", "i_d", "i_q", "psi_d", "psi_q", "torque", "sigma_torque"],
        "mtpv.csv": ["current", "i_d", "i_q", "psi_d", "psi_q", "torque", "sigma_torque"],
        "field_weakening.csv": ["torque", "speed", "i_d", "i_q", "voltage", "limit"],
        "torque_speed.csv": ["speed", "torque", "power"],
        "compensation.csv": ["current", "voltage", "sigma_voltage"],
    }
    assert {path.name for path in folder.iterdir()} == {*starts, "analysis.json", "csv-metadata.json", "maps.npz"}
    for name, columns in starts.items():
        with (folder / name).open() as file:
            assert file.readline().strip().split(",")[: len(columns)] == columns
    with np.load(folder / "maps.npz", allow_pickle=False) as file:
        names = ["i_d", "i_q", "torque", "sigma_torque", "L_dd", "L_dq", "L_qd", "L_qq", "inside"]
        assert list(file)[: len(names)] == names
        arrays = dict(file)
    shape = (len(arrays["i_d"]), len(arrays["i_q"]))
    assert all(arrays[name].shape == shape for name in names[2:])
    assert arrays["inside"].dtype == np.bool_
    d, q = 60, 17  # the first index is i_d
    at = arrays["i_d"][d], arrays["i_q"][q]
    assert arrays["torque"][d, q] == pytest.approx(mean_torque(MACHINE, *at)[0], rel=1e-3)
    step = 1e-3
    for axis, name in ((0, "L_dq"), (1, "L_qq")):
        up, down = (
            replace(MACHINE, harmonics=()).flux(np.array(at[0]), np.array(at[1] + side * step), np.zeros(1))[axis][0]
            for side in (1, -1)
        )
        assert arrays[name][d, q] == pytest.approx((up - down) / (2 * step), rel=5e-3)


def test_the_tables_name_their_units(folder):
    """As the W3C's CSV on the Web has it: each column of each table, in its order, with its unit."""
    found = json.loads((folder / "csv-metadata.json").read_text())
    assert found["@context"] == "http://www.w3.org/ns/csvw"
    assert {entry["url"] for entry in found["tables"]} == {path.name for path in folder.glob("*.csv")}
    units = {}
    for entry in found["tables"]:
        columns = entry["tableSchema"]["columns"]
        assert [column["name"] for column in columns] == list(table(folder / entry["url"]))
        units |= {column["name"]: column.get("schema:unitText") for column in columns}
    wanted = {"i_d": "A", "psi_q": "Wb", "torque": "Nm", "sigma_torque": "Nm", "speed": "rad/s, mechanical"}
    wanted |= {"voltage": "V", "sigma_voltage": "V", "power": "W", "sigma_angle": "rad", "efficiency": "1"}
    assert {name: units[name] for name in wanted} == wanted
    assert [name for name, unit in units.items() if unit is None] == ["limit"]  # which is a word


def test_the_numbers_are_as_agreed(folder, analysis, result):
    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    tree = json.loads((folder / "analysis.json").read_text(), parse_constant=refuse)
    assert (tree["format"], tree["pole_pairs"], tree["i_max"], tree["u_dc"]) == ("drive_id/analysis", 2, 40.0, [540.0])
    assert tree["u_max"] == [pytest.approx(540 / np.sqrt(3))]
    figures = tree["figures"]
    assert figures["resistance"] == {"value": 0.3, "sigma": 0.002, "unit": "ohm", "inside": True}
    assert figures["ki"]["value"] == pytest.approx(2 * np.pi * 500 * 0.3)
    assert figures["kp_q"]["value"] == pytest.approx(2 * np.pi * 500 * figures["L_qq"]["value"])
    assert figures["saliency"]["value"] == pytest.approx(figures["L_qq"]["value"] / figures["L_dd"]["value"])
    assert figures["L_qq"]["sigma"] is None  # correlations are not known
    assert figures["max_torque"]["value"] == pytest.approx(analysis.mtpa.torque[-1], rel=1e-6)
    assert set(tree["files"]) == {path.name for path in folder.iterdir()} - {"analysis.json"}
    assert any("correlated" in sentence for sentence in tree["statements"])
    speeds = table(folder / "torque_speed.csv")
    np.testing.assert_allclose(speeds["power"], speeds["torque"] * speeds["speed"], rtol=1e-9)
    assert np.abs(speeds["speed"] / figures["corner_speed"]["value"] - 1).min() < 1e-6
    curve = table(folder / "compensation.csv")
    np.testing.assert_allclose(curve["voltage"], result.inverter_curve.voltage)


def test_the_tables_keep_the_limits_and_give_their_torque(folder):
    found = table(folder / "field_weakening.csv")
    assert len(found["torque"]) == 4 * 5
    np.testing.assert_allclose(
        found["torque"], mean_torque(MACHINE, found["i_d"], found["i_q"]), atol=2e-3 * found["torque"].max()
    )
    assert (np.hypot(found["i_d"], found["i_q"]) <= 40.0 * (1 + 1e-6)).all()
    assert (found["voltage"] <= 540 / np.sqrt(3) * (1 + 1e-6)).all()
    assert set(found["limit"]) <= {"none", "current", "voltage", "both"}
    assert {"none", "both"} <= set(found["limit"])
    assert (found["torque"] < -1).any()
    lost = found["copper_loss"] + found["iron_loss"] + found["inverter_loss"]
    np.testing.assert_allclose(found["power"], found["torque"] * found["speed"] + lost, rtol=1e-6, atol=1e-6)
    assert (found["inside"] == 1).all()


def test_the_ripple_is_that_of_the_co_energy(analysis):
    theta = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    ripple = TorqueRipple.of(analysis.model)
    for i_d, i_q in ((-12.0, 25.0), (9.0, -17.0), (-30.0, -5.0)):
        step = 1e-5
        change = [
            co_energy(MACHINE, i_d, i_q, theta + side * step) - co_energy(MACHINE, 0.0, 0.0, theta + side * step)
            for side in (1, -1)
        ]
        psi_d, psi_q = MACHINE.flux(np.array(i_d), np.array(i_q), theta)
        torque = 1.5 * 2 * (psi_d * i_q - psi_q * i_d + (change[0] - change[1]) / (2 * step))
        varying = torque - torque.mean()
        found = ripple.over_angle(np.array(i_d), np.array(i_q), theta)
        np.testing.assert_allclose(found, varying, atol=0.01 * np.abs(varying).max())
        assert ripple.peak_to_peak(np.array(i_d), np.array(i_q)) == pytest.approx(np.ptp(varying), rel=0.02)
    maps = CurrentMaps.of(analysis.model, np.array([-12.0, 3.0]), np.array([25.0, 1.0, 2.0]), 500.0)
    assert maps.ripple[0, 0] == pytest.approx(ripple.peak_to_peak(np.array(-12.0), np.array(25.0)))


@pytest.mark.slow  # a whole analysis
def test_settings_reach_the_tables(result):
    chosen = replace(SMALL, u_dc=(300.0, 540.0), i_max=20.0, speed=1500.0, temperature=100.0, modulation=0.9)
    found = drive_id.analyze(result, chosen)
    assert [entry.u_dc for entry in found.speed_ranges] == [300.0, 540.0]
    assert [entry.limits for entry in found.speed_ranges] == [
        DriveLimits(20.0, 0.9 * 300 / np.sqrt(3)), DriveLimits(20.0, 0.9 * 540 / np.sqrt(3))
    ]  # fmt: skip
    assert found.speed_ranges[0].motoring.speed[-1] == pytest.approx(1500 * np.pi / 30)
    assert found.figures["resistance"].value == pytest.approx(0.3 * (1 + 3.93e-3 * 80))
    assert found.mtpa.current[-1] == 20.0
    text = " ".join(found.statements)
    assert "was assumed, because no temperatures are known" in text
    assert "magnet was not identified" in text


@pytest.mark.slow  # a whole analysis
def test_points_beyond_the_data_are_marked_and_told(result):
    grid = result.flux_map.grid()
    known = replace(result.flux_map, inside=np.hypot(grid[..., 0], grid[..., 1]) <= 25.0)
    found = drive_id.analyze(replace(result, drive=replace(result.drive, flux_map=known)), SMALL)
    assert not found.mtpa.inside[-1]
    assert not found.figures["max_torque"].inside
    assert np.isnan(found.figures["max_torque"].sigma)
    assert any("of MTPA lie outside the data" in sentence for sentence in found.statements)
    assert any("of field weakening at 540 V lie outside" in sentence for sentence in found.statements)


def test_currents_far_beyond_the_map_are_refused(result):
    with pytest.raises(ConfigurationError, match=r"i_max is 1e\+09 A, but the map reaches .* A"):
        drive_id.analyze(result, replace(SMALL, i_max=1e9))


@pytest.mark.slow  # a whole analysis
def test_without_a_dc_link_all_that_needs_none_is_there(result, analysis, tmp_path):
    found = drive_id.analyze(replace(result, provenance=replace(result.provenance, u_dc=None)), SMALL)
    assert {"L_dd", "max_torque", "kp_q", "saliency"} < set(found.figures) < set(analysis.figures)
    assert found.figures["max_torque"].value == pytest.approx(analysis.figures["max_torque"].value, rel=1e-3)
    assert any("DC-link voltage is unknown" in sentence and "--u-dc" in sentence for sentence in found.statements)
    found.save(tmp_path / "analysis")
    assert not (tmp_path / "analysis" / "torque_speed.csv").exists()
    assert (tmp_path / "analysis" / "mtpa.csv").read_bytes() != b""
    assert "rpm" not in found.summary.rpartition(",")[2]
    (corner,) = (row for row in analysis.rows() if row[0] == "corner speed")
    assert corner[1].endswith(" rpm")  # as on the command line
    assert " ".join(corner) in " ".join(repr(analysis).split())


@pytest.mark.slow  # several analyses
def test_what_is_missing_is_named_in_one_sentence(result, tmp_path):
    unknown = replace(result, provenance=replace(result.provenance, pole_pairs=None))
    with pytest.raises(ConfigurationError, match="--pole-pairs"):
        drive_id.analyze(unknown, SMALL)
    assert drive_id.analyze(unknown, replace(SMALL, pole_pairs=3)).model.pole_pairs == 3
    for wrong in ({"u_dc": (0.0,)}, {"i_max": -1.0}, {"speed": np.nan}, {"bandwidth": 0.0}, {"modulation": 1.104}):
        with pytest.raises(ConfigurationError, match=next(iter(wrong))):
            drive_id.AnalysisSettings(**wrong)
    six_step = (2 / np.pi) / (1 / np.sqrt(3))
    assert drive_id.AnalysisSettings(modulation=six_step).modulation == six_step
    with pytest.raises(ResultError, match="is not a result folder"):
        drive_id.analyze(tmp_path, SMALL)


@pytest.mark.slow  # a whole analysis
def test_without_a_resistance_voltages_are_limited_all_the_same_and_losses_unknown(result, tmp_path):
    """An imported map may have none; no limit of the voltage was kept then."""
    unknown = replace(result, drive=replace(result.drive, resistance=np.nan))
    without = replace(result, drive=replace(result.drive, resistance=1e-9))
    found, expected = drive_id.analyze(unknown, SMALL), drive_id.analyze(without, SMALL)
    for name in ("max_torque", "corner_speed", "table_end_speed", "max_power"):
        assert found.figures[name].value == pytest.approx(expected.figures[name].value, rel=1e-4)
    assert found.figures["corner_speed"].value > 0
    assert np.isnan([found.figures[name].value for name in ("resistance", "ki", "max_efficiency")]).all()
    table = found.speed_ranges[0].references
    assert np.isnan(table.copper).all()
    assert np.isnan(table.power).all()
    assert np.nanmax(table.voltage) <= found.speed_ranges[0].limits.u_max * (1 + 1e-6)
    assert any("The resistance is unknown: voltages neglect it" in sentence for sentence in found.statements)
    found.save(tmp_path / "out")


@pytest.mark.slow  # two analyses
def test_the_largest_power_does_not_depend_on_the_speeds_of_the_tables(result):
    """It was the largest at these speeds, which move with the corner speed: its error was not the stated one."""
    rough, fine = (drive_id.analyze(result, replace(SMALL, speed_points=n)).figures["max_power"] for n in (7, 23))
    assert rough.value == pytest.approx(fine.value, rel=1e-5)
    assert rough.sigma == pytest.approx(fine.sigma, rel=0.1)
    assert rough.inside == fine.inside


def test_a_foreign_folder_is_left_alone_and_an_own_one_replaced(analysis, folder, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="not results of drive_id"):
        analysis.save(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    analysis.save(tmp_path, force=True)
    assert (tmp_path / "notes.txt").exists()
    analysis.save(folder)


def test_maps_that_cannot_be_meant_are_refused(result):
    found, grid = result.flux_map, result.flux_map.grid()
    for changed, words in (
        ({"psi_d": -found.psi_d, "psi_q": -found.psi_q}, "falls with its own current at 100 % of the points"),
        ({"psi_d": found.psi_q, "psi_q": found.psi_d}, "falls with its own current at"),
        ({"psi_d": 1e-3 * grid[..., 0], "psi_q": 1e-3 * grid[..., 1]}, "No current up to 40 A gives a torque"),
        ({"inside": np.zeros_like(found.inside)}, "has only 0 points with data"),
    ):
        wrong = replace(result, drive=replace(result.drive, flux_map=replace(found, **changed)))
        with pytest.raises(DataError, match=words):
            drive_id.analyze(wrong, SMALL)


@pytest.mark.slow  # a whole analysis
def test_the_command_writes_what_the_object_does(result, folder, run, tmp_path):
    result.save(tmp_path / "result", draw=False)
    small = ("--set=current_points=5", "--set=torque_points=2", "--set=speed_points=4")
    command = ("analyze", tmp_path / "result", "--output", tmp_path / "out", *small)
    code, out, err = run(*command, "--u-dc", "540", "--json")
    assert (code, err) == (0, "")
    assert json.loads(out) == json.loads((tmp_path / "out" / "analysis.json").read_text())
    for name in ("mtpa.csv", "torque_speed.csv", "compensation.csv"):
        mine, own = table(tmp_path / "out" / name), table(folder / name)
        for column in own.keys() - {"limit"}:
            assert mine[column] == pytest.approx(own[column], rel=1e-6, abs=1e-9, nan_ok=True), (name, column)
    code, out, _ = run(*command)
    assert code == 0
    for word in ("corner speed", "rpm", "max torque", "Written to"):
        assert word in out
