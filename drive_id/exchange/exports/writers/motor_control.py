"""The look-up tables of Motor Control Blockset: struct ``pmsm.PMSMLUT`` with method FluxDQ."""

from __future__ import annotations

import numpy as np

from drive_id.exchange.exports.control import control_table
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.exchange.exports.writers.archives import mat_bytes


def write(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write ``FluxDTable``, ``FluxQTable`` and ``TorqueTable`` [i_d, i_q] over a column ``idVec`` and a row ``iqVec``.

    Where the DC-link voltage is known, also the references ``idRefTable``, ``iqRefTable`` [torque, speed] over
    ``trefVec`` (Nm) and ``wrpmVec`` (rpm).
    """
    machine = table.machine
    lut = {
        "method": "FluxDQ",
        "idVec": table.i_d[:, None],
        "iqVec": table.i_q[None, :],
        "FluxDTable": table.psi[0],
        "FluxQTable": table.psi[1],
        "TorqueTable": table.torque,
    }
    if machine.u_dc is not None:
        control = control_table(table)
        lut |= {
            "trefVec": control.torque[:, None],
            "wrpmVec": control.speed[None, :] * (30 / np.pi),
            "idRefTable": control.i_d.T,
            "iqRefTable": control.i_q.T,
        }
    L = machine.control_inductances(0.0, 0.0)
    pmsm = {
        "p": float(machine.known_pole_pairs()),
        "Rs": table.known_resistance(),
        "Ld": float(L[0, 0]),
        "Lq": float(L[1, 1]),
        "FluxPM": float(machine.psi_dq(0.0, 0.0)[0]),
        "I_rated": machine.i_max,
        "PMSMLUT": lut,
    }
    return mat_bytes({"pmsm": pmsm, "inside": table.inside})
