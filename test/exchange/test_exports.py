"""Each format holds what its tool expects, where it expects it: compared at points without symmetry."""

from __future__ import annotations

import io
import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from exchange_machine import AT, I_MAX, PAIRS, RESISTANCE, flux, grids, result, torque
from scipy.interpolate import RegularGridInterpolator
from scipy.io import loadmat, netcdf_file
from steady_state import disc_points

from drive_id.core.maps.flux_map import HarmonicMap
from drive_id.errors import ConfigurationError, CoverageError, OutputError
from drive_id.exchange.exports.exporting import content_of, export_map
from drive_id.exchange.exports.formats import EXPORTS, ExportFormat, export_format
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.imports.importing import import_map
from drive_id.exchange.imports.source import Source

AXIS_D, AXIS_Q = np.arange(-17.5, 12.6, 2.5), np.arange(-15.0, 15.1, 1.5)  # 13 x 21
CHOICE = ExportOptions(AXIS_D, AXIS_Q)
SYMMETRIC = ExportOptions(np.arange(-15.0, 15.1, 2.5), AXIS_Q)
DRIVE = result()
N, M = 5, 17
"""Indices of i_d = -5 A and i_q = 10.5 A, where many comparisons are made."""
ZERO_D, ZERO_Q = 7, 10


def turning(amplitude=3e-3):
    """Return the drive with a 6th harmonic: psi_d + a i_q/18 cos, psi_q + a sin."""
    i_q = grids()[1]
    zero = np.zeros_like(i_q)
    harmonic = HarmonicMap(6, amplitude * i_q / 18, zero, zero, np.full_like(i_q, amplitude))
    return result(harmonics=(harmonic,))


def content(name, choice=CHOICE, drive=DRIVE, **options):
    return content_of(drive, name, replace(choice, **options))[0]


def mat(name, choice=CHOICE, drive=DRIVE, **options):
    return loadmat(io.BytesIO(content(name, choice, drive, **options)), squeeze_me=True, struct_as_record=False)


def npz(name, choice=CHOICE, drive=DRIVE):
    return np.load(io.BytesIO(content(name, choice, drive)), allow_pickle=False)


def truth(i_d=AXIS_D, i_q=AXIS_Q):
    return flux(*np.meshgrid(i_d, i_q, indexing="ij"))


def inductances(i_d, i_q):
    """Return L_dd, L_dq, L_qd, L_qq by differences of the exact fluxes."""
    h = 1e-4
    by_d = [(a - b) / (2 * h) for a, b in zip(flux(i_d + h, i_q), flux(i_d - h, i_q), strict=True)]
    by_q = [(a - b) / (2 * h) for a, b in zip(flux(i_d, i_q + h), flux(i_d, i_q - h), strict=True)]
    return by_d[0], by_q[0], by_d[1], by_q[1]


def test_csv():
    lines = content("csv").decode().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    assert "# pole_pairs: 3" in comments
    assert f"# resistance: {RESISTANCE}" in comments
    table = np.genfromtxt(lines[len(comments) :], delimiter=",", names=True)
    assert len(table) == len(AXIS_D) * len(AXIS_Q)
    for i_d, i_q in zip(*AT, strict=True):
        (row,) = table[(table["i_d"] == i_d) & (table["i_q"] == i_q)]
        np.testing.assert_allclose((row["psi_d"], row["psi_q"]), flux(i_d, i_q), atol=1e-9)
        assert row["torque"] == pytest.approx(torque(i_d, i_q))
        np.testing.assert_allclose(
            [row[f"L_{name}"] for name in ("dd", "dq", "qd", "qq")], inductances(i_d, i_q), rtol=0.02, atol=1e-5
        )
        assert (row["sigma_d"], row["inside"]) == (1e-4, 1)


def test_netcdf():
    drive = turning()
    with netcdf_file(io.BytesIO(content("netcdf", drive=drive)), mmap=False) as file:
        assert file.variables["psi_q"].dimensions == ("i_d", "i_q")
        np.testing.assert_array_equal(file.variables["i_d"][:], AXIS_D)
        np.testing.assert_allclose(file.variables["psi_d"][:], truth()[0], atol=1e-9)
        np.testing.assert_allclose(file.variables["psi_q"][:], truth()[1], atol=1e-9)
        np.testing.assert_allclose(file.variables["sigma_q"][:], 1e-4)
        np.testing.assert_allclose(file.variables["psi_d_cos"][0, N, M], 3e-3 * 10.5 / 18, atol=1e-9)
        assert file.variables["order"][:].tolist() == [6]
        assert (file.variables["torque"].units, file.pole_pairs) == (b"N m", PAIRS)


