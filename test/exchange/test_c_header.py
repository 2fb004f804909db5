"""The C header compiles without a warning, and interpolates as scipy and as a formula of its own do."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from compiled_header import compiled, header_margins, open_loop_margin, over_the_disc, read
from exchange_machine import result
from flashed_machines import bridged, drive
from scipy.interpolate import CubicHermiteSpline, RegularGridInterpolator

from drive_id.analysis.machine import MachineModel
from drive_id.exchange.exports.exporting import content_of
from drive_id.exchange.exports.options import ExportOptions

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler 'cc'")
AXIS_D, AXIS_Q = np.array([-17.5, -14.0, -9.0, -5.5, -2.0, 0.0, 3.0, 8.0, 12.5]), np.arange(-15.0, 15.1, 1.5)
MAIN = r"""
#include "map.h"
#include <stdio.h>
int main(void)
{
    double d, q;
    while (scanf("%lf %lf", &d, &q) == 2) {
        const drive_id_real x = (drive_id_real)d, y = (drive_id_real)q;
        printf("%.17g %.17g %.17g %.17g %d\n", (double)drive_id_psi_d(x, y), (double)drive_id_psi_q(x, y),
               (double)drive_id_psi_d_bicubic(x, y), (double)drive_id_psi_q_bicubic(x, y), drive_id_inside(x, y));
    }
    return 0;
}
"""
CONTROL = r"""
#include "map.h"
#include <stdio.h>
int main(void)
{
    double u_dq[2], d, q;
    while (scanf("%lf %lf", &d, &q) == 2) {
        drive_id_feedforward(d, q, 200.0, drive_id_resistance(120.0), u_dq);
        printf("%.17g %.17g %.17g %.17g %.17g %.17g %.17g\n", drive_id_kp_d(d, q), drive_id_kp_q(d, q), u_dq[0],
               u_dq[1], drive_id_drop(d), drive_id_active_flux(d, q), drive_id_magnet(120.0));
    }
    return 0;
}
"""


def table(drive):
    choice = ExportOptions(AXIS_D, AXIS_Q)
    header, _ = content_of(drive, "c-header", choice)
    grid = np.meshgrid(AXIS_D, AXIS_Q, indexing="ij")
    return header, np.stack(drive.flux_map.psi_dq(*grid))


def within_14_amperes(drive):
    """Return a result with data within this disc only."""
    flux_map = drive.flux_map
    inside = np.hypot(flux_map.i_d[:, None], flux_map.i_q) <= 14.0
    return replace(drive, drive=replace(drive.drive, flux_map=replace(flux_map, inside=inside)))


def hermite(axis, values, x):
    """Interpolate along the first axis with the slopes of parabolas: numpy's second-order differences."""
    return CubicHermiteSpline(axis, values, np.gradient(values, axis, axis=0, edge_order=2))(x)


@pytest.mark.parametrize(("options", "accuracy"), [((), 2e-6), (("-DDRIVE_ID_DOUBLE",), 5e-9)], ids=["float", "double"])
def test_ten_thousand_points(tmp_path, options, accuracy):
    header, psi = table(result())
    rng = np.random.default_rng(7)
    points = rng.uniform([-17.5, -15.0], [12.5, 15.0], (10_000, 2))
    points[:4] = [[-9.0, 6.0], [12.5, -15.0], [-17.5, 15.0], [0.0, 0.0]]
    found = read(compiled(tmp_path, header, *options, main=MAIN), points)
    largest = np.abs(psi).max()
    for k in range(2):
        linear = RegularGridInterpolator((AXIS_D, AXIS_Q), psi[k])(points)
        np.testing.assert_allclose(found[:, k], linear, rtol=0, atol=accuracy * largest)
        rows = hermite(AXIS_Q, psi[k].T, points[:, 1])  # (N, D)
        cubic = np.array([hermite(AXIS_D, row, x) for row, x in zip(rows[:500], points[:500, 0], strict=True)])
        np.testing.assert_allclose(found[:500, 2 + k], cubic, rtol=0, atol=accuracy * largest)
    assert (found[:, 4] == 1).all()


def test_beyond_the_axes_and_without_data(tmp_path):
    header, psi = table(within_14_amperes(result()))
    points = [(40.0, 0.0), (-17.0, -14.5), (float("nan"), 0.0), (-2.0, 1.0), (-5.5, 3.0)]
    found = read(compiled(tmp_path, header, main=MAIN), points)
    assert found[:, 4].tolist() == [0, 0, 0, 1, 1]
    assert np.isfinite(found[[0, 1, 3, 4], :4]).all()  # a controller never reads NaN
    assert np.isnan(found[2, :4]).all()
    np.testing.assert_allclose(found[4, :4], [*psi[:, 3, 12]] * 2, atol=1e-6)


