"""Flux maps in the ``.mat`` files of SyR-e (https://github.com/SyR-e/syre_public).

They are in the struct ``motorModel``: ``FluxMap_dq`` is indexed [iq, id] and ``FluxMap_dqt`` [id, iq, theta]. With
``axisType`` 'PM', as in our convention, d is the magnet axis; with 'SR' it is the axis of largest permeance, 90 degrees
ahead. Equal phase fluxes require i_pm = J i_sr, psi_pm = J psi_sr and theta_pm = theta_sr - 90 degrees.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.files.inputs.matlab import load_matlab

_OVER_THETA = ("theta_e_deg", "psi_d_theta", "psi_q_theta")


def read_syre(path: Path) -> tuple[dict[str, Any], str]:
    """Read the flux map of a SyR-e file: the map over rotor position if there is one, else the averaged map.

    Returns the values under the names of our ``.npz`` files, in the axes of the file and indexed [id, iq, theta], and
    the axis type, ``pm`` or ``sr``, see :func:`sr_to_pm`. Raises ConfigurationError when the file is not a SyR-e file,
    up to MATLAB's version 7, with a flux map.
    """
    model = load_matlab(path, f"Machine file '{path}'", ["motorModel"]).get("motorModel")
    data = getattr(model, "data", None)
    flat, turning = getattr(model, "FluxMap_dq", None), getattr(model, "FluxMap_dqt", None)
    if data is None or not (hasattr(flat, "Id") or hasattr(turning, "th")):
        raise ConfigurationError(
            f"Machine file '{path}' holds no motorModel with data and FluxMap_dq or FluxMap_dqt: save it from "
            "SyR-e's MMM."
        )
    try:
        values = _syre_turning(turning) if hasattr(turning, "th") else _syre_flat(flat)
    except (AttributeError, IndexError, ValueError, TypeError) as error:
        raise ConfigurationError(
            f"A flux map in machine file '{path}' lacks a field or has a wrong shape: {error}."
        ) from error
    for key, field in (("R", "Rs"), ("pole_pairs", "p"), ("i_max", "Imax"), ("u_dc", "Vdc")):
        value = np.asarray(getattr(data, field, np.nan))
        if value.size == 1 and value.dtype.kind in "fiu" and float(value) > 0:
            values[key] = value
    return values, str(getattr(data, "axisType", "SR")).lower()


def _syre_flat(flat: Any) -> dict[str, Any]:
    """Return the averaged map, transposed from [iq, id] to [id, iq]."""
    i_d, i_q = (np.atleast_2d(np.asarray(x, np.float64)) for x in (flat.Id, flat.Iq))
    psi_d, psi_q = np.asarray(flat.Fd, np.float64), np.asarray(flat.Fq, np.float64)
    if not (
        np.ptp(i_d, axis=0).max() == 0 and np.ptp(i_q, axis=1).max() == 0 and psi_d.shape == psi_q.shape == i_d.shape
    ):
        raise ValueError("FluxMap_dq is not a grid indexed [iq, id]")
    return {"id": i_d[0], "iq": i_q[:, 0], "psi_d": psi_d.T, "psi_q": psi_q.T}


def _syre_turning(turning: Any) -> dict[str, Any]:
    """Return the map over rotor position, without a repeated end point."""
    values = {
        "id": np.asarray(turning.Id, np.float64),
        "iq": np.asarray(turning.Iq, np.float64),
        "theta_e_deg": np.asarray(turning.th, np.float64),
        "psi_d_theta": np.asarray(turning.data.Fd, np.float64),
        "psi_q_theta": np.asarray(turning.data.Fq, np.float64),
    }
    theta = values["theta_e_deg"]
    if theta[-1] - theta[0] > 360 - 1e-6:
        values |= {key: values[key][..., :-1] for key in _OVER_THETA}
    values |= {key: values[f"{key}_theta"].mean(axis=-1) for key in ("psi_d", "psi_q")}
    return values


def sr_to_pm(values: dict[str, Any]) -> dict[str, Any]:
    """Turn the axes by 90 degrees, i_pm = J i_sr: i_d = -i_q^sr, i_q = i_d^sr, and the fluxes alike."""
    turned = {"id": -values["iq"][::-1], "iq": values["id"]}
    for suffix in ("", "_theta"):
        if f"psi_d{suffix}" in values:
            turned[f"psi_d{suffix}"] = -np.swapaxes(values[f"psi_q{suffix}"], 0, 1)[::-1]
            turned[f"psi_q{suffix}"] = np.swapaxes(values[f"psi_d{suffix}"], 0, 1)[::-1]
    if "theta_e_deg" in values:
        turned["theta_e_deg"] = values["theta_e_deg"] - 90.0
    return values | turned