def test_netcdf_opens_in_xarray(tmp_path):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    (tmp_path / "map.nc").write_bytes(content("netcdf"))
    with xarray.open_dataset(tmp_path / "map.nc") as data:
        for i_d, i_q in zip(*AT, strict=True):
            point = data.sel(i_d=i_d, i_q=i_q)
            np.testing.assert_allclose((point.psi_d, point.psi_q), flux(i_d, i_q), atol=1e-9)
        assert data.psi_d.attrs["units"] == "Wb"


def test_motulator():
    file = npz("motulator")
    assert file["i_s_dq"].shape == (len(AXIS_D), len(AXIS_Q))
    assert file["i_s_dq"][N, M] == -5.0 + 10.5j
    psi_d, psi_q = truth()
    np.testing.assert_allclose(file["psi_s_dq"], psi_d + 1j * psi_q, atol=1e-9)
    np.testing.assert_allclose(file["tau_M"][N, M], torque(-5.0, 10.5))


def test_training_data_for_gradnets():
    flat = npz("gradnet-data")
    assert flat["i_s_dq"].ndim == 1
    assert "theta_m" not in flat
    file = npz("gradnet-data", drive=turning())
    theta, current, psi = file["theta_m"], file["i_s_dq"], file["psi_s_dq"]
    psi_d, psi_q = flux(current.real, current.imag)
    rippled = psi_d + 3e-3 * current.imag / 18 * np.cos(6 * theta) + 1j * (psi_q + 3e-3 * np.sin(6 * theta))
    np.testing.assert_allclose(psi, rippled, atol=1e-8)
    # the co-energy of the harmonic is a i_d i_q / 18 cos / 2 + a i_q sin along a straight line from zero
    i_d, i_q = current.real, current.imag
    slope = 6 * 3e-3 * (-(i_d * i_q / 36) * np.sin(6 * theta) + i_q * np.cos(6 * theta))
    per_pair = 1.5 * (psi.real * i_q - psi.imag * i_d + slope)
    np.testing.assert_allclose(file["tau_m"], per_pair, atol=1e-6)


def test_syre_flux_file():
    file = mat("syre", drive=turning())
    assert file["Id"].shape == (len(AXIS_Q), len(AXIS_D))  # [iq, id]
    assert (file["Id"][M, N], file["Iq"][M, N]) == (-5.0, 10.5)
    np.testing.assert_allclose((file["Fd"][M, N], file["Fq"][M, N]), flux(-5.0, 10.5), atol=1e-9)
    assert file["T"][M, N] == pytest.approx(torque(-5.0, 10.5))
    assert file["dTpp"][M, N] > 2 * file["dT"][M, N] > 0
    assert file["dataSet"].axisType == "PM"
    assert file["dataSet"].NumOfRotPosPP == 72


def test_syre_motor_model():
    model = mat("syre-model", drive=turning())["motorModel"]
    assert (model.data.Rs, model.data.p, model.data.axisType, model.data.Imax) == (RESISTANCE, PAIRS, "PM", I_MAX)
    np.testing.assert_allclose((model.FluxMap_dq.Fd[M, N], model.FluxMap_dq.Fq[M, N]), flux(-5.0, 10.5), atol=1e-9)
    L = model.IncInductanceMap_dq
    np.testing.assert_allclose((L.Ldd[M, N], L.Ldq[M, N], L.Lqd[M, N], L.Lqq[M, N]), inductances(-5, 10.5), rtol=0.01)
    over = model.FluxMap_dqt
    assert over.data.Fd.shape == (len(AXIS_D), len(AXIS_Q), len(over.th))  # [id, iq, theta]
    assert (over.th[0], over.th[-1]) == (0.0, pytest.approx(360.0))
    ripple = 3e-3 * 10.5 / 18 * np.cos(6 * np.radians(over.th))
    np.testing.assert_allclose(over.data.Fd[N, M], flux(-5.0, 10.5)[0] + ripple, atol=1e-8)
    inverse = model.FluxMapInv_dq
    known = (np.abs(inverse.Id + 2.5) < 17.5) & (np.abs(inverse.Iq) < 18.0)  # within the data
    assert known.mean() > 0.3
    back = flux(inverse.Id[known], inverse.Iq[known])
    np.testing.assert_allclose(back, (inverse.Fd[known], inverse.Fq[known]), atol=5e-4)  # a spline between grid points


