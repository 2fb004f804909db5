"""Maps in ``.npz`` files: our machine files, the ``flux_map.npz`` of our results, and those of motulator."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drive_id.common.origins import ORIGINS
from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.points import SCALARS, MapPoints, of_grid
from drive_id.exchange.imports.source import Source
from drive_id.files.inputs.archive import load_npz
from drive_id.types import FloatArray

_SCALARS = {
    "R": "resistance", "R_s": "resistance", "resistance": "resistance", "pole_pairs": "pole_pairs", "n_p": "pole_pairs",
    "i_max": "i_max", "u_dc": "u_dc",
}  # fmt: skip


def read_npz(source: Source) -> MapPoints:
    """Read a map from an ``.npz`` file."""
    values = load_npz(source.path, f"'{source.path}'")
    scalars = known_scalars({name: values[key] for key, name in _SCALARS.items() if key in values}, source.scalars)
    machine = str(values["machine"]) if "machine" in values else ""
    if "i_s_dq" in values and "psi_s_dq" in values:
        return _of_motulator(source.path, values, scalars, machine)
    own = ORIGINS.get(str(values.get("method", "")))
    if own and not own.turning:
        raise ConfigurationError(
            f"'{source.path}' is of a locked rotor, without the magnets' flux: import the map of a turning machine."
        )
    axes = ("i_d", "i_q") if "i_d" in values else ("id", "iq")
    missing = [name for name in (*axes, "psi_d", "psi_q") if name not in values]
    if missing:
        raise ConfigurationError(
            f"'{source.path}' has no '{missing[0]}' (it has {', '.join(sorted(values)) or 'nothing'}): it must hold "
            "i_d, i_q, psi_d and psi_q, or i_s_dq and psi_s_dq as motulator does."
        )
    i_d, i_q = (real(source.path, name, values[name]).ravel() for name in axes)
    shape = (len(i_d), len(i_q))

    def array(name: str) -> FloatArray:
        return ordered(source, real(source.path, name, values[name]), name, *shape)

    turning = "theta_e_deg" in values and "psi_d_theta" in values and "psi_q_theta" in values
    names = ("psi_d_theta", "psi_q_theta") if turning else ("psi_d", "psi_q")
    theta = np.radians(real(source.path, "theta_e_deg", values["theta_e_deg"])) if turning else None
    psi = [array(name) for name in names]
    if psi[0].shape != psi[1].shape:
        raise ConfigurationError(f"{' and '.join(names)} in '{source.path}' have different shapes: export it again.")
    i_dq, psi_dq = of_grid(i_d, i_q, *psi)
    torque = next((array(name) for name in ("torque_theta", "torque") if name in values), None)
    if torque is not None:
        torque = (torque.mean(axis=2) if torque.ndim == 3 else torque).ravel()
    sigma = None
    if "sigma_d" in values and "sigma_q" in values:
        sigma = np.stack([array("sigma_d"), array("sigma_q")], axis=-1).reshape(-1, 2)
    if "inside" in values:
        psi_dq = np.where(array("inside").ravel()[:, None, None] > 0, psi_dq, np.nan)
    return MapPoints(i_dq, psi_dq, theta, torque, sigma, scalars, shape=shape, machine=machine).complete()


def ordered(source: Source, values: FloatArray, name: str, count_d: int, count_q: int) -> FloatArray:
    """Return an array indexed [i_d, i_q, ...] from one with the source's index order.

    Raises ConfigurationError when its shape does not fit the axes.
    """
    turned = np.swapaxes(values, 0, 1) if source.conventions.order == "qd" and values.ndim >= 2 else values
    if turned.ndim not in (2, 3) or turned.shape[:2] != (count_d, count_q):
        hint = f"its axes need {(count_d, count_q)} in the order {source.conventions.order}"
        other = "qd" if source.conventions.order == "dq" else "dq"
        if values.ndim >= 2 and np.swapaxes(turned, 0, 1).shape[:2] == (count_d, count_q):
            hint += f", and would fit with --order {other}"
        raise ConfigurationError(f"'{name}' in '{source.path}' has shape {values.shape}: {hint}.")
    return np.asarray(turned, np.float64)


def known_scalars(found: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, float]:
    """Return the machine's scalars that are positive numbers: those given, else those found in the file."""
    scalars = {}
    for name in SCALARS:
        value = np.asarray(given.get(name, found.get(name, np.nan)))
        if value.size == 1 and value.dtype.kind in "fiu" and np.isfinite(value).all() and float(value.reshape(())) > 0:
            scalars[name] = float(value.reshape(()))
    return scalars


