"""Each format that can be imported, written here from its description, gives the map that it was made of."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from exchange_machine import AT, I_D, I_MAX, I_Q, PAIRS, RESISTANCE, U_DC, flux, grids, torque
from scipy.io import savemat

import drive_id
from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.conventions import Conventions
from drive_id.exchange.imports.importing import import_map
from drive_id.exchange.imports.source import Source
from drive_id.files.results.identification import write_results

THETA = np.arange(0.0, 60.0, 5.0)


def ripple(i_d, i_q, theta):
    """Return fluxes (..., H), Wb, with a 6th and a 12th harmonic at electrical angles, rad."""
    psi_d, psi_q = (np.asarray(x)[..., None] for x in flux(i_d, i_q))
    d, q = np.asarray(i_d)[..., None], np.asarray(i_q)[..., None]
    return (
        psi_d + 1e-3 * np.cos(6 * theta) + 1e-4 * q * np.sin(6 * theta) + 5e-4 * np.cos(12 * theta),
        psi_q + 2e-4 * d * np.cos(6 * theta) + 3e-3 * np.sin(12 * theta),
    )


def assert_map(found, atol=1e-12, at=AT):
    np.testing.assert_allclose(found.flux_map.psi_dq(*at), flux(*at), rtol=0, atol=atol)


def assert_harmonics(found, atol=1e-9):
    by_order = {h.order: h for h in found.harmonics}
    assert set(by_order) == {6, 12}
    m = found.flux_map
    d, q = int(np.flatnonzero(m.i_d == -7.5)[0]), int(np.flatnonzero(m.i_q == 12.0)[0])
    h6, h12 = by_order[6], by_order[12]
    six = [h6.psi_d_cos[d, q], h6.psi_d_sin[d, q], h6.psi_q_cos[d, q], h6.psi_q_sin[d, q]]
    np.testing.assert_allclose(six, [1e-3, 1.2e-3, -1.5e-3, 0.0], atol=atol)
    twelve = [h12.psi_d_cos[d, q], h12.psi_d_sin[d, q], h12.psi_q_cos[d, q], h12.psi_q_sin[d, q]]
    np.testing.assert_allclose(twelve, [5e-4, 0.0, 0.0, 3e-3], atol=atol)


def test_our_machine_file_over_the_rotor_position(tmp_path):
    psi = ripple(*grids(), np.radians(THETA))
    np.savez(
        tmp_path / "m.npz", id=I_D, iq=I_Q, psi_d=psi[0].mean(-1), psi_q=psi[1].mean(-1), theta_e_deg=THETA,
        psi_d_theta=psi[0], psi_q_theta=psi[1], R=RESISTANCE, pole_pairs=PAIRS, i_max=I_MAX, u_dc=U_DC,
    )  # fmt: skip
    found = import_map(Source(tmp_path / "m.npz"))
    assert_map(found)
    assert_harmonics(found)
    known = (found.resistance, found.pole_pairs, found.i_max, found.u_dc, found.machine)
    assert known == (RESISTANCE, PAIRS, I_MAX, U_DC, "m")
    assert np.isnan(found.flux_map.sigma_d).all()
    assert found.flux_map.inside.all()


def test_motulator_with_and_without_angles(tmp_path):
    i_d, i_q = grids()
    psi_d, psi_q = flux(i_d, i_q)
    np.savez(tmp_path / "flat.npz", i_s_dq=i_d + 1j * i_q, psi_s_dq=psi_d + 1j * psi_q, R_s=0.3, n_p=2)
    found = import_map(Source(tmp_path / "flat.npz", scalars={"pole_pairs": 3.0}))
    assert_map(found)
    assert (found.resistance, found.pole_pairs) == (0.3, 3)
    theta = np.radians(THETA)
    psi_d, psi_q = ripple(i_d, i_q, theta)
    current = np.broadcast_to((i_d + 1j * i_q)[..., None], psi_d.shape)
    turning = np.broadcast_to(theta, psi_d.shape)
    mixed = np.random.default_rng(0).permutation(psi_d.size)
    arrays = {"i_s_dq": current, "psi_s_dq": psi_d + 1j * psi_q, "theta_m": turning}
    np.savez(tmp_path / "turning.npz", **{name: values.ravel()[mixed] for name, values in arrays.items()})
    found = import_map(Source(tmp_path / "turning.npz"))
    assert_map(found)
    assert_harmonics(found)
    np.savez(tmp_path / "gap.npz", **{name: values.ravel()[mixed[1:]] for name, values in arrays.items()})
    with pytest.raises(ConfigurationError, match="exactly once at each of its 12 rotor positions"):
        import_map(Source(tmp_path / "gap.npz"))


def syre_model(axis):
    """Return SyR-e's struct: FluxMap_dq is [iq, id] in the axes of the file."""
    if axis == "PM":
        i_d, i_q = np.meshgrid(I_D, I_Q)
        psi_d, psi_q = flux(i_d, i_q)
    else:  # d_sr is our q, q_sr our -d
        i_d, i_q = np.meshgrid(I_Q, -I_D[::-1])
        psi = flux(-i_q, i_d)
        psi_d, psi_q = psi[1], -psi[0]
    return {"Id": i_d, "Iq": i_q, "Fd": psi_d, "Fq": psi_q}