def test_inside_there_is_a_number(tmp_path):
    """The bicubic functions take neighbours that may have no data."""
    header, _ = table(within_14_amperes(result()))
    points = np.random.default_rng(4).uniform(-15, 15, (20_000, 2))
    found = read(compiled(tmp_path, header, main=MAIN), points)
    surrounded = found[:, 4] == 1
    assert 5000 < surrounded.sum() < 19_000
    assert np.isfinite(found[surrounded]).all()
    np.testing.assert_allclose(found[surrounded, 2:4], found[surrounded, :2], atol=6e-3)


def test_a_name_cannot_end_its_comment(tmp_path):
    drive = result()
    named = replace(drive, provenance=replace(drive.provenance, machine='*/ #error "ä" ??/'))
    compiled(tmp_path, table(named)[0], main=MAIN)


def test_control(tmp_path):
    """Gains, feed-forward, drop and temperatures against formulas on the map itself."""
    drive = result(drop=lambda i: 2.5 * np.tanh(i / 0.8), magnet_coefficient=(-1e-4, 1e-5))
    period, at = 1e-4, np.array([[-14.0, 6.0], [3.0, -9.0], [8.0, 12.0]])
    wanted = ExportOptions(AXIS_D, AXIS_Q, bandwidth=1500.0, sample_period=period, phase_margin=50.0)
    header, _ = content_of(drive, "c-header", wanted)
    found = read(compiled(tmp_path, header, "-DDRIVE_ID_DOUBLE", main=CONTROL), at)
    text = header.decode()
    rate = float(re.search(r"DRIVE_ID_BANDWIDTH \(\(drive_id_real\)([0-9.]+)\)", text)[1])
    assert 0.9 < rate / (0.8 * (np.pi / 2 - np.radians(50.0)) / (1.5 * period)) <= 1  # with 20 % less inductance
    slopes = drive.flux_map.inductances(*at.T)
    for k in range(2):
        assert (found[:, k] <= 1.001 * rate * slopes[:, k, k]).all()
        assert (found[:, k] >= 0.6 * rate * slopes[:, k, k]).all()
    psi_d, psi_q = drive.flux_map.psi_dq(*at.T)
    warm = drive.resistance * (1 + 3.93e-3 * 100.0)
    np.testing.assert_allclose(found[:, 2], warm * at[:, 0] - 200.0 * psi_q, rtol=1e-6)
    np.testing.assert_allclose(found[:, 3], warm * at[:, 1] + 200.0 * psi_d, rtol=1e-6)
    np.testing.assert_allclose(found[:, 4], 2.5 * np.tanh(at[:, 0] / 0.8), atol=5e-3)
    np.testing.assert_allclose(found[:, 5], psi_d - psi_q / at[:, 1] * at[:, 0], rtol=1e-6)
    np.testing.assert_allclose(found[:, 6], -1e-2, rtol=1e-12)
    assert "the phase margin of each axis is at least 50.0 degrees" in " ".join(text.replace(" * ", " ").split())
    number, shift = (
        int(re.search(rf"#define DRIVE_ID_{name} (-?\d+)", text)[1]) for name in ("KI_T_Q15", "KI_T_SHIFT")
    )
    base = drive.u_dc / np.sqrt(3) / drive.i_max
    assert number / 2.0**shift == pytest.approx(rate * drive.resistance * period / base, rel=1e-4)
    shift = int(re.search(r"#define DRIVE_ID_KP_D_SHIFT (-?\d+)", text)[1])
    numbers = np.array(re.search(r"kp_d_q15\[.*?\{(.*?)\}", text, re.DOTALL)[1].split(",")[:-1], np.int64)
    assert 2**14 <= numbers.max() < 2**15
    grid = np.meshgrid(AXIS_D, AXIS_Q, indexing="ij")
    kp = rate * drive.flux_map.inductances(*grid)[..., 0, 0] / base
    assert (numbers.reshape(kp.shape) / 2.0**shift <= kp + 0.51 / 2.0**shift).all()


@pytest.mark.parametrize(
    "name", ["spm", pytest.param("fold", marks=pytest.mark.slow)]
)  # slow: seconds for a map that folds; benchmarks/flashed.py has all six
def test_the_margin_holds_on_the_exported_interpolation(name, tmp_path):
    """At 20 000 currents, with L of the map and of both functions of the header, 20 % more and less."""
    found = drive(name)
    margins = header_margins(found, tmp_path)
    assert margins.stated >= 60.0
    assert margins.stated <= margins.worst < margins.stated + 3
    assert margins.bandwidth > 150.0  # a fold, too, keeps some


