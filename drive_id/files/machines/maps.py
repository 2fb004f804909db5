"""Machine files: flux maps in ``.npz`` files, and in the ``.mat`` files of SyR-e.

An ``.npz`` file holds ``id``, ``iq`` (1-D, A) and ``psi_d``, ``psi_q`` (indexed [id, iq], Wb), optionally
``theta_e_deg`` with ``psi_d_theta``, ``psi_q_theta`` (indexed [id, iq, theta]), and the scalars ``R`` (ohm),
``pole_pairs``, ``i_max`` (A) and ``u_dc`` (V). Values are peak, and the magnet is on +d.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from drive_id.core.fit_settings import MOST_POLE_PAIRS
from drive_id.errors import ConfigurationError
from drive_id.files.inputs.archive import load_npz
from drive_id.files.inputs.input_file import check_input, reason
from drive_id.files.machines.syre import read_syre, sr_to_pm
from drive_id.types import FloatArray, MachineMap

_ARRAYS = ("id", "iq", "psi_d", "psi_q")
_ARRAYS_THETA = ("theta_e_deg", "psi_d_theta", "psi_q_theta")
_NAMES = (*_ARRAYS, *_ARRAYS_THETA, "R", "pole_pairs", "i_max", "u_dc")
_LARGEST = 1 << 28
"""Bytes of a machine file, and of its arrays."""
_DEFAULT_SPEED = 3000.0  # rpm, up to which the default DC-link voltage suffices for i_max


def read_machine(
    path: str | os.PathLike[str], *, pole_pairs: int | None = None, u_dc: float | None = None
) -> MachineMap:
    """Read a machine file: an ``.npz`` file, or a ``.mat`` file of SyR-e (up to MATLAB's version 7).

    Pole pairs and u_dc, V, replace the file's values. Without ``i_max`` in it, the radius of the disc that the map
    covers is used; without ``u_dc``, enough voltage for 3000 rpm.

    The axes of the map increase. A map over i_q >= 0 only is mirrored: psi_d(-i_q, -theta) = psi_d(i_q, theta) and
    psi_q(-i_q, -theta) = -psi_q(i_q, theta).

    Raises ConfigurationError when the file is not a machine file, a value is missing or wrong, or the axes are oriented
    differently.
    """
    path = Path(path)
    try:
        check_input(path, _LARGEST)
    except FileNotFoundError as error:
        raise ConfigurationError(f"There is no machine file '{path}': check the path.") from error
    except (OSError, ValueError) as error:
        why = reason(error) if isinstance(error, OSError) else error
        raise ConfigurationError(f"Machine file '{path}' cannot be read ({why}): check the path.") from error
    if path.suffix.lower() == ".npz":
        values = load_npz(path, f"Machine file '{path}'", _NAMES, largest=_LARGEST)
    elif path.suffix.lower() == ".mat":
        values, axis = read_syre(path)
        values = sr_to_pm(values) if axis == "sr" else values
    else:
        raise ConfigurationError(f"Machine file '{path}' must end in .npz, or .mat for one of SyR-e.")
    given = {"pole_pairs": pole_pairs, "u_dc": u_dc}
    values |= {key: np.asarray(value) for key, value in given.items() if value is not None}
    return _build(path, values)


def _build(path: Path, values: dict[str, Any]) -> MachineMap:
    missing = [key for key in _ARRAYS if key not in values]
    if any(key in values for key in _ARRAYS_THETA):
        missing += [key for key in _ARRAYS_THETA if key not in values]
    missing += [key for key in ("R", "pole_pairs") if key not in values]
    if missing:
        raise ConfigurationError(f"Machine file '{path}' lacks '{missing[0]}': add it to the file.")
    arrays = {key: _array(path, key, values[key]) for key in (*_ARRAYS, *_ARRAYS_THETA) if key in values}
    _check_shapes(path, arrays)
    arrays = _ascending(arrays)
    _check_orientation(path, arrays)
    arrays = _mirrored(path, arrays)
    scalars = {key: _scalar(path, key, values[key]) for key in ("R", "pole_pairs", "i_max", "u_dc") if key in values}
    if scalars["pole_pairs"] not in range(1, MOST_POLE_PAIRS + 1):
        raise ConfigurationError(
            f"'pole_pairs' in machine file '{path}' is {scalars['pole_pairs']}: give a whole number."
        )
    i_d, i_q = arrays["id"], arrays["iq"]
    reach = float(min(-i_d[0], i_d[-1], -i_q[0], i_q[-1]))
    largest = float(np.hypot(arrays["psi_d"], arrays["psi_q"]).max())
    enough = float(np.sqrt(3) * largest * _DEFAULT_SPEED * np.pi / 30 * scalars["pole_pairs"])
    return MachineMap(
        name=path.stem,
        i_d=i_d,
        i_q=i_q,
        psi_d=arrays["psi_d"],
        psi_q=arrays["psi_q"],
        resistance=scalars["R"],
        pole_pairs=int(scalars["pole_pairs"]),
        i_max=scalars.get("i_max", reach),
        u_dc=scalars.get("u_dc", enough),
        theta=np.radians(arrays["theta_e_deg"]) if "theta_e_deg" in arrays else None,
        psi_d_theta=arrays.get("psi_d_theta"),
        psi_q_theta=arrays.get("psi_q_theta"),
    )


def _array(path: Path, key: str, value: Any) -> FloatArray:
    found = np.asarray(value)
    if found.dtype.kind not in "fiu":
        raise ConfigurationError(f"'{key}' in machine file '{path}' is of type {found.dtype}: give real numbers.")
    return found.astype(np.float64, copy=False)


def _scalar(path: Path, key: str, value: Any) -> float:
    found = _array(path, key, value)
    if found.size != 1:
        raise ConfigurationError(f"'{key}' in machine file '{path}' has shape {found.shape}: give one number.")
    return float(found.reshape(()))


def _check_shapes(path: Path, arrays: dict[str, FloatArray]) -> None:
    for key in ("id", "iq", "theta_e_deg"):
        axis = arrays.get(key)
        if axis is None:
            continue
        ordered = axis.ndim == 1 and len(axis) > 1 and np.isfinite(axis).all()
        if not ordered or not (np.all(axis[1:] > axis[:-1]) or np.all(axis[1:] < axis[:-1])):
            raise ConfigurationError(
                f"Axis '{key}' in machine file '{path}' must be 1-D and sorted without repetition."
            )
    expected: tuple[int, ...] = (len(arrays["id"]), len(arrays["iq"]))
    for key in ("psi_d", "psi_q", "psi_d_theta", "psi_q_theta"):
        if key not in arrays:
            continue
        shape = (*expected, len(arrays["theta_e_deg"])) if key.endswith("theta") else expected
        if arrays[key].shape != shape:
            raise ConfigurationError(
                f"'{key}' in machine file '{path}' has shape {arrays[key].shape} where the axes need {shape}: "
                "index it [id, iq] or [id, iq, theta]."
            )
        if not np.isfinite(arrays[key]).all():
            raise ConfigurationError(f"'{key}' in machine file '{path}' holds NaN or infinite values: fill the map.")


def _ascending(arrays: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Reverse descending axes together with their direction of the maps."""
    for key, axis in (("id", 0), ("iq", 1), ("theta_e_deg", 2)):
        if key not in arrays or arrays[key][0] < arrays[key][-1]:
            continue
        flipped = {name: np.flip(values, axis) for name, values in arrays.items() if values.ndim > max(axis, 1)}
        arrays = arrays | flipped | {key: arrays[key][::-1]}
    return arrays


def _check_orientation(path: Path, arrays: dict[str, FloatArray]) -> None:
    """Check that flux rises with the current of its axis nearly everywhere, and that the magnet is on +d."""
    psi_d, psi_q = arrays["psi_d"], arrays["psi_q"]

    def rising(d: FloatArray, q: FloatArray) -> bool:
        return float(min(np.mean(np.diff(d, axis=0) > 0), np.mean(np.diff(q, axis=1) > 0))) > 0.9

    if not rising(psi_d, psi_q):
        hint = (
            "transpose psi_d and psi_q to [id, iq]" if rising(psi_d.T, psi_q.T) else "check signs and order of the axes"
        )
        raise ConfigurationError(f"In machine file '{path}' flux does not rise with the current of its axis: {hint}.")
    i_d, i_q = arrays["id"], arrays["iq"]
    zero = (min(max(0.0, i_d[0]), i_d[-1]), min(max(0.0, i_q[0]), i_q[-1]))
    at_zero = [[np.interp(zero[1], i_q, line) for line in psi] for psi in (psi_d, psi_q)]
    magnet_d, magnet_q = (float(np.interp(zero[0], i_d, line)) for line in at_zero)
    slack = 0.02 * float(np.hypot(psi_d, psi_q).max())
    if magnet_d < -slack or abs(magnet_q) > max(slack, abs(magnet_d)):
        raise ConfigurationError(
            f"In machine file '{path}' the flux at zero current is ({magnet_d:.3g}, {magnet_q:.3g}) Wb: turn the axes "
            "so that the magnet is on +d."
        )


def _mirrored(path: Path, arrays: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Complete a map over i_q >= 0 by the mirror symmetry about the d axis."""
    i_q = arrays["iq"]
    if abs(i_q[0]) > 1e-9 * i_q[-1]:
        return arrays
    whole = arrays | {"iq": np.concatenate((-i_q[:0:-1], i_q))}
    back: Any = slice(None)
    if "theta_e_deg" in arrays:
        theta = arrays["theta_e_deg"]
        shift = 2 * theta[0] / (theta[1] - theta[0])
        if abs(shift - round(shift)) > 1e-6:
            raise ConfigurationError(
                f"Machine file '{path}' covers i_q >= 0 only, at angles that are not symmetric about 0: add i_q < 0."
            )
        back = (-round(shift) - np.arange(len(theta))) % len(theta)
    for key, sign in (("psi_d", 1.0), ("psi_q", -1.0)):
        whole[key] = np.concatenate((sign * arrays[key][:, :0:-1], arrays[key]), axis=1)
        if "theta_e_deg" in arrays:
            values = arrays[f"{key}_theta"]
            whole[f"{key}_theta"] = np.concatenate((sign * values[:, :0:-1, back], values), axis=1)
    return whole
