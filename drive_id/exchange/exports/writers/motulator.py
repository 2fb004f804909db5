"""Complex flux maps for motulator, and training data for its GradNets."""

from __future__ import annotations

import numpy as np

from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.files.inputs.archive import npz_bytes


def write(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write ``i_s_dq``, ``psi_s_dq``, ``inside``, indexed [i_d, i_q], and the machine's data where known."""
    (i_d, i_q), (psi_d, psi_q) = table.grid, table.psi
    values = {"i_s_dq": i_d + 1j * i_q, "psi_s_dq": psi_d + 1j * psi_q, "inside": table.inside}
    return npz_bytes(values | _scalars(table))


def write_samples(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write points with data only, in one dimension; with harmonics, each at ``theta_m`` (rad) with ``tau_m``.

    ``tau_m`` is the torque per pole pair, Nm.
    """
    kept = table.inside | table.filled
    if not table.harmonics:
        (i_d, i_q), (psi_d, psi_q) = table.grid, table.psi
        values = {"i_s_dq": (i_d + 1j * i_q)[kept], "psi_s_dq": (psi_d + 1j * psi_q)[kept]}
        return npz_bytes(values | _scalars(table, with_torque=False))
    theta = table.angles(2 * np.pi / np.gcd.reduce([order for order, _ in table.harmonics]))
    psi_d, psi_q = table.psi_theta(theta)
    current = np.repeat((table.grid[0] + 1j * table.grid[1])[..., None], len(theta), axis=-1)
    values = {
        "i_s_dq": current[kept].ravel(),
        "psi_s_dq": (psi_d + 1j * psi_q)[kept].ravel(),
        "theta_m": np.broadcast_to(theta, current.shape)[kept].ravel(),
    }
    if table.machine.pole_pairs is not None:
        values["tau_m"] = table.torque_theta(theta)[kept].ravel() / table.machine.pole_pairs
    return npz_bytes(values | _scalars(table, with_torque=False))


def _scalars(table: MapTable, *, with_torque: bool = True) -> dict[str, object]:
    machine = table.machine
    values: dict[str, object] = {"i_max": np.asarray(machine.i_max), "source": np.asarray(table.source)}
    if machine.u_dc is not None:
        values["u_dc"] = np.asarray(machine.u_dc)
    if np.isfinite(machine.resistance):
        values["R_s"] = np.asarray(machine.resistance)
    if machine.pole_pairs is not None:
        values["n_p"] = np.asarray(machine.pole_pairs)
        if with_torque:
            values["tau_M"] = table.torque
    return values
