"""Machine files: what they hold, both conventions of SyR-e's axes, and each bad file with its sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from drive_id.errors import ConfigurationError
from drive_id.files.machines.maps import read_machine

I_D = np.linspace(-10.0, 8.0, 10)
I_Q = np.linspace(-9.0, 9.0, 13)
THETA = np.arange(0.0, 60.0, 7.5)


def flux(i_d: np.ndarray, i_q: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fluxes in our convention: the magnet on +d, mirror-symmetric, with a sixth harmonic."""
    s = np.sqrt(1 + (i_d / 20) ** 2 + (i_q / 6) ** 2)
    c = np.cos(6 * np.radians(theta))
    return 0.1 + 0.01 * i_d / s * (1 + 0.03 * c), 0.05 * i_q / s * (1 + 0.03 * c)


def contract(turning: bool = True) -> dict[str, Any]:
    psi_d, psi_q = flux(I_D[:, None, None], I_Q[None, :, None], THETA)
    values: dict[str, Any] = {"id": I_D, "iq": I_Q, "psi_d": psi_d.mean(axis=2), "psi_q": psi_q.mean(axis=2)}
    if turning:
        values |= {"theta_e_deg": THETA, "psi_d_theta": psi_d, "psi_q_theta": psi_q}
    return values | {"R": 0.2, "pole_pairs": 2, "i_max": 7.0, "u_dc": 300.0}


def write(path: Path, values: dict[str, Any]) -> Path:
    np.savez(path, **values)
    return path


def refused(message: str, path: Path) -> None:
    with pytest.raises(ConfigurationError, match=message):
        read_machine(path)


@pytest.mark.parametrize("turning", [False, True])
def test_all_values_are_read(tmp_path, turning):
    first = read_machine(write(tmp_path / "mine.npz", contract(turning)))
    assert (first.name, first.resistance, first.pole_pairs, first.i_max, first.u_dc) == ("mine", 0.2, 2, 7.0, 300.0)
    assert (first.theta is not None) == turning
    names = {"i_d": "id", "i_q": "iq", "psi_d": "psi_d", "psi_q": "psi_q"}
    names |= {name: name for name in ("psi_d_theta", "psi_q_theta")} if turning else {}
    for name, key in names.items():
        np.testing.assert_array_equal(getattr(first, name), contract(turning)[key])
    if turning:
        np.testing.assert_allclose(first.theta, np.radians(THETA), atol=1e-15)


def test_descending_axes_are_turned_round(tmp_path):
    values = contract()
    for key in ("psi_d", "psi_q", "psi_d_theta", "psi_q_theta"):
        values[key] = values[key][::-1, ::-1]
    for key in ("psi_d_theta", "psi_q_theta"):
        values[key] = values[key][..., ::-1]
    values |= {"id": I_D[::-1], "iq": I_Q[::-1], "theta_e_deg": THETA[::-1]}
    turned = read_machine(write(tmp_path / "turned.npz", values))
    plain = read_machine(write(tmp_path / "plain.npz", contract()))
    for name in ("i_d", "i_q", "theta", "psi_d", "psi_q", "psi_d_theta", "psi_q_theta"):
        np.testing.assert_array_equal(getattr(turned, name), getattr(plain, name))


def test_half_a_map_is_mirrored(tmp_path):
    values = contract()
    for key in ("psi_d", "psi_q", "psi_d_theta", "psi_q_theta"):
        values[key] = values[key][:, 6:]
    half = read_machine(write(tmp_path / "half.npz", values | {"iq": I_Q[6:]}))
    whole = read_machine(write(tmp_path / "whole.npz", contract()))
    for name in ("i_q", "psi_d", "psi_q", "psi_d_theta", "psi_q_theta"):
        np.testing.assert_allclose(getattr(half, name), getattr(whole, name), atol=1e-15)
    shifted = values | {"iq": I_Q[6:], "theta_e_deg": THETA + 1.0}
    refused("at angles that are not symmetric about 0: add i_q < 0", write(tmp_path / "shifted.npz", shifted))