def test_simscape_over_the_rotor_angle():
    file = mat("simscape", SYMMETRIC, turning())
    x = file["xVec2"]
    assert (x[0], x[-1]) == (0.0, pytest.approx(120 / PAIRS))  # mechanical degrees
    assert file["fluxD_dq0"].shape == (13, 21, len(x))
    np.testing.assert_allclose(file["fluxQ_dq0"][..., 0], file["fluxQ_dq0"][..., -1], atol=1e-12)
    assert (file["idVec2"][4], file["iqVec2"][M]) == (-5.0, 10.5)
    ripple = 3e-3 * np.sin(6 * np.radians(PAIRS * x))
    np.testing.assert_allclose(file["fluxQ_dq0"][4, M], flux(-5.0, 10.5)[1] + ripple, atol=1e-8)
    assert file["Torque_dq0"][4, M, :-1].mean() == pytest.approx(torque(-5.0, 10.5))
    assert (file["nPolePairs"], file["Rs"]) == (PAIRS, RESISTANCE)
    still = mat("simscape", SYMMETRIC)
    assert len(still["xVec2"]) >= 4
    with pytest.raises(ConfigurationError, match="wants it symmetric about 0"):
        content("simscape")


def test_simscape_refuses_harmonics_that_its_angle_cannot_hold():
    drive = turning(amplitude=0.02)
    flux_map = replace(drive.drive.flux_map, harmonics=(replace(drive.harmonics[0], order=2),))
    odd = replace(drive, drive=replace(drive.drive, flux_map=flux_map))
    with pytest.raises(ConfigurationError, match="order 2 does not repeat after 120 degrees"):
        content("simscape", SYMMETRIC, odd)


def test_simscape_with_inductances():
    """The fluxes that the block forms of its tables are those of the map, at zero current as well."""
    file = mat("simscape-2d")
    i_d, i_q = np.meshgrid(file["idVec"], file["iqVec"], indexing="ij")
    np.testing.assert_allclose(file["LdMatrix"] * i_d + file["pmFluxMatrix"], truth()[0], atol=1e-9)
    rest = flux(i_d, 0.0)[1]
    np.testing.assert_allclose(file["LqMatrix"] * i_q + rest, truth()[1], atol=1e-9)
    assert np.isfinite(file["LdMatrix"]).all()
    assert file["LdMatrix"][ZERO_D, ZERO_Q] == pytest.approx(inductances(0.0, 0.0)[0], rel=1e-2)


@pytest.mark.slow  # control tables over torque and speed
def test_motor_control():
    pmsm = mat("motor-control")["pmsm"]
    lut = pmsm.PMSMLUT
    assert lut.method == "FluxDQ"
    assert (lut.idVec[N], lut.iqVec[M]) == (-5.0, 10.5)
    np.testing.assert_allclose((lut.FluxDTable[N, M], lut.FluxQTable[N, M]), flux(-5.0, 10.5), atol=1e-9)
    assert lut.TorqueTable[N, M] == pytest.approx(torque(-5.0, 10.5))
    assert lut.idRefTable.shape == (len(lut.trefVec), len(lut.wrpmVec))  # [torque x speed]
    slow = torque(lut.idRefTable[:, 0], lut.iqRefTable[:, 0])
    np.testing.assert_allclose(slow, lut.trefVec, atol=0.01 * lut.trefVec[-1])
    raw = loadmat(io.BytesIO(content("motor-control")))["pmsm"]["PMSMLUT"][0, 0]
    assert (raw["idVec"][0, 0].shape, raw["iqVec"][0, 0].shape) == ((13, 1), (1, 21))