@pytest.mark.process
@pytest.mark.parametrize("axis", ["PM", "SR"])
def test_syre(tmp_path, axis):
    maps = syre_model(axis)
    data = {"Rs": RESISTANCE, "p": PAIRS, "Imax": I_MAX, "Vdc": U_DC, "axisType": axis}
    savemat(tmp_path / "motor.mat", {"motorModel": {"data": data, "FluxMap_dq": maps}})
    found = import_map(Source(tmp_path / "motor.mat"))
    assert_map(found)
    assert (found.resistance, found.pole_pairs, found.i_max, found.u_dc) == (RESISTANCE, PAIRS, I_MAX, U_DC)
    savemat(tmp_path / "fdfq_idiq_n256.mat", maps | {"dataSet": {"axisType": axis}})
    flat = import_map(Source(tmp_path / "fdfq_idiq_n256.mat", scalars={"pole_pairs": 3}))
    np.testing.assert_allclose(flat.flux_map.psi_d, found.flux_map.psi_d, atol=1e-15)
    assert_map(import_map(Source(tmp_path / "fdfq_idiq_n256.mat", axis=axis.lower())))
    for file in ("motor.mat", "fdfq_idiq_n256.mat"):
        other = Source(tmp_path / file, axis="sr" if axis == "PM" else "pm")
        with pytest.raises(ConfigurationError, match=f"contradicts .* type {axis.lower()}"):
            import_map(other)


@pytest.mark.process
def test_a_syre_flux_file_that_does_not_tell_its_axes(tmp_path):
    savemat(tmp_path / "fdfq.mat", syre_model("SR"))
    with pytest.raises(ConfigurationError, match="'--axis sr'"):
        import_map(Source(tmp_path / "fdfq.mat"))
    assert_map(import_map(Source(tmp_path / "fdfq.mat", axis="sr")))


def motor_cad(i_d, i_q):
    """Return a saturation and loss map over two rotor positions more than one period, as Motor-CAD exports it."""
    degrees = np.append(THETA, 60.0)
    psi_d, psi_q = ripple(i_d, i_q, np.radians(degrees))
    return {
        "Id_Peak": i_d,
        "Iq_Peak": i_q,
        "Angular_Rotor_Position": np.broadcast_to(degrees, psi_d.shape),
        "Angular_Flux_Linkage_D": psi_d,
        "Angular_Flux_Linkage_Q": psi_q,
        "Electromagnetic_Torque": torque(i_d, i_q),
        "Frequency": 50.0,
        "Speed": 1000.0,
        "Phase_Resistance_DC_at_20C": RESISTANCE,
    }


@pytest.mark.process
def test_motor_cad_on_a_rectangular_grid(tmp_path):
    savemat(tmp_path / "SaturationLossMap.mat", motor_cad(*grids()))
    found = import_map(Source(tmp_path / "SaturationLossMap.mat"))
    assert_map(found)
    assert_harmonics(found)
    assert (found.resistance, found.pole_pairs) == (RESISTANCE, 3)
    turned = import_map(Source(tmp_path / "SaturationLossMap.mat", angle_offset=15.0))  # 90 degrees of the 6th
    for now, before in zip(turned.harmonics[:1], found.harmonics[:1], strict=True):
        np.testing.assert_allclose(now.psi_d_sin, before.psi_d_cos, atol=1e-12)
        np.testing.assert_allclose(now.psi_d_cos, -before.psi_d_sin, atol=1e-12)