@pytest.mark.slow  # margins at thousands of points
def test_the_margin_holds_between_the_points_and_with_other_inductances(tmp_path):
    """With the inductances of formulas, and without many more points: intervals are halved where bridges saturate."""
    found, axis, period = bridged(), np.linspace(-15.0, 15.0, 21), 1e-4
    options = ExportOptions(axis, axis, bandwidth=1000.0, sample_period=period)
    header, exported = content_of(found, "c-header", options)
    said = " ".join(exported.warnings)
    stated = float(re.search(r"at least ([0-9.]+) degrees", said)[1])
    assert stated >= 60.0
    count = [int(x) for x in re.search(r"The table has ([0-9]+) x ([0-9]+) points instead of 21 x 21", said).groups()]
    assert max(count) < 45
    assert "1000 Hz" not in said
    points = over_the_disc(15.0, 20_000)
    gains = read(compiled(tmp_path, header, "-DDRIVE_ID_DOUBLE", main=CONTROL), points)
    ki = float(re.search(r"DRIVE_ID_KI \(\(drive_id_real\)([0-9.]+)\)", header.decode())[1])
    true = [4e-3 + 0.02 / np.cosh(points[:, 0] / 0.6) ** 2, 8e-3 + 0.04 / 0.6 / np.cosh(points[:, 1] / 0.6) ** 2]
    worst = min(
        open_loop_margin(gains[:, k], ki, 0.45, factor * true[k], 1.5 * period).min()
        for k in range(2)
        for factor in (0.8, 1.0, 1.2)
    )
    assert stated - 0.3 < worst < stated + 3


def test_inside_means_what_it_means_in_an_analysis(tmp_path):
    drive = result()
    m = drive.flux_map
    inside = (np.hypot(m.i_d[:, None], m.i_q) <= 15.1) & ~((np.abs(m.i_d + 5)[:, None] < 3) & (np.abs(m.i_q - 6) < 2))
    drive = replace(drive, drive=replace(drive.drive, flux_map=replace(m, inside=inside)))
    axis = np.linspace(-15.0, 15.0, 21)
    header, _ = content_of(drive, "c-header", ExportOptions(axis, axis))
    rim = 15.0 * np.array([[np.cos(a), np.sin(a)] for a in np.arange(0.01, 6.28, 0.05)])
    points = np.vstack([np.random.default_rng(4).uniform(-15, 15, (5000, 2)), rim, 0.95 * rim])
    found = read(compiled(tmp_path, header, "-DDRIVE_ID_DOUBLE", main=MAIN), points)
    wanted = MachineModel.of(drive).inside(*points.T)
    assert 0.5 < wanted.mean() < 0.9
    np.testing.assert_array_equal(found[:, 4] == 1, wanted)


def test_gains_without_data_are_finite_and_without_a_resistance_they_need_none(tmp_path):
    header, _ = table(within_14_amperes(result(resistance=np.nan)))
    main = CONTROL.replace("drive_id_resistance(120.0)", "0.0")
    found = read(compiled(tmp_path, header, "-DDRIVE_ID_DOUBLE", main=main), [(-17.0, -14.5), (60.0, 0.0)])
    assert (found[:, :2] > 0).all()


@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no C++ compiler 'c++'")
@pytest.mark.parametrize("main", [MAIN, CONTROL], ids=["maps", "control"])
def test_the_whole_disc_under_sanitizers_as_cpp(tmp_path, main):
    """As C++17, with undefined behaviour and memory checked, over and beyond the disc."""
    header, _ = content_of(result(drop=lambda i: 2.5 * np.tanh(i / 0.8)), "c-header", ExportOptions(AXIS_D, AXIS_Q))
    (tmp_path / "map.h").write_bytes(header)
    (tmp_path / "main.cpp").write_text(main)
    flags = ["-std=c++17", "-DDRIVE_ID_DOUBLE", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    subprocess.run(["c++", *flags, "main.cpp", "-o", "reader"], cwd=tmp_path, check=True, capture_output=True)
    grid = np.stack(np.meshgrid(*[np.linspace(-25, 25, 101)] * 2), axis=-1).reshape(-1, 2)
    points = [*grid, (np.nan, 1.0), (np.inf, -np.inf), (1e300, -1e300)]
    assert len(read(tmp_path / "reader", points)) == len(points)
