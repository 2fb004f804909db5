"""Tables for the non-excited synchronous machine of PLECS."""

from __future__ import annotations

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.exchange.exports.writers.archives import mat_bytes


def write(table: MapTable, options: ExportOptions) -> bytes:
    """Write air-gap flux linkages and incremental inductances [i_d, i_q], without the stator leakage ``Lsigma``."""
    (i_d, i_q), (psi_d, psi_q), leakage = table.grid, table.psi, options.leakage_inductance
    L = table.inductances - leakage * np.eye(2)
    least = float(np.nanmin(np.linalg.eigvalsh((L + np.swapaxes(L, -1, -2)) / 2)[table.inside]))
    if leakage > 0 and least <= 0:
        raise ConfigurationError(
            f"--leakage is {leakage:g} H, but the least inductance is {leakage + least:.3g} H: give less than that."
        )
    return mat_bytes(
        {
            "id": table.i_d,
            "iq": table.i_q,
            "psid": psi_d - leakage * i_d,
            "psiq": psi_q - leakage * i_q,
            **{f"L{a}{b}": L[..., j, k] for j, a in enumerate("dq") for k, b in enumerate("dq")},
            "Lsigma": leakage,
            "R": table.known_resistance(),
            "p": float(table.machine.known_pole_pairs()),
            "inside": table.inside,
        }
    )