def test_powertrain():
    file = mat("powertrain")
    known = DRIVE.flux_map.inside.all() & (np.abs(file["id"] + 2.5) < 17.5) & (np.abs(file["iq"]) < 18.0)
    psi_d, psi_q = np.meshgrid(file["flux_d"], file["flux_q"], indexing="ij")
    assert np.isfinite(file["id"]).all()
    assert known.mean() > 0.3
    back = flux(file["id"][known], file["iq"][known])
    np.testing.assert_allclose(back, (psi_d[known], psi_q[known]), atol=5e-4)  # a spline between grid points
    assert (file["P"], file["Rs"]) == (PAIRS, RESISTANCE)
    control = mat("powertrain-controller")
    assert control["id_ref"].shape == (len(control["wbp"]), len(control["tbp"]))
    np.testing.assert_allclose(control["lambda_q"][N, M], flux(-5.0, 10.5)[1], atol=1e-9)
    np.testing.assert_allclose(torque(control["id_ref"][0], control["iq_ref"][0]), control["tbp"], atol=0.2)
    drive = result()
    without_voltage = replace(drive, provenance=replace(drive.provenance, u_dc=None))
    with pytest.raises(ConfigurationError, match="--u-dc"):
        content("powertrain-controller", drive=without_voltage)


def test_plecs():
    file = mat("plecs", leakage_inductance=1e-3)
    expected = np.array(flux(-5.0, 10.5)) - 1e-3 * np.array([-5.0, 10.5])
    np.testing.assert_allclose((file["psid"][N, M], file["psiq"][N, M]), expected, atol=1e-9)
    own = np.array(inductances(-5.0, 10.5)) - [1e-3, 0, 0, 1e-3]
    np.testing.assert_allclose([file[f"L{name}"][N, M] for name in ("dd", "dq", "qd", "qq")], own, rtol=0.01)
    assert (file["id"][N], file["iq"][M], file["Lsigma"]) == (-5.0, 10.5, 1e-3)


def test_plecs_refuses_a_leakage_above_the_inductances():
    with pytest.raises(ConfigurationError, match=r"--leakage is 1 H, but the least inductance is [\d.e-]+ H"):
        content("plecs", leakage_inductance=1.0)


def test_modelica():
    lines = content("modelica").decode().splitlines()
    assert lines[0] == "#1"
    start = lines.index("double psi_q(14,22)")
    table = np.array([[float(word) for word in line.split()] for line in lines[start + 1 : start + 15]])
    np.testing.assert_array_equal(table[1:, 0], AXIS_D)  # u1
    np.testing.assert_array_equal(table[0, 1:], AXIS_Q)  # u2
    np.testing.assert_allclose(table[1:, 1:], truth()[1], atol=1e-9)


def test_small_controllers():
    text = content("vesc", bandwidth=500.0 / (2 * np.pi))  # Hz
    assert b"Written by drive_id" in text
    assert b"smallest incremental inductance within i_max" in text
    vesc = {entry.tag: float(entry.text) for entry in ET.fromstring(text)}
    l_d, _, _, l_q = inductances(0.0, 0.0)
    assert vesc["foc_motor_l"] == pytest.approx((l_d + l_q) / 2, rel=1e-2)
    assert vesc["foc_motor_ld_lq_diff"] == pytest.approx(l_q - l_d, rel=1e-2)
    assert vesc["foc_motor_flux_linkage"] == pytest.approx(0.1)
    disc = disc_points(np.random.default_rng(3), I_MAX, 20_000)
    l_dd, l_dq, l_qd, l_qq = inductances(*disc.T)
    mean, half = (l_dd + l_qq) / 2, (l_dd - l_qq) / 2
    least = (mean - np.hypot(half, (l_dq + l_qd) / 2)).min()  # of all directions, at all currents
    assert vesc["foc_current_kp"] == pytest.approx(500 * least, rel=0.03)
    odrive = json.loads(content("odrive"))
    motor = {name.removeprefix("axis0.config.motor."): value for name, value in odrive.items()}
    bandwidth = motor["current_control_bandwidth"]
    assert bandwidth * motor["phase_inductance"] == pytest.approx(CHOICE.rate * least, rel=0.03)
    most = (mean + np.hypot(half, (l_dq + l_qd) / 2)).max()
    for kp, ki in (
        (vesc["foc_current_kp"], vesc["foc_current_ki"]),
        (bandwidth * motor["phase_inductance"], bandwidth * RESISTANCE),
    ):
        assert ki <= kp / least * RESISTANCE * 1.05
        for inductance in (least, most):  # damping of s^2 L + s (R + kp) + ki
            assert (RESISTANCE + kp) / (2 * np.sqrt(ki * inductance)) > 0.7
    assert odrive["axis0.config.motor.torque_constant"] == pytest.approx(1.5 * PAIRS * 0.1)
    assert odrive["axis0.config.motor.motor_model_l_q"] == pytest.approx(l_q, rel=1e-2)


