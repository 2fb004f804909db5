"""Files for SyR-e: the flux file and the motor model. Maps are indexed [iq, id], as by MATLAB's ``meshgrid``."""

from __future__ import annotations

from typing import Any

import numpy as np

from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.exchange.exports.writers.archives import mat_bytes
from drive_id.exchange.exports.writers.powertrain import inverse_maps
from drive_id.types import FloatArray

_TEMPERATURE = 20.0


def write_flux(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write ``Id Iq Fd Fq T dT dTpp`` with ``per.tempPP`` and ``dataSet``; the axis type is 'PM'."""
    theta = _angles(table)
    more = {
        "per": {"tempPP": _TEMPERATURE},
        "dataSet": {"axisType": "PM", "NumOfRotPosPP": float(len(theta)), "AngularSpanPP": 360.0},
    }
    return mat_bytes(_flux_map(table, theta) | more)


def write_model(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write the struct ``motorModel`` with maps of flux, incremental inductance and, inverse, of current."""
    machine, theta = table.machine, _angles(table)
    data = {
        "motorName": table.result.machine or "drive_id",
        "pathname": "",
        "motorType": "PM",
        "axisType": "PM",
        "Rs": table.known_resistance(),
        "p": float(machine.known_pole_pairs()),
        "Imax": machine.i_max,
        "i0": machine.i_max,
        "Vdc": np.nan if machine.u_dc is None else machine.u_dc,
        "nmax": np.nan,
        "J": np.nan,
        "tempCu": _TEMPERATURE,
        "tempPM": _TEMPERATURE,
        "n3phase": 1.0,
    }
    i_d, i_q = np.meshgrid(table.i_d, table.i_q)
    L = table.inductances
    psi_d, psi_q, current_d, current_q = inverse_maps(table)
    flux_d, flux_q = np.meshgrid(psi_d, psi_q)
    model: dict[str, Any] = {
        "data": data,
        "FluxMap_dq": _flux_map(table, theta),
        "IncInductanceMap_dq": {
            "Id": i_d,
            "Iq": i_q,
            **{f"L{a}{b}": L[..., j, k].T for j, a in enumerate("dq") for k, b in enumerate("dq")},
        },
        "FluxMapInv_dq": {"Fd": flux_d, "Fq": flux_q, "Id": current_d.T, "Iq": current_q.T},
    }
    if table.harmonics:
        over = np.append(theta, 2 * np.pi)
        fluxes = dict(zip(("Fd", "Fq"), table.psi_theta(over), strict=True))
        grid = np.meshgrid(table.i_d, table.i_q, np.degrees(over), indexing="ij")
        turning = dict(zip(("Id", "Iq", "th"), grid, strict=True)) | fluxes | {"T": table.torque_theta(over)}
        axes = {"Id": table.i_d, "Iq": table.i_q, "th": np.degrees(over)}
        model["FluxMap_dqt"] = axes | {"data": turning}
    return mat_bytes({"motorModel": model})


def _angles(table: MapTable) -> FloatArray:
    return table.angles(2 * np.pi)


def _flux_map(table: MapTable, theta: FloatArray) -> dict[str, FloatArray]:
    i_d, i_q = np.meshgrid(table.i_d, table.i_q)
    psi_d, psi_q = table.psi
    torque = table.torque_theta(theta)
    return {
        "Id": i_d,
        "Iq": i_q,
        "Fd": psi_d.T,
        "Fq": psi_q.T,
        "T": torque.mean(axis=-1).T,
        "dT": torque.std(axis=-1).T,
        "dTpp": np.ptp(torque, axis=-1).T,
    }