def real(path: Path, name: str, value: Any) -> FloatArray:
    """Return an array of real numbers; raises ConfigurationError when it is none."""
    found = np.asarray(value)
    if found.dtype.kind not in "fiub":
        raise ConfigurationError(f"'{name}' in '{path}' is of type {found.dtype}: it must hold real numbers.")
    return found.astype(np.float64)


def _of_motulator(path: Path, values: Mapping[str, Any], scalars: Mapping[str, float], machine: str) -> MapPoints:
    """Read complex maps; with ``theta_m``, one entry for each current and rotor position."""
    current, psi = (np.asarray(values[name]).ravel() for name in ("i_s_dq", "psi_s_dq"))
    if current.dtype.kind != "c" or psi.dtype.kind != "c" or current.shape != psi.shape:
        raise ConfigurationError(f"i_s_dq and psi_s_dq in '{path}' must be complex arrays of equal shape.")
    i_dq, psi_dq = (np.stack([x.real, x.imag], axis=-1) for x in (current, psi))
    torque: FloatArray | None = None
    if "tau_m" in values and "pole_pairs" in scalars:
        torque = scalars["pole_pairs"] * real(path, "tau_m", values["tau_m"]).ravel()  # it is per pole pair
    elif "tau" in values:
        torque = real(path, "tau", values["tau"]).ravel()
    if torque is not None and torque.shape != current.shape:
        raise ConfigurationError(f"The torque in '{path}' has {torque.size} values for {current.size} points.")
    if "theta_m" in values:
        theta = real(path, "theta_m", values["theta_m"]).ravel()
        return turning_points(path, i_dq, psi_dq, theta, torque, scalars, machine)
    return MapPoints(i_dq, psi_dq[..., None], torque=torque, scalars=scalars, machine=machine).complete()


def turning_points(
    path: Path,
    i_dq: FloatArray,
    psi_dq: FloatArray,
    theta: FloatArray,
    torque: FloatArray | None,
    scalars: Mapping[str, float],
    machine: str = "",
) -> MapPoints:
    """Group entries (N), one for each current and rotor position, by current.

    Raises ConfigurationError when rotor positions are missing at some currents.
    """
    if theta.shape != i_dq.shape[:1]:
        raise ConfigurationError(f"The rotor positions in '{path}' are {theta.size} for {len(i_dq)} points.")
    known = ~np.isnan(psi_dq).any(axis=1)
    i_dq, psi_dq, theta, torque = i_dq[known], psi_dq[known], theta[known], None if torque is None else torque[known]
    places, which = np.unique(np.round(i_dq / np.ptp(i_dq, axis=0), 9), axis=0, return_inverse=True)
    angles, position = np.unique(np.round(theta, 9), return_inverse=True)
    shape = (len(places), len(angles))
    seen = np.zeros(shape, np.int64)
    np.add.at(seen, (which.ravel(), position), 1)
    if not (seen == 1).all():
        raise ConfigurationError(
            f"'{path}' does not hold each current exactly once at each of its {len(angles)} rotor positions: complete "
            "it."
        )

    def grouped(values: FloatArray) -> FloatArray:
        out = np.empty((*shape, *values.shape[1:]))
        out[which.ravel(), position] = values
        return out

    psi, angles = _without_end(np.swapaxes(grouped(psi_dq), 1, 2), angles)
    mean = None if torque is None else grouped(torque).mean(axis=1)
    return MapPoints(grouped(i_dq)[:, 0], psi, angles, mean, scalars=scalars, machine=machine).complete()


def _without_end(psi: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Leave out a last angle that repeats the first."""
    scale = float(np.abs(psi).max())
    repeats = len(theta) > 3 and np.abs(psi[..., -1] - psi[..., 0]).max() <= 1e-6 * scale
    varies = np.ptp(psi, axis=-1).max() > 1e-4 * scale
    return (psi[..., :-1], theta[:-1]) if repeats and varies else (psi, theta)
