"""Differences of two results with known differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exchange_machine import AT, I_D, I_MAX, I_Q, PAIRS, flux, grids, result

from drive_id.core.maps.flux_map import FluxMap
from drive_id.errors import CoverageError
from drive_id.reporting.difference import difference_table, draw_difference
from drive_id.result.comparison import compare
from drive_id.result.pictures.picture import rendered


def changed(sigma=1e-4, drop=None, **fields):
    """Return the drive with psi_d + 1 mWb, psi_q + 0.1 mH i_q, R + 10 mΩ."""
    drive = result(sigma, drop=drop)
    m = drive.flux_map
    moved = replace(m, psi_d=m.psi_d + 1e-3, psi_q=m.psi_q + 1e-4 * grids()[1])
    parts = {"flux_map": moved, "resistance": drive.resistance + 0.01, "sigma_resistance": 0.005} | fields
    return replace(drive, drive=replace(drive.drive, **parts))


def test_known_differences():
    found = compare(changed(drop=lambda i: 0.5 * np.sign(i)), result())
    np.testing.assert_allclose(found.difference[..., 0], 1e-3, atol=1e-12)
    d, q = list(I_D).index(-7.5), list(I_Q).index(-9.0)
    np.testing.assert_allclose(found.difference[d, q], [1e-3, -9e-4], atol=1e-12)
    np.testing.assert_allclose(found.in_sigma[d, q], np.array([10.0, -9.0]) / np.sqrt(2), atol=1e-6)
    tree = found.tree()
    largest_d, largest_q = (np.abs(x).max() for x in flux(*grids()))
    assert tree["nrmse_d"] == pytest.approx(1e-3 / largest_d)
    assert tree["nrmse_q"] == pytest.approx(1e-4 * np.sqrt(np.mean(I_Q**2)) / largest_q)
    assert abs(tree["worst"]["i_q"]) == 18.0
    assert tree["worst"]["psi_q"] == pytest.approx(1e-4 * tree["worst"]["i_q"])
    assert tree["resistance"] == pytest.approx(0.01)
    assert tree["resistance_in_sigma"] == pytest.approx(2.0)
    i_d, i_q = grids()
    difference = 1.5 * PAIRS * (1e-3 * i_q - 1e-4 * i_q * i_d)
    np.testing.assert_allclose(found.torque, difference, atol=1e-9)
    assert tree["torque"]["largest"] == pytest.approx(np.abs(difference).max())
    assert tree["inverter_curve"]["largest"] == pytest.approx(0.5)


def test_other_grids_and_parts_of_the_plane():
    axis = np.linspace(-11.0, 11.0, 23)
    psi_d, psi_q = flux(*np.meshgrid(axis, axis, indexing="ij"))
    unknown = np.full(psi_d.shape, np.nan)
    inside = np.hypot(axis[:, None], axis) <= 10
    drive = result()
    small = replace(
        drive, drive=replace(drive.drive, flux_map=FluxMap(axis, axis, psi_d, psi_q, unknown, unknown, inside))
    )
    for found in (compare(small, drive), compare(drive, small)):
        radius = np.hypot(found.i_d[:, None], found.i_q)
        assert not found.common[radius > 10.5].any()
        assert found.common[radius < 8].all()
        assert np.nanmax(np.abs(found.difference)) < 5e-4  # both are splines through coarse points
        assert found.tree()["rms_d_in_sigma"] is not None  # that of the other result
    elsewhere = replace(small.flux_map, i_d=axis + 100)
    with pytest.raises(CoverageError, match="no currents in common"):
        compare(drive, replace(small, drive=replace(small.drive, flux_map=elsewhere)))


@pytest.mark.parametrize(("link", "power", "only"), [(1.02, 1, ""), (1.02, -1, ""), (0.97, 1, ""), (1.02, 1, "d")])
def test_the_dc_link_is_named_where_both_fluxes_scale_with_it(link, power, only):
    drive = result(1e-5)
    m, u_dc = drive.flux_map, drive.u_dc or 400.0
    factor = link**power
    moved = replace(m, psi_d=m.psi_d * factor, psi_q=m.psi_q if only else m.psi_q * factor)
    second = drive.given(u_dc=u_dc)
    first = replace(drive, drive=replace(drive.drive, flux_map=moved)).given(u_dc=u_dc * link)
    told = compare(first, second).verdict
    assert ("The DC link can explain it" in told) == (not only)  # heat of the magnets moves psi_d alone
    if not only:
        assert f"{100 * (link - 1):+.2g} %, and ψ_d and ψ_q differ by {100 * (factor - 1):+.2g} %" in told
    assert "DC link" not in compare(first, second.given(u_dc=first.u_dc)).verdict
    assert "DC link" not in compare(second.given(u_dc=1.004 * u_dc), first.given(u_dc=u_dc)).verdict


def test_the_temperatures_of_resistances_are_told_where_they_differ():
    """R at 20 °C was compared with R as recorded: 403 standard errors, without a word."""
    hot, drive = changed(sigma_resistance=1e-6), result()
    known = replace(drive, provenance=replace(drive.provenance, temperature=20.0))
    told = compare(hot, known).verdict
    assert told.endswith("R of A holds as recorded, R of B at 20 °C.")
    assert "holds" not in compare(hot, drive).verdict
    assert "holds" not in compare(drive, known).verdict


def test_differences_as_of_interpolation_are_those_of_one_machine():
    """A result and its own table, imported again, were doubted at 4.4 standard errors."""
    drive = result(1e-7)
    m = drive.flux_map
    table = replace(drive, drive=replace(drive.drive, flux_map=replace(m, psi_d=m.psi_d * (1 + 5e-5))))
    assert compare(table, drive).largest_in_sigma > 10
    assert "The same machine: tables of one map differ as much" in compare(table, drive).verdict
    other = replace(table, drive=replace(table.drive, resistance=1.1 * drive.resistance, sigma_resistance=1e-6))
    assert "the standard errors alone do not explain" in compare(other, drive).verdict


def test_what_is_unknown_is_none():
    first, second = changed(np.nan, method="imported", resistance=np.nan), result(np.nan)
    nameless = replace(second, provenance=replace(second.provenance, pole_pairs=None))
    tree = compare(first, nameless).tree()
    names = ("rms_d_in_sigma", "largest_in_sigma", "resistance", "resistance_in_sigma", "inverter_curve", "torque")
    assert [tree[name] for name in names] == [None] * len(names)
    assert tree["nrmse_d"] > 0


def test_python_shows_the_verdict_and_the_table_of_the_command_line():
    found = compare(changed(), result())
    shown = repr(found)
    assert found.verdict in shown
    assert "array(" not in shown
    assert len(shown.splitlines()) == 3 + 8  # names, verdict, heading
    assert found._repr_html_().count("<tr>") == 9


def test_picture_and_table():
    found = compare(changed(), result())
    whole = draw_difference(found)
    picture = rendered(whole, dpi=40)
    assert picture.startswith(b"\x89PNG")
    figure = draw_difference(compare(changed(np.nan), result(np.nan)))
    assert figure.get_size_inches()[1] < whole.get_size_inches()[1]
    assert difference_table(found).row_count == 8
    assert AT[0].max() < I_MAX