@pytest.mark.cases
@pytest.mark.parametrize(
    ("name", "suffix", "axis"),
    [("csv", ".csv", None), ("machine", ".npz", None), ("motulator", ".npz", None), ("gradnet-data", ".npz", None),
     ("syre", ".mat", None), ("syre-model", ".mat", "pm")],
)  # fmt: skip
def test_round_trip(tmp_path, name, suffix, axis):
    drive = turning() if name in ("machine", "gradnet-data", "syre-model") else DRIVE
    file = tmp_path / f"map{suffix}"
    export_map(drive, name, file, CHOICE)
    found = import_map(Source(file, axis=axis, scalars={"pole_pairs": float(PAIRS)}))
    np.testing.assert_array_equal(found.flux_map.i_d, AXIS_D)
    np.testing.assert_array_equal(found.flux_map.i_q, AXIS_Q)
    np.testing.assert_allclose((found.flux_map.psi_d, found.flux_map.psi_q), truth(), atol=1e-9)
    assert found.flux_map.inside.all()
    if drive.harmonics:
        (harmonic,) = found.harmonics
        assert harmonic.order == 6
        np.testing.assert_allclose(harmonic.psi_d_cos[N, M], 3e-3 * 10.5 / 18, atol=1e-8)
        np.testing.assert_allclose(harmonic.psi_q_sin, 3e-3, atol=1e-8)
    if name == "csv":
        np.testing.assert_allclose(found.flux_map.sigma_d, 1e-4)


def on_disc():
    """Return the drive with data on a disc of 16 A only."""
    inside = np.hypot(*grids()) <= 16.0
    drive = result()
    m = drive.flux_map
    sigma = np.where(inside, 1e-4, np.nan)
    disc = replace(m, inside=inside, sigma_d=sigma, sigma_q=sigma)
    known = replace(drive.provenance, u_dc=None)  # without tables over speed, whose search takes time
    return replace(drive, drive=replace(drive.drive, flux_map=disc), provenance=known)


MARKED = {  # where each format of tables keeps psi_d
    "csv": lambda: import_rows()["psi_d"],
    "motulator": lambda: npz("motulator", drive=on_disc())["psi_s_dq"].real,
}
FILLED = {  # the same for tools that refuse NaN
    "syre": lambda: mat("syre", drive=on_disc())["Fd"].T,
    "simscape": lambda: mat("simscape", SYMMETRIC, on_disc())["fluxD_dq0"][..., 0],
    "motor-control": lambda: mat("motor-control", drive=on_disc())["pmsm"].PMSMLUT.FluxDTable,
    "plecs": lambda: mat("plecs", drive=on_disc())["psid"],
    "powertrain": lambda: mat("powertrain", drive=on_disc())["id"],
}


def import_rows():
    lines = [line for line in content("csv", drive=on_disc()).decode().splitlines() if not line.startswith("#")]
    return np.genfromtxt(lines, delimiter=",", names=True)


@pytest.mark.parametrize("name", MARKED)
def test_points_without_data_are_marked(name):
    psi_d = MARKED[name]()
    corner, inner = (psi_d.reshape(len(AXIS_D), len(AXIS_Q))[place] for place in ((0, 0), (N, M - 3)))
    assert np.isnan(corner)
    assert np.isfinite(inner)


@pytest.mark.parametrize("name", FILLED)
def test_tools_that_refuse_nan_get_none(name):
    assert np.isfinite(FILLED[name]()).all()