def test_motor_cad_on_a_polar_grid(tmp_path):
    amplitude, advance = np.meshgrid(np.linspace(0, 18, 11), np.radians(np.arange(-180.0, 180.0, 20)), indexing="ij")
    i_d, i_q = -amplitude * np.sin(advance), amplitude * np.cos(advance)
    savemat(tmp_path / "SaturationLossMap.mat", motor_cad(i_d, i_q))
    found = import_map(Source(tmp_path / "SaturationLossMap.mat"))
    at = (np.array([-12.0, -7.3, 5.0, 10.0]), np.array([6.0, -9.4, 12.0, -4.2]))
    assert_map(found, atol=1e-3, at=at)
    assert any("co-energy spline" in sentence for sentence in found.statements)
    assert {harmonic.order for harmonic in found.harmonics} == {6, 12}
    L = found.flux_map.inductances(*at)
    np.testing.assert_allclose(L[:, 0, 1], L[:, 1, 0], atol=2e-4 * np.abs(L).max())
    assert np.isnan(found.flux_map.psi_dq(19.0, 19.0)[0])


def test_scattered_points(tmp_path):
    rng = np.random.default_rng(5)
    radius, angle = 16 * np.sqrt(rng.random(300)), 2 * np.pi * rng.random(300)
    i_d, i_q = radius * np.cos(angle), radius * np.sin(angle)
    rows = np.stack([i_q, *flux(i_d, i_q), i_d], axis=-1)
    np.savetxt(tmp_path / "points.txt", rows)
    columns = {"i_q": "1", "psi_d": "2", "psi_q": "3", "i_d": "4"}
    found = import_map(Source(tmp_path / "points.txt", columns=columns))
    inside = np.hypot(*AT) < 14
    assert_map(found, atol=1e-3, at=(AT[0][inside], AT[1][inside]))
    assert found.i_max == pytest.approx(16, abs=0.6)


def test_half_a_map_is_mirrored_and_says_so(tmp_path):
    i_q = I_Q[I_Q >= 0]
    psi_d, psi_q = flux(*grids(I_D, i_q), skew=0.0)
    np.savez(tmp_path / "half.npz", i_d=I_D, i_q=i_q, psi_d=psi_d, psi_q=psi_q)
    found = import_map(Source(tmp_path / "half.npz"))
    np.testing.assert_allclose(found.flux_map.psi_dq(*AT), flux(*AT, skew=0.0), atol=1e-12)
    assert any("mirror image" in sentence for sentence in found.statements)
    psi_d, psi_q = flux(*grids(I_D, i_q), skew=2e-3)
    np.savez(tmp_path / "lopsided.npz", i_d=I_D, i_q=i_q, psi_d=psi_d, psi_q=psi_q)
    alone = import_map(Source(tmp_path / "lopsided.npz"))
    assert alone.flux_map.i_q[0] == 0.0
    assert not any("mirror image" in sentence for sentence in alone.statements)


def test_the_harmonics_of_a_mirrored_half(tmp_path):
    """A flux of phase a at a mirrored current and position is the same."""
    i_q, theta = I_Q[I_Q >= 0], np.radians(THETA)
    d, q = grids(I_D, i_q)
    base = flux(d, q, skew=0.0)
    psi_d = base[0][..., None] + 1e-3 * np.cos(6 * theta) + 1e-4 * q[..., None] * np.sin(6 * theta)
    psi_q = base[1][..., None] + 1e-3 * np.sin(6 * theta) + 1e-4 * q[..., None] * np.cos(6 * theta)
    np.savez(
        tmp_path / "half.npz", id=I_D, iq=i_q, psi_d=base[0], psi_q=base[1], theta_e_deg=THETA, psi_d_theta=psi_d,
        psi_q_theta=psi_q,
    )  # fmt: skip
    (h,) = import_map(Source(tmp_path / "half.npz")).harmonics
    for part, sign in ((h.psi_d_cos, 1), (h.psi_d_sin, -1), (h.psi_q_cos, -1), (h.psi_q_sin, 1)):
        np.testing.assert_allclose(part[:, ::-1], sign * part, atol=1e-12)
    np.testing.assert_allclose(h.psi_d_sin[2, list(I_Q).index(-6.0)], -6e-4, atol=1e-12)