def test_missing_scalars(tmp_path):
    values = contract(turning=False)
    del values["i_max"], values["u_dc"]
    found = read_machine(write(tmp_path / "few.npz", values))
    assert found.i_max == 8.0
    assert found.u_dc == pytest.approx(np.sqrt(3) * np.hypot(found.psi_d, found.psi_q).max() * 200 * np.pi)
    given = read_machine(tmp_path / "few.npz", pole_pairs=3, u_dc=100.0)
    assert (given.pole_pairs, given.u_dc) == (3, 100.0)
    del values["R"]
    refused("lacks 'R'", write(tmp_path / "fewer.npz", values))


def altered(**changes: Any) -> dict[str, Any]:
    values = contract() | changes
    return {key: value for key, value in values.items() if value is not None}


def with_nan(key: str) -> np.ndarray:
    values = contract()[key].copy()
    values.flat[3] = np.nan
    return values


def infinite(axis: np.ndarray) -> np.ndarray:
    """Return an axis whose first difference is not a number, which numpy would warn of."""
    return np.concatenate([[-np.inf, -np.inf], axis[2:]])


PLAIN = contract()

BAD = {
    "no axis": (altered(iq=None), "lacks 'iq'"),
    "no flux": (altered(psi_q=None), "lacks 'psi_q'"),
    "half a theta map": (altered(psi_q_theta=None), "lacks 'psi_q_theta'"),
    "no pole pairs": (altered(pole_pairs=None), "lacks 'pole_pairs'"),
    "half a pole pair": (altered(pole_pairs=2.5), "'pole_pairs' in machine file .* is 2.5: give a whole number"),
    "two resistances": (altered(R=[0.1, 0.2]), r"'R' in machine file .* has shape \(2,\): give one number"),
    "negative resistance": (altered(R=-1.0), "resistance of machine .* is -1.0"),
    "no voltage": (altered(u_dc=0.0), "u_dc of machine .* is 0.0: it must be positive"),
    "text": (altered(R="much"), "'R' in machine file .* is of type <U4"),
    "complex": (altered(psi_d=PLAIN["psi_d"] + 1j), "'psi_d' in machine file .* is of type complex128"),
    "nan": (altered(psi_d=with_nan("psi_d")), "'psi_d' in machine file .* holds NaN or infinite values"),
    "nan over theta": (altered(psi_q_theta=with_nan("psi_q_theta")), "'psi_q_theta' in machine file .* holds NaN"),
    "unsorted": (altered(id=np.roll(I_D, 1)), "Axis 'id' in machine file .* must be 1-D and sorted"),
    "nan on an axis": (
        altered(iq=np.where(I_Q == 0, np.nan, I_Q)),
        "Axis 'iq' in machine file .* must be 1-D and sorted",
    ),
    "infinite on axis d": (altered(id=infinite(I_D)), "Axis 'id' in machine file .* must be 1-D and sorted"),
    "infinite on axis q": (altered(iq=infinite(I_Q)), "Axis 'iq' in machine file .* must be 1-D and sorted"),
    "infinite angles": (altered(theta_e_deg=infinite(THETA)), "Axis 'theta_e_deg' in machine file .* must be 1-D and"),
    "grid for an axis": (altered(id=np.tile(I_D, (13, 1))), "Axis 'id' in machine file .* must be 1-D and sorted"),
    "transposed": (altered(psi_d=PLAIN["psi_d"].T), r"has shape \(13, 10\) where the axes need \(10, 13\)"),
    "upside down": (altered(psi_d=-PLAIN["psi_d"], psi_q=-PLAIN["psi_q"]), "flux does not rise .* check signs"),
    "magnet on -d": (altered(psi_d=PLAIN["psi_d"] - 0.2), "the flux at zero current is .* magnet is on \\+d"),
    "magnet on q": (altered(psi_q=PLAIN["psi_q"] + 0.3), "the flux at zero current is .* magnet is on \\+d"),
    "small": (
        {
            "id": I_D[4:7],
            "iq": I_Q,
            "psi_d": PLAIN["psi_d"][4:7],
            "psi_q": PLAIN["psi_q"][4:7],
            "R": 1.0,
            "pole_pairs": 2,
        },
        "at least 4 x 4 points",
    ),
}


