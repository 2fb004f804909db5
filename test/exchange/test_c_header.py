"""The C header compiles without a warning, and interpolates as scipy and as a formula of its own do."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from exchange_machine import result
from scipy.interpolate import CubicHermiteSpline, RegularGridInterpolator

from drive_id.exchange.exports.exporting import TableChoice, content_of

CC = shutil.which("cc")
pytestmark = pytest.mark.skipif(CC is None, reason="there is no C compiler 'cc'")
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
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")


def compiled(folder, header, *options):
    (folder / "map.h").write_bytes(header)
    (folder / "main.c").write_text(MAIN)
    command = [CC, *STRICT, *options, "main.c", "-o", "reader", "-lm"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return folder / "reader"


def read(program, points):
    text = "\n".join(f"{d:.17g} {q:.17g}" for d, q in points)
    ran = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    return np.array([[float(word) for word in line.split()] for line in ran.stdout.splitlines()])


def table(drive, *, filled=False):
    choice = TableChoice(AXIS_D, AXIS_Q, filled)
    header, _ = content_of(drive, "c-header", choice)
    grid = np.meshgrid(AXIS_D, AXIS_Q, indexing="ij")
    return header, np.stack(drive.flux_map.psi_dq(*grid))


def hermite(axis, values, x):
    """Interpolate along the first axis with the slopes of parabolas: numpy's second-order differences."""
    return CubicHermiteSpline(axis, values, np.gradient(values, axis, axis=0, edge_order=2))(x)


@pytest.mark.parametrize(("options", "accuracy"), [((), 2e-6), (("-DDRIVE_ID_DOUBLE",), 5e-9)], ids=["float", "double"])
def test_ten_thousand_points(tmp_path, options, accuracy):
    header, psi = table(result())
    rng = np.random.default_rng(7)
    points = rng.uniform([-17.5, -15.0], [12.5, 15.0], (10_000, 2))
    points[:4] = [[-9.0, 6.0], [12.5, -15.0], [-17.5, 15.0], [0.0, 0.0]]
    found = read(compiled(tmp_path, header, *options), points)
    largest = np.abs(psi).max()
    for k in range(2):
        linear = RegularGridInterpolator((AXIS_D, AXIS_Q), psi[k])(points)
        np.testing.assert_allclose(found[:, k], linear, rtol=0, atol=accuracy * largest)
        rows = hermite(AXIS_Q, psi[k].T, points[:, 1])  # (N, D)
        cubic = np.array([hermite(AXIS_D, row, x) for row, x in zip(rows[:500], points[:500, 0], strict=True)])
        np.testing.assert_allclose(found[:500, 2 + k], cubic, rtol=0, atol=accuracy * largest)
    assert (found[:, 4] == 1).all()


def test_beyond_the_axes_and_without_data(tmp_path):
    drive = result()
    m = drive.flux_map
    inside = np.hypot(m.i_d[:, None], m.i_q) <= 14.0
    drive = replace(drive, drive=replace(drive.drive, flux_map=replace(m, inside=inside)))
    header, psi = table(drive)
    points = [(40.0, 0.0), (-17.0, -14.5), (float("nan"), 0.0), (-2.0, 1.0), (-5.5, 3.0)]
    found = read(compiled(tmp_path, header), points)
    assert found[:, 4].tolist() == [0, 0, 0, 1, 1]
    assert np.isnan(found[1, :4]).all()
    assert np.isnan(found[2, :4]).all()
    np.testing.assert_allclose(found[4, :4], [*psi[:, 3, 12]] * 2, atol=1e-6)
    filled = read(compiled(tmp_path, table(drive, filled=True)[0]), points)
    assert np.isfinite(filled[:2, :4]).all()
    assert filled[:2, 4].tolist() == [0, 0]


def test_inside_there_is_a_number(tmp_path):
    """The bicubic functions take neighbours that may have no data."""
    drive = result()
    m = drive.flux_map
    inside = np.hypot(m.i_d[:, None], m.i_q) <= 14.0
    drive = replace(drive, drive=replace(drive.drive, flux_map=replace(m, inside=inside)))
    header, _ = table(drive)
    points = np.random.default_rng(4).uniform(-15, 15, (20_000, 2))
    found = read(compiled(tmp_path, header), points)
    surrounded = found[:, 4] == 1
    assert 5000 < surrounded.sum() < 19_000
    assert np.isfinite(found[surrounded]).all()
    np.testing.assert_allclose(found[surrounded, 2:4], found[surrounded, :2], atol=6e-3)


def test_a_name_cannot_end_its_comment(tmp_path):
    drive = result()
    named = replace(drive, provenance=replace(drive.provenance, machine='*/ #error "ä" ??/'))
    compiled(tmp_path, table(named)[0])