def test_matrices(tmp_path):
    for name, values in zip(("d", "q"), flux(*grids()), strict=True):
        rows = [
            ["i_d\\i_q", *map(str, I_Q)],
            *([str(i), *map(repr, row.tolist())] for i, row in zip(I_D, values, strict=True)),
        ]
        (tmp_path / f"{name}.csv").write_text("# pole_pairs: 3\n" + "\n".join(";".join(row) for row in rows))
    source = Source(tmp_path / "d.csv", psi_q_file=tmp_path / "q.csv")
    found = import_map(source)
    assert_map(found)
    assert found.pole_pairs == 3
    with pytest.raises(ConfigurationError, match="'--order dq'"):
        import_map(replace(source, conventions=Conventions(order="qd")))


def test_angles_in_a_column_mechanical(tmp_path):
    theta = np.radians(THETA)
    i_d, i_q = grids()
    psi_d, psi_q = ripple(i_d, i_q, theta)
    parts = [np.broadcast_to(x[..., None], psi_d.shape).ravel() for x in (i_d, i_q)]
    parts += [psi_d.ravel(), psi_q.ravel(), np.broadcast_to(THETA / PAIRS, psi_d.shape).ravel()]
    np.savetxt(tmp_path / "m.csv", np.stack(parts, -1), delimiter="\t", header="Id\tIq\tFd\tFq\tpos\n", comments="")
    columns = {"i_d": "Id", "i_q": "Iq", "psi_d": "Fd", "psi_q": "Fq", "theta": "pos"}
    source = Source(tmp_path / "m.csv", columns=columns, angle="mechanical", scalars={"pole_pairs": PAIRS})
    found = import_map(source)
    assert_map(found)
    assert_harmonics(found)
    with pytest.raises(ConfigurationError, match="--angle mechanical"):
        import_map(Source(tmp_path / "m.csv", columns=columns))


def test_points_that_are_marked_as_missing(tmp_path):
    psi_d, psi_q = flux(*grids())
    missing = np.hypot(*grids()) > 20.5
    np.savez(tmp_path / "disc.npz", i_d=I_D, i_q=I_Q, psi_d=np.where(missing, np.nan, psi_d), psi_q=psi_q)
    found = import_map(Source(tmp_path / "disc.npz"))
    np.testing.assert_array_equal(found.flux_map.inside, ~missing)
    assert_map(found, atol=2e-5)  # the spline feels the continuation beyond the rim
    assert np.isfinite(found.flux_map.psi_d).all()


def test_a_sparse_grid_stays_one(tmp_path):
    """As of a short recording, whose trajectory leaves most of the plane out."""
    psi_d, psi_q = flux(*grids())
    inside = np.random.default_rng(2).random(psi_d.shape) < 0.25
    np.savez(tmp_path / "sparse.npz", i_d=I_D, i_q=I_Q, psi_d=psi_d, psi_q=psi_q, inside=inside)
    found = import_map(Source(tmp_path / "sparse.npz")).flux_map
    np.testing.assert_array_equal(found.i_d, I_D)
    np.testing.assert_array_equal(found.i_q, I_Q)
    np.testing.assert_array_equal(found.inside, inside)
    np.testing.assert_allclose(found.psi_q[inside], psi_q[inside], atol=1e-15)


def test_what_is_written_loads_and_says_that_errors_are_unknown(tmp_path):
    psi_d, psi_q = flux(*grids())
    np.savez(tmp_path / "bare.npz", i_d=I_D, i_q=I_Q, psi_d=psi_d, psi_q=psi_q)
    found = import_map(Source(tmp_path / "bare.npz"))
    write_results(tmp_path / "out", found.drive, found.provenance)
    tree = json.loads((tmp_path / "out" / "identification.json").read_text())
    unknown = ("resistance", "sigma_resistance", "sigma_voltage_error", "pole_pairs", "u_dc")
    assert [tree[name] for name in unknown] == [None] * 5
    assert tree["method"] == "imported"
    loaded = drive_id.load(tmp_path / "out")
    assert_map(loaded)
    assert np.isnan(loaded.resistance)
    assert loaded.metrics["coverage"] == pytest.approx(0.955, abs=0.06)
    with pytest.raises(ConfigurationError, match="pole pairs"):
        loaded.to_machine()