@pytest.mark.parametrize("case", list(BAD))
def test_bad_values(tmp_path, case):
    values, message = BAD[case]
    refused(message, write(tmp_path / "bad.npz", values))


def test_square_transposed_map_is_recognised(tmp_path):
    axis = np.linspace(-9, 9, 10)
    psi_d, psi_q = flux(axis[:, None], axis[None, :], np.array(15.0))
    values = {"id": axis, "iq": axis, "psi_d": psi_d.T, "psi_q": psi_q.T, "R": 1.0, "pole_pairs": 2}
    refused(r"transpose psi_d and psi_q to \[id, iq\]", write(tmp_path / "bad.npz", values))


def test_bad_files(tmp_path):
    refused(r"There is no machine file .*: check the path", tmp_path / "absent.npz")
    (tmp_path / "map.csv").write_text("1,2\n")
    refused(r"must end in \.npz, or \.mat", tmp_path / "map.csv")
    whole = write(tmp_path / "whole.npz", contract()).read_bytes()
    for content in (b"", b"no archive", whole[: len(whole) // 2], whole[:60] + b"\xff" * 40 + whole[100:]):
        (tmp_path / "damaged.npz").write_bytes(content)
        refused(r"is damaged, not an \.npz archive, or holds objects", tmp_path / "damaged.npz")
    np.savez(tmp_path / "objects.npz", **(contract() | {"id": np.array([{}, None], dtype=object)}))
    refused(r"is damaged, not an \.npz archive, or holds objects", tmp_path / "objects.npz")
    np.save(tmp_path / "array.npy", I_D)
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    refused(r"is damaged, not an \.npz archive", tmp_path / "array.npz")


def in_axes(kind: str, i_d: np.ndarray, i_q: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Look at the same machine in SyR-e's axes: in 'SR' d leads the magnet axis by 90 degrees."""
    if kind == "PM":
        return flux(i_d, i_q, theta)
    psi_d, psi_q = flux(-i_q, i_d, theta - 90)
    return psi_q, -psi_d


def syre(kind: str, flat: bool = True, turning: bool = True, **data: Any) -> dict[str, Any]:
    i_d, i_q = (I_D, I_Q) if kind == "PM" else (I_Q, -I_D[::-1])
    model: dict[str, Any] = {
        "data": {"axisType": kind, "Rs": 0.2, "p": 2.0, "Imax": 7.0, "Vdc": 300.0, "motorName": "x"} | data,
        "FluxMap_dq": [],
        "FluxMap_dqt": [],
    }
    fine = np.arange(0.0, 360.0, 7.5)
    if flat:
        grid_d, grid_q = np.meshgrid(i_d, i_q)
        psi = [x.mean(axis=2) for x in in_axes(kind, grid_d[..., None], grid_q[..., None], fine)]
        model["FluxMap_dq"] = {"Id": grid_d, "Iq": grid_q, "Fd": psi[0], "Fq": psi[1], "T": np.zeros_like(grid_d)}
    if turning:
        psi = list(in_axes(kind, i_d[:, None, None], i_q[None, :, None], fine))
        model["FluxMap_dqt"] = {"Id": i_d, "Iq": i_q, "th": fine, "data": {"Fd": psi[0], "Fq": psi[1]}}
    return {"motorModel": model}


@pytest.mark.cases
@pytest.mark.parametrize("kind", ["SR", "PM"])
@pytest.mark.parametrize("turning", [False, True])
def test_syre(tmp_path, kind, turning):
    savemat(tmp_path / "motor.mat", syre(kind, turning=turning), oned_as="row")
    found = read_machine(tmp_path / "motor.mat")
    expected = contract()
    np.testing.assert_allclose(found.i_d, I_D, atol=1e-14)
    np.testing.assert_allclose(found.i_q, I_Q, atol=1e-14)
    np.testing.assert_allclose(found.psi_d, expected["psi_d"], atol=1e-14)
    np.testing.assert_allclose(found.psi_q, expected["psi_q"], atol=1e-14)
    assert (found.name, found.resistance, found.pole_pairs, found.i_max, found.u_dc) == ("motor", 0.2, 2, 7.0, 300.0)
    assert (found.theta is not None) == turning
    if turning:
        psi_d, psi_q = flux(I_D[:, None, None], I_Q[None, :, None], np.degrees(found.theta))
        np.testing.assert_allclose(found.psi_d_theta, psi_d, atol=1e-14)
        np.testing.assert_allclose(found.psi_q_theta, psi_q, atol=1e-14)


def test_syre_keeps_the_fluxes_of_the_phases(tmp_path):
    """Phase a of the same machine, computed in SyR-e's own 'SR' axes and in ours."""
    savemat(tmp_path / "motor.mat", syre("SR"), oned_as="row")
    found = read_machine(tmp_path / "motor.mat")
    theta_sr = np.arange(0.0, 360.0, 7.5)
    f_d, f_q = in_axes("SR", np.array(I_Q[9]), np.array(-I_D[2]), theta_sr)
    phase_a = f_d * np.cos(np.radians(theta_sr)) - f_q * np.sin(np.radians(theta_sr))
    ours = found.psi_d_theta[2, 9] * np.cos(found.theta) - found.psi_q_theta[2, 9] * np.sin(found.theta)
    np.testing.assert_allclose(ours, phase_a, atol=1e-14)


def test_syre_without_ratings_and_with_a_closed_period(tmp_path):
    content = syre("PM", Imax=0.0, Vdc=np.nan)
    turning = content["motorModel"]["FluxMap_dqt"]
    turning["th"] = np.append(turning["th"], 360.0)
    turning["data"] = {key: np.concatenate((x, x[..., :1]), axis=2) for key, x in turning["data"].items()}
    savemat(tmp_path / "motor.mat", content, oned_as="row")
    found = read_machine(tmp_path / "motor.mat")
    assert found.i_max == 8.0
    assert found.u_dc > 0
    assert len(found.theta) == 48


@pytest.mark.cases
@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"other": 1.0}, "holds no motorModel with data and FluxMap_dq or FluxMap_dqt"),
        (syre("PM", flat=False, turning=False), "holds no motorModel with data and FluxMap_dq or FluxMap_dqt"),
        (syre("PM", Rs=0.0), "lacks 'R'"),
        ({"motorModel": {"data": {"p": 2.0}, "FluxMap_dq": {"Id": I_D}}}, "lacks a field or has a wrong shape"),
        (
            {"motorModel": {"data": {"p": 2.0}, "FluxMap_dq": dict.fromkeys(("Id", "Iq", "Fd", "Fq"), np.eye(5))}},
            r"FluxMap_dq is not a grid indexed \[iq, id\]",
        ),
    ],
)
def test_bad_syre_contents(tmp_path, content, message):
    savemat(tmp_path / "motor.mat", content, oned_as="row")
    refused(message, tmp_path / "motor.mat")


def test_bad_syre_files(tmp_path):
    (tmp_path / "motor.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124, b" ") + b"\x00\x02IM" + b"\x00" * 64)
    refused(r"has MATLAB's version 7\.3: save it with '-v7'", tmp_path / "motor.mat")
    savemat(tmp_path / "whole.mat", syre("PM"))
    whole = (tmp_path / "whole.mat").read_bytes()
    for content in (b"", b"text", whole[: len(whole) // 2]):
        (tmp_path / "motor.mat").write_bytes(content)
        refused("is damaged or not a MATLAB file", tmp_path / "motor.mat")
