"""The exported C header, compiled and read at given currents, and the margins of its current controllers."""

from __future__ import annotations

import re
import subprocess
from typing import NamedTuple

import numpy as np

from drive_id.exchange.exports.exporting import content_of
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
SLOPES = r"""
#include "map.h"
#include <stdio.h>
#define D(f) (f(d + h, q) - f(d - h, q)) / (2 * h)
#define Q(f) (f(d, q + h) - f(d, q - h)) / (2 * h)
int main(void)
{
    const double h = 1e-6 * DRIVE_ID_I_MAX;
    double d, q;
    while (scanf("%lf %lf", &d, &q) == 2) {
        printf("%.17g %.17g %.17g %.17g %.17g %.17g\n", drive_id_kp_d(d, q), drive_id_kp_q(d, q), D(drive_id_psi_d),
               Q(drive_id_psi_q), D(drive_id_psi_d_bicubic), Q(drive_id_psi_q_bicubic));
    }
    return 0;
}
"""


def compiled(folder, header, *options, main):
    (folder / "map.h").write_bytes(header)
    (folder / "main.c").write_text(main)
    command = ["cc", *STRICT, *options, "main.c", "-o", "reader", "-lm"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return folder / "reader"


def read(program, points):
    text = "\n".join(f"{d:.17g} {q:.17g}" for d, q in points)
    ran = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    return np.array([[float(word) for word in line.split()] for line in ran.stdout.splitlines()])


def open_loop_margin(kp, ki, r, inductance, delay):
    """Return the phase margins, degrees, of open loops, whose gains fall: bisected for the crossing of 1."""
    low, high = np.full(len(kp), 1e-6), np.full(len(kp), 1e7)
    for _ in range(100):
        w = 1j * np.sqrt(low * high)
        loop = (kp + ki / w) / (r + w * inductance)
        low, high = np.where(np.abs(loop) > 1, w.imag, low), np.where(np.abs(loop) > 1, high, w.imag)
    return 180 + np.degrees(np.angle(loop) - low * delay)


def over_the_disc(i_max, count):
    """Return random currents (N, 2), of which a quarter lie near zero and two quarters near an axis."""
    rng = np.random.default_rng(5)
    size, turn = i_max * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    points = np.stack([size * np.cos(turn), size * np.sin(turn)], axis=1)
    part = count // 4
    points[:part] *= 0.1
    points[part : 2 * part, 0] *= 0.05
    points[2 * part : 3 * part, 1] *= 0.05
    return points


class Margins(NamedTuple):
    """Phase margins, degrees, of a header and of the worst current, with bandwidth, Hz, and points of the table."""

    stated: float
    worst: float
    bandwidth: float
    points: tuple[int, int]


def header_margins(found, folder):
    """Export a result for 1000 Hz, 0.1 ms and 60 degrees with 21 points, and return its margins.

    L is that of the map and of both interpolations of the header, as it is, 20 % more and 20 % less.
    """
    period, axis = 1e-4, np.linspace(-found.i_max, found.i_max, 21)
    options = ExportOptions(axis, axis, bandwidth=1000.0, sample_period=period)
    content, exported = content_of(found, "c-header", options)
    stated = float(re.search(r"at least ([0-9.]+) degrees", " ".join(exported.warnings))[1])
    points = over_the_disc(found.i_max, 20_000)
    got = read(compiled(folder, content, "-DDRIVE_ID_DOUBLE", main=SLOPES), points)
    text = content.decode()
    rate, ki = (
        float(re.search(rf"DRIVE_ID_{name} \(\(drive_id_real\)([0-9.]+)\)", text)[1]) for name in ("BANDWIDTH", "KI")
    )
    of_map = MapTable.of(found, options).machine.inductances(*points.T)
    worst = min(
        open_loop_margin(got[:, k], ki, found.resistance, factor * inductance, 1.5 * period).min()
        for k in range(2)
        for inductance in (of_map[:, k, k], got[:, 2 + k], got[:, 4 + k])
        for factor in (0.8, 1.0, 1.2)
    )
    count = tuple(int(re.search(rf"DRIVE_ID_{name} ([0-9]+)", text)[1]) for name in ("ND", "NQ"))
    return Margins(stated, float(worst), rate / (2 * np.pi), count)
