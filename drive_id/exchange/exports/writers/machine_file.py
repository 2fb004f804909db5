"""Machine files of drive_id, with the rotor-position harmonics."""

from __future__ import annotations

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.files.inputs.archive import npz_bytes


def write(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write ``id``, ``iq``, ``psi_d``, ``psi_q``, with harmonics also over ``theta_e_deg``, and the machine's data."""
    if table.missing and not table.filled:
        raise ConfigurationError(
            f"{table.missing} of {table.inside.size} points have no data, which a machine file cannot hold: choose a "
            "smaller --range, or --fill."
        )
    machine = table.machine
    values = {
        "id": table.i_d,
        "iq": table.i_q,
        "psi_d": table.psi[0],
        "psi_q": table.psi[1],
        "R": table.known_resistance(),
        "pole_pairs": machine.known_pole_pairs(),
        "i_max": machine.i_max,
    }
    if machine.u_dc is not None:
        values["u_dc"] = machine.u_dc
    if table.harmonics:
        theta = table.angles(2 * np.pi / np.gcd.reduce([order for order, _ in table.harmonics]))
        psi_d, psi_q = table.psi_theta(theta)
        values |= {"theta_e_deg": np.degrees(theta), "psi_d_theta": psi_d, "psi_q_theta": psi_q}
    return npz_bytes(values)