@pytest.mark.slow  # every format
def test_every_format_marks_or_refuses_gaps_and_fills_them_on_demand():
    drive = on_disc()
    for name, entry in EXPORTS.items():
        if name == "powertrain-controller" or not entry.grid:
            continue  # it holds the tables of motor-control
        choice = SYMMETRIC if name == "simscape" else CHOICE
        if name == "machine":
            with pytest.raises(ConfigurationError, match="points have no data, which a machine file cannot hold"):
                content_of(drive, name, choice)
        else:
            _, exported = content_of(drive, name, choice)
            assert exported.missing > 0
            told = {"gradnet-data": "left out"} | dict.fromkeys(("csv", "netcdf", "motulator"), "marked as NaN")
            assert told.get(name, "a continuation") in exported.warnings[0]
        _, exported = content_of(drive, name, replace(choice, filled=True))
        assert "continuation" in exported.warnings[0]


def test_a_filled_table_is_continued_smoothly():
    filled = npz("motulator", replace(CHOICE, filled=True), on_disc())
    known = filled["inside"]
    assert not known.all()
    psi_d, psi_q = truth()
    np.testing.assert_allclose(filled["psi_s_dq"], psi_d + 1j * psi_q, atol=0.06)
    np.testing.assert_allclose(filled["psi_s_dq"][known], (psi_d + 1j * psi_q)[known], atol=1e-4)


def test_errors(tmp_path):
    with pytest.raises(
        ConfigurationError,
        match=r"no export format 'matlab': files of this kind can be syre, syre-model, .*; choose one",
    ):
        content_of(DRIVE, "matlab")
    far = ExportOptions(np.array([-400.0, -300.0, -200.0, 0.0]) - 100, np.array([-400.0, -300.0, -200.0, 400.0]))
    with pytest.raises(CoverageError, match="No point of the table has data"):
        content_of(DRIVE, "csv", far)
    (tmp_path / "map.csv").write_text("mine")
    with pytest.raises(OutputError, match="exists already"):
        export_map(DRIVE, "csv", tmp_path / "map.csv")
    assert (tmp_path / "map.csv").read_text() == "mine"
    export_map(DRIVE, "csv", tmp_path / "map.csv", CHOICE, force=True)
    assert (tmp_path / "map.csv").read_text().startswith("# machine: lopsided")
    unknown = replace(DRIVE, drive=replace(DRIVE.drive, resistance=np.nan))
    with pytest.raises(ConfigurationError, match="--resistance"):
        content("plecs", drive=unknown)
    nameless = replace(DRIVE, provenance=replace(DRIVE.provenance, pole_pairs=None))
    with pytest.raises(ConfigurationError, match="--pole-pairs"):
        content("motor-control", drive=nameless)
    (heading,) = [line for line in content("csv", drive=nameless).decode().splitlines() if line.startswith("i_d")]
    assert "torque" not in heading
    with pytest.raises(ConfigurationError, match="bandwidth is"):
        ExportOptions(bandwidth=0.0)


@pytest.mark.parametrize(("name", "known"), [("SyRe", "syre"), ("C_Header", "c-header")])
def test_names_of_formats_may_be_spelled_otherwise(name, known):
    assert export_format(name) is EXPORTS[known]


OF_A_LAB = ExportFormat("table of a lab", ".lab", lambda table, _options: f"{table.psi[0].size} points".encode())


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """An installed package that adds a format, and an entry that is none."""
    (tmp_path / "a_lab.py").write_text(f"from {__name__} import OF_A_LAB\nNO_FORMAT = 3\n")
    told = tmp_path / "a_lab-1.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: a-lab\nVersion: 1\n")
    (told / "entry_points.txt").write_text("[drive_id.exporters]\nlab = a_lab:OF_A_LAB\nnone = a_lab:NO_FORMAT\n")
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("lab")
def test_another_package_adds_a_format():
    assert content("lab") == f"{len(AXIS_D) * len(AXIS_Q)} points".encode()
    with pytest.raises(ConfigurationError, match=r"'none' \(a_lab:NO_FORMAT\) is no ExportFormat"):
        export_format("none")
    with pytest.raises(ConfigurationError, match=r"There is no export format 'labs': did you mean lab\."):
        export_format("labs")


