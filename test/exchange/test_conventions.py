"""Maps in foreign conventions come back to ours, and wrong conventions are refused with the option that fits."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from exchange_machine import AT, I_D, I_Q, PAIRS, flux, grids, torque

from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.conventions import CHOICES, Conventions, converted
from drive_id.exchange.imports.importing import import_map
from drive_id.exchange.imports.points import MapPoints
from drive_id.exchange.imports.source import Source

ROOT_2 = np.sqrt(2.0)


def foreign(axis="pm", order="dq", sign="motor", magnet="plus", q_axis="leads"):
    """Return columns i_d, i_q, psi_d, psi_q, torque as another tool would write them, from equations of its own."""
    i_d, i_q = (x.ravel() for x in grids())
    (psi_d, psi_q), turning = flux(i_d, i_q), torque(i_d, i_q)
    if axis == "sr":  # SyR-e: d_sr is our q, q_sr is our -d
        i_d, i_q, psi_d, psi_q = i_q, -i_d, psi_q, -psi_d
    if magnet == "minus":
        i_d, i_q, psi_d, psi_q = -i_d, -i_q, -psi_d, -psi_q
    if q_axis == "lags":
        i_q, psi_q = -i_q, -psi_q
    if order == "qd":
        i_d, i_q, psi_d, psi_q = i_q, i_d, psi_q, psi_d
    if sign == "generator":
        i_d, i_q, turning = -i_d, -i_q, -turning
    return i_d, i_q, psi_d, psi_q, turning


def write_csv(path, columns, names=("i_d", "i_q", "psi_d", "psi_q", "torque")):
    rows = np.stack(columns, axis=-1)
    np.savetxt(path, rows, delimiter=",", header=",".join(names[: rows.shape[1]]), comments="")
    return path


def options(**conventions):
    axis = conventions.pop("axis", None)
    return {"axis": axis, "conventions": Conventions(**conventions)}


def assert_ours(found):
    assert found.method == "imported"
    np.testing.assert_allclose(found.flux_map.psi_dq(*AT), flux(*AT), rtol=0, atol=1e-12)


CORNERS = list(product(*(CHOICES[name] for name in ("axis", "order", "sign", "magnet", "q_axis"))))


@pytest.mark.parametrize("corner", CORNERS[::3], ids="-".join)
def test_the_right_conventions_give_our_map(tmp_path, corner):
    said = dict(zip(("axis", "order", "sign", "magnet", "q_axis"), corner, strict=True))
    file = write_csv(tmp_path / "map.csv", foreign(**said))
    assert_ours(import_map(Source(file, scalars={"pole_pairs": PAIRS}, **options(**said))))


@pytest.mark.parametrize(
    ("said", "hint"),
    [
        ({"axis": "sr"}, "'--axis sr'"),
        ({"order": "qd"}, "'--order qd'"),
        ({"sign": "generator"}, "'--sign generator'"),
        ({"magnet": "minus"}, "'--magnet minus'"),
        ({"q_axis": "lags"}, "'--q-axis lags'"),
        ({"axis": "sr", "sign": "generator"}, "'--axis sr --sign generator'"),
    ],
)
def test_other_conventions_are_refused_by_the_name_of_their_option(tmp_path, said, hint):
    file = write_csv(tmp_path / "map.csv", foreign(**said))
    with pytest.raises(ConfigurationError, match="not plausible") as refused:
        import_map(Source(file, scalars={"pole_pairs": PAIRS}))
    assert hint in str(refused.value)


def test_a_wrong_option_on_a_good_file_is_refused(tmp_path):
    file = write_csv(tmp_path / "map.csv", foreign()[:4])
    for wrong in ({"axis": "sr"}, {"order": "qd"}, {"sign": "generator"}, {"magnet": "minus"}):
        with pytest.raises(ConfigurationError, match="it would be plausible with"):
            import_map(Source(file, **options(**wrong)))


@pytest.mark.parametrize(
    ("amplitude", "factor"), [("rms", ROOT_2), ("power", np.sqrt(2 / 3))], ids=["rms", "power-invariant"]
)
def test_the_scaling_shows_in_the_torque(tmp_path, amplitude, factor):
    i_d, i_q, psi_d, psi_q, turning = foreign()
    scaled = (i_d / factor, i_q / factor, psi_d / factor, psi_q / factor, turning)
    file = write_csv(tmp_path / "map.csv", scaled)
    source = Source(file, scalars={"pole_pairs": PAIRS})
    with pytest.raises(ConfigurationError, match=f"--current {amplitude} --flux {amplitude}"):
        import_map(source)
    assert_ours(import_map(replace(source, **options(current=amplitude, flux=amplitude))))
    np.testing.assert_array_equal(i_d, grids()[0].ravel())


def test_pole_pairs_follow_from_the_torque(tmp_path):
    found = import_map(Source(write_csv(tmp_path / "map.csv", foreign())))
    assert found.pole_pairs == PAIRS
    assert any("3 pole pairs" in sentence for sentence in found.statements)
    with pytest.raises(ConfigurationError, match=r"1\.5 times that of the map with 2 pole pairs"):
        import_map(Source(tmp_path / "map.csv", scalars={"pole_pairs": 2}))


def test_units_are_factors(tmp_path):
    i_d, i_q, psi_d, psi_q, _ = foreign()
    file = write_csv(tmp_path / "map.csv", (1e3 * i_d, 1e3 * i_q, 1e3 * psi_d, 1e3 * psi_q))
    assert_ours(import_map(Source(file, **options(current_scale=1e-3, flux_scale=1e-3))))
    file = write_csv(tmp_path / "huge.csv", (1e-6 * i_d, 1e-6 * i_q, psi_d, psi_q))
    with pytest.raises(ConfigurationError, match=r"typical inductance is .*: check .*--current-scale"):
        import_map(Source(file))
    file = write_csv(tmp_path / "milli.csv", (1e3 * i_d, 1e3 * i_q, psi_d, psi_q))
    with pytest.raises(ConfigurationError, match=r"L / R is .*: check .*--current-scale"):
        import_map(Source(file, scalars={"resistance": 0.45}))


def test_what_no_machine_has_is_refused(tmp_path):
    i_d, i_q, psi_d, psi_q, _ = foreign()
    loop = write_csv(tmp_path / "curl.csv", (i_d, i_q, psi_d + 0.03 * i_q, psi_q - 0.03 * i_d))
    with pytest.raises(ConfigurationError, match="not reciprocal"):
        import_map(Source(loop))
    noise = np.random.default_rng(0).normal(size=(2, len(i_d)))
    with pytest.raises(ConfigurationError, match="no choice of axes, signs and order makes it plausible"):
        import_map(Source(write_csv(tmp_path / "noise.csv", (i_d, i_q, *noise))))


@pytest.mark.parametrize(("name", "value"), [("axis", "dq"), ("order", "q"), ("current", "RMS"), ("flux_scale", 0.0)])
def test_unknown_conventions(name, value):
    with pytest.raises(ConfigurationError, match=f"{name} is"):
        Conventions(**{name: value})


def test_the_angle_turns_with_the_axes():
    """A phase flux does not depend on the axes in which it is given."""
    theta = np.radians(np.arange(0.0, 60.0, 5.0))
    rng = np.random.default_rng(3)
    psi = rng.normal(size=(20, 2, 12))
    points = MapPoints(rng.normal(size=(20, 2)), psi, theta)
    ours = converted(points, Conventions(axis="sr"))

    def phase(found):
        return np.cos(found.theta) * found.psi_dq[:, 0] - np.sin(found.theta) * found.psi_dq[:, 1]

    np.testing.assert_allclose(phase(ours), phase(points), atol=1e-14)
    turned = converted(points, Conventions(magnet="minus"))
    np.testing.assert_allclose(phase(turned), phase(points), atol=1e-14)


def test_index_order_of_a_grid(tmp_path):
    psi_d, psi_q = flux(*grids())
    np.savez(tmp_path / "turned.npz", i_d=I_D, i_q=I_Q, psi_d=psi_d.T, psi_q=psi_q.T)
    with pytest.raises(ConfigurationError, match="would fit with --order qd"):
        import_map(Source(tmp_path / "turned.npz"))
    assert_ours(import_map(Source(tmp_path / "turned.npz", **options(order="qd"))))
    square = np.arange(-15.0, 15.1, 2.5)
    psi_d, psi_q = flux(*grids(square, square))
    np.savez(tmp_path / "square.npz", i_d=square, i_q=square, psi_d=psi_d.T, psi_q=psi_q.T)
    with pytest.raises(ConfigurationError, match="'--order qd'"):
        import_map(Source(tmp_path / "square.npz"))
    found = import_map(Source(tmp_path / "square.npz", **options(order="qd")))
    np.testing.assert_allclose(found.flux_map.psi_dq(-12.5, 5.0), flux(-12.5, 5.0), atol=1e-12)
