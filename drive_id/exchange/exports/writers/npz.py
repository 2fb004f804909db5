"""Archives of numpy: machine files of drive_id, maps of motulator and training data of its GradNets."""

from __future__ import annotations

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.files.inputs.archive import npz_bytes


def write_machine(table: MapTable, _: ExportOptions) -> bytes:
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
        theta = table.angles()
        psi_d, psi_q = table.psi_theta(theta)
        values |= {"theta_e_deg": np.degrees(theta), "psi_d_theta": psi_d, "psi_q_theta": psi_q}
    return npz_bytes(values)


def write_motulator(table: MapTable, _: ExportOptions) -> bytes:
    """Write ``i_s_dq``, ``psi_s_dq``, ``inside``, indexed [i_d, i_q], and the machine's data where known."""
    (i_d, i_q), (psi_d, psi_q) = table.grid, table.psi
    values = {"i_s_dq": i_d + 1j * i_q, "psi_s_dq": psi_d + 1j * psi_q, "inside": table.inside} | _scalars(table)
    if table.machine.pole_pairs is not None:
        values["tau_M"] = table.torque
    return npz_bytes(values)


def write_gradnet_data(table: MapTable, _: ExportOptions) -> bytes:
    """Write points with data only, in one dimension; with harmonics, each at ``theta_m`` (rad) with ``tau_m``.

    ``tau_m`` is the torque per pole pair, Nm.
    """
    kept, current = table.inside | table.filled, table.grid[0] + 1j * table.grid[1]
    if not table.harmonics:
        psi = table.psi[0] + 1j * table.psi[1]
        return npz_bytes({"i_s_dq": current[kept], "psi_s_dq": psi[kept]} | _scalars(table))
    theta = table.angles()
    psi_d, psi_q = table.psi_theta(theta)
    shape = (*current.shape, len(theta))
    values = {
        "i_s_dq": np.broadcast_to(current[..., None], shape)[kept].ravel(),
        "psi_s_dq": (psi_d + 1j * psi_q)[kept].ravel(),
        "theta_m": np.broadcast_to(theta, shape)[kept].ravel(),
    }
    if table.machine.pole_pairs is not None:
        values["tau_m"] = table.torque_theta(theta)[kept].ravel() / table.machine.pole_pairs
    return npz_bytes(values | _scalars(table))


def _scalars(table: MapTable) -> dict[str, np.ndarray]:
    """Return what is known of the machine, by motulator's names."""
    names = {"i_max": "i_max", "source": "source", "u_dc": "u_dc", "R_s": "resistance", "n_p": "pole_pairs"}
    facts = table.facts()
    return {name: np.asarray(facts[own]) for name, own in names.items() if own in facts}