@pytest.mark.parametrize("name", ["csv", "netcdf", "c-header", "vesc"])
def test_files_name_source_date_units_and_error(name):
    dated = replace(DRIVE, provenance=replace(DRIVE.provenance, date="2026-03-04T05:06:07+00:00"))
    text = content(name, drive=dated).decode(errors="replace")
    for part in (
        "Written by drive_id ",
        "2026-03-04T05:06:07",
        "method full",
        "Wb",
        "bilinear interpolation is off by",
    ):
        assert part in text, part


def test_the_error_of_a_table_is_the_largest_between_its_points():
    coarse = ExportOptions(np.arange(-16.0, 12.1, 4.0), np.arange(-16.0, 16.1, 8.0))
    _, exported = content_of(DRIVE, "csv", coarse)
    (said,) = exported.warnings
    off = float(re.search(r"off by at most (\S+) Wb", said).group(1))
    d, q = (axis[:-1] + np.diff(axis) / 2 for axis in (coarse.i_d, coarse.i_q))
    middle = np.stack(np.meshgrid(d, q, indexing="ij"), axis=-1)
    nodes = truth(coarse.i_d, coarse.i_q)
    linear = [RegularGridInterpolator((coarse.i_d, coarse.i_q), psi)(middle) for psi in nodes]
    worst = np.hypot(*(a - b for a, b in zip(linear, flux(middle[..., 0], middle[..., 1]), strict=True))).max()
    assert off == pytest.approx(worst, rel=0.05)
    assert worst > 0.01 * np.hypot(*nodes).max()


def test_names_of_machines_are_text_and_nothing_else():
    named = replace(DRIVE, provenance=replace(DRIVE.provenance, machine="m\u00f8tor\n1,2,=cmd()\x1b[2J"))
    lines = content("csv", drive=named).decode().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    assert lines[: len(comments)] == comments
    assert "# machine: m\u00f8tor 1;2;=cmd() [2J" in comments
    with netcdf_file(io.BytesIO(content("netcdf", drive=named)), mmap=False) as file:
        assert file.machine.decode() == "m\u00f8tor 1;2;=cmd() [2J"


def notched(depth=0.03):
    """Return the drive with a notch of psi_d at zero current, in which L_dd is negative."""
    i_d, i_q = grids()
    psi_d, _ = flux(i_d, i_q)
    notch = depth * np.where((i_q == 0) & (np.abs(i_d) == 2.5), -np.sign(i_d), 0.0)
    found = replace(DRIVE.flux_map, psi_d=psi_d + notch)
    return replace(DRIVE, drive=replace(DRIVE.drive, flux_map=found))


@pytest.mark.slow  # controllers of several machines
def test_no_gain_is_negative():
    drive = notched()
    assert drive.flux_map.inductances(0.0, 0.0)[0, 0] < 0
    vesc, exported = content_of(drive, "vesc", replace(CHOICE, bandwidth=500.0))
    numbers = {entry.tag: float(entry.text) for entry in ET.fromstring(vesc)}
    assert numbers["foc_current_kp"] > 0
    assert numbers["foc_motor_l"] - numbers["foc_motor_ld_lq_diff"] / 2 > 0
    assert "of the nearest monotone map (the map itself is not monotone)" in exported.warnings[0]
    odrive = json.loads(content("odrive", drive=drive))
    assert min(odrive[f"axis0.config.motor.{name}"] for name in ("phase_inductance", "motor_model_l_d")) > 0
    assert mat("motor-control", drive=drive)["pmsm"].Ld > 0
    data, exported = content_of(drive, "plecs", CHOICE)
    assert any("not monotone everywhere" in said for said in exported.warnings)
    assert loadmat(io.BytesIO(data))["Ldd"].min() > 0


@pytest.mark.parametrize(
    ("name", "suffix"), [("csv", ".csv"), ("machine", ".npz"), ("motulator", ".npz"), ("syre-model", ".mat")]
)
def test_numbers_of_the_machine_survive_a_round_trip(tmp_path, name, suffix):
    narrow = ExportOptions(np.arange(-10.0, 10.1, 1.0), np.arange(-10.0, 10.1, 1.0))  # i_max is more than the axes
    export_map(DRIVE, name, tmp_path / f"m{suffix}", narrow)
    found = import_map(Source(tmp_path / f"m{suffix}"))
    assert (found.resistance, found.pole_pairs, found.u_dc, found.i_max) == (RESISTANCE, PAIRS, 320.0, I_MAX)