BAD = {
    "empty": ("m.csv", b"", "is empty"),
    "binary": ("m.csv", b"\xff\xfe\x00\x01" * 20, "cannot be read as text"),
    "comma decimals": ("m.csv", b"i_d;i_q;psi_d;psi_q\n1,5;0;0,1;0\n", "decimal point"),
    "ragged": ("m.csv", b"i_d,i_q,psi_d,psi_q\n1,2,3,4\n1,2,3\n", "3 columns in data row 2"),
    "headings": ("m.csv", b"Id,Iq,Fd,Fq\n1,2,3,4\n", "no column i_d (it has Id, Iq, Fd, Fq)"),
    "no headings": ("m.csv", b"1,2,3,4\n", "4 columns without headings"),
    "one row": ("m.csv", b"i_d,i_q,psi_d,psi_q\n1,2,3,4\n", "has 1 row with"),
    "npz": ("m.npz", b"no zip", "not an .npz archive"),
    "mat": ("m.mat", b"no mat", "not a MATLAB file"),
    "suffix": ("m.xyz", b"", "give --format"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files(tmp_path, case):
    name, content, said = BAD[case]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigurationError) as refused:
        import_map(Source(tmp_path / name))
    assert said in str(refused.value)


def _point_rows(psi_scale=1.0, change=None):
    i_d, i_q = (axis.ravel() for axis in grids())
    psi = np.stack(flux(i_d, i_q)) * psi_scale
    if change is not None:
        psi[change] += 0.15 * np.abs(psi).max()
    return np.column_stack([i_d, i_q, *psi])


def _import_points(path, rows, header="i_d,i_q,psi_d,psi_q", **options):
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return import_map(Source(path, **options))


def test_other_bad_input(tmp_path):
    with pytest.raises(ConfigurationError, match="no file"):
        Source(tmp_path / "none.csv")
    savemat(tmp_path / "other.mat", {"x": 1.0})
    with pytest.raises(ConfigurationError, match=r"holds x.*\.csv"):
        import_map(Source(tmp_path / "other.mat"))
    with pytest.raises(ConfigurationError, match="no import format 'xls': choose npz, syre"):
        import_map(Source(tmp_path / "other.mat", "xls"))
    np.savez(tmp_path / "few.npz", i_d=I_D, psi_d=I_D)
    with pytest.raises(ConfigurationError, match="has no 'i_q'"):
        import_map(Source(tmp_path / "few.npz"))
    np.savez(tmp_path / "objects.npz", i_d=np.array([{}]))
    with pytest.raises(ConfigurationError, match="holds objects"):
        import_map(Source(tmp_path / "objects.npz"))
    np.savez(tmp_path / "zero.npz", i_d=I_D, i_q=I_Q, psi_d=np.zeros((15, 25)), psi_q=np.zeros((15, 25)))
    with pytest.raises(ConfigurationError, match="are zero"):
        import_map(Source(tmp_path / "zero.npz"))
    np.savez(tmp_path / "theta.npz", id=I_D, iq=I_Q, psi_d=flux(*grids())[0], psi_q=flux(*grids())[1],
             theta_e_deg=THETA[1:], psi_d_theta=np.ones((15, 25, 12)), psi_q_theta=np.ones((15, 25, 12)))  # fmt: skip
    with pytest.raises(ConfigurationError, match="11 rotor positions for fluxes at 12"):
        import_map(Source(tmp_path / "theta.npz"))
    psi_d, psi_q = flux(*grids())
    savemat(tmp_path / "torque.mat", {"Id": grids()[0], "Iq": grids()[1], "Fd": psi_d, "Fq": psi_q, "T": psi_d[1:]})
    with pytest.raises(ConfigurationError, match="350 torques for 375 fluxes"):
        import_map(Source(tmp_path / "torque.mat"))
    with pytest.raises(ConfigurationError, match="points lie on lines"):
        _import_points(tmp_path / "line.csv", np.outer(np.arange(1.0, 40.0), np.ones(4)))
    with pytest.raises(ConfigurationError, match=r"beyond 1e\+12"):
        _import_points(tmp_path / "large.csv", 1e200 * _point_rows(), scalars={"resistance": 1.0})
    with pytest.raises(ConfigurationError, match="several values at the same currents"):
        _import_points(tmp_path / "twice.csv", np.tile(_point_rows(), (2, 1)))


def test_units_of_headings_and_of_milliweber(tmp_path):
    rows = _point_rows(1e3)
    columns = {"i_d": "i_d [A]", "i_q": "i_q [A]", "psi_d": "psi_d [mWb]", "psi_q": "psi_q [mWb]"}
    found = _import_points(tmp_path / "a.csv", rows, ",".join(columns.values()), columns=columns).flux_map
    np.testing.assert_allclose(found.psi_dq(-7.5, 6.0), flux(-7.5, 6.0), atol=1e-9)
    with pytest.raises(ConfigurationError, match=r"reaches 5\d\d Wb, as if it were in mWb \(then --flux-scale 0.001\)"):
        _import_points(tmp_path / "b.csv", rows)


def test_an_outlier_is_told(tmp_path):
    for change, said in ((None, 0), ((1, 130), 1)):
        warnings = _import_points(tmp_path / "o.csv", _point_rows(change=change)).warnings
        assert len(warnings) == said
    i_d, i_q = (axis.ravel()[130] for axis in grids())
    assert warnings[0].startswith(
        f"The flux linkage at i_d = {i_d:.4g} A, i_q = {i_q:.4g} A, or at a neighbouring point, "
    )


def test_fluxes_that_may_be_in_milliweber_are_told(tmp_path):
    """A machine of 4 mWb: its map could be that of a large machine."""
    largest = np.hypot(*_point_rows()[:, 2:].T).max()
    for milliweber, codes in ((1.9e3, []), (4.0e3, ["import_large_flux"])):
        found = _import_points(tmp_path / "m.csv", _point_rows(1e-3 * milliweber / largest))
        assert [warning.code for warning in found.warnings] == codes


def test_an_outlier_that_makes_a_map_implausible_is_named(tmp_path):
    rows = _point_rows()
    rows[130, 3] -= 20 * np.abs(rows[:, 3]).max()
    place = rf"which is for one point. The flux linkage at i_d = {rows[130, 0]:.4g} A, i_q = {rows[130, 1]:.4g} A"
    with pytest.raises(ConfigurationError, match=place):
        _import_points(tmp_path / "o.csv", rows)


def test_currents_that_differ_by_less_than_numbers_tell_are_refused(tmp_path):
    """As damage leaves them: some differences are so small that their squares vanish."""
    rows = _point_rows()
    rows[:40, 0] = 1e-310 * np.arange(40)
    rows[:40, 1] = 0.0
    with pytest.raises(ConfigurationError, match="not plausible"):
        _import_points(tmp_path / "d.csv", rows)


@pytest.mark.parametrize("axes", [(0,), (1,), (0, 1)])
def test_descending_axes_are_the_same_map(axes, tmp_path):
    names, arrays = ("i_d", "i_q", "psi_d", "psi_q"), (np.arange(-9.0, 10.0), np.arange(-8.0, 9.0))
    psi = flux(*np.meshgrid(*arrays, indexing="ij"))
    turned = [axis[::-1] if k in axes else axis for k, axis in enumerate(arrays)] + [np.flip(x, axes) for x in psi]
    np.savez(tmp_path / "m.npz", **dict(zip(names, turned, strict=True)))
    found = import_map(Source(tmp_path / "m.npz")).flux_map
    assert np.all(np.diff(found.i_d) > 0)
    np.testing.assert_allclose(found.psi_dq(-7.5, 6.0), flux(-7.5, 6.0), atol=1e-3)


@pytest.mark.parametrize("name", ["i_d", "psi_d", "psi_q"])
def test_complex_values_are_refused(name, tmp_path):
    i_d, i_q = np.arange(-9.0, 10.0), np.arange(-8.0, 9.0)
    psi_d, psi_q = flux(*np.meshgrid(i_d, i_q, indexing="ij"))
    arrays = {"i_d": i_d, "i_q": i_q, "psi_d": psi_d, "psi_q": psi_q}
    np.savez(tmp_path / "m.npz", **{**arrays, name: arrays[name] + 1j})
    with pytest.raises(ConfigurationError, match=f"'{name}' in .* is of type complex128: it must hold real numbers"):
        import_map(Source(tmp_path / "m.npz"))


def test_fluxes_over_the_rotor_position_have_one_shape(tmp_path):
    i_d, i_q = np.arange(-4.0, 5.0), np.arange(-4.0, 5.0)
    psi = np.zeros((9, 9, 12))
    np.savez(
        tmp_path / "x.npz", i_d=i_d, i_q=i_q, psi_d=psi[..., 0], psi_q=psi[..., 0], theta_e_deg=np.arange(0, 60, 5.0),
        psi_d_theta=psi, psi_q_theta=psi[..., :-1],
    )  # fmt: skip
    with pytest.raises(ConfigurationError, match=r"psi_d_theta and psi_q_theta in .* have different shapes"):
        import_map(Source(tmp_path / "x.npz"))
