"""Tables of the Powertrain Blockset: the flux-based PMSM and its controller."""

from __future__ import annotations

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.axes import clean
from drive_id.exchange.exports.control import control_table
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.exchange.exports.writers.archives import mat_bytes
from drive_id.types import FloatArray


def write_machine(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write the inverse maps ``id``, ``iq`` [psi_d, psi_q] over ``flux_d``, ``flux_q``, with ``Rs`` and ``P``."""
    psi_d, psi_q, i_d, i_q = inverse_maps(table)
    return mat_bytes(
        {
            "flux_d": psi_d,
            "flux_q": psi_q,
            "id": i_d,
            "iq": i_q,
            "Rs": table.known_resistance(),
            "P": float(table.machine.known_pole_pairs()),
        }
    )


def write_controller(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write the fluxes ``lambda_d``, ``lambda_q`` [i_d, i_q], and references ``id_ref``, ``iq_ref`` [speed, torque].

    Breakpoints are ``id_index``, ``iq_index`` (A), ``wbp`` (mechanical, rad/s) and ``tbp`` (Nm).
    """
    control = control_table(table)
    return mat_bytes(
        {
            "id_index": table.i_d,
            "iq_index": table.i_q,
            "lambda_d": table.psi[0],
            "lambda_q": table.psi[1],
            "id_ref": control.i_d,
            "iq_ref": control.i_q,
            "wbp": control.speed,
            "tbp": control.torque,
            "Rs": table.known_resistance(),
            "P": float(table.machine.known_pole_pairs()),
            "inside": table.inside,
        }
    )


def inverse_maps(table: MapTable) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return axes of psi_d (D,) and psi_q (Q,), Wb, and the currents i_d and i_q (D, Q), A, that belong to them.

    The axes have as many points as those of the table, and cover the fluxes that it holds. Currents without data are
    NaN unless the table is filled.

    Raises ConfigurationError when the continued map does not reach all these fluxes.
    """
    psi_d, psi_q = (_spread(psi, len(axis)) for psi, axis in zip(table.psi, (table.i_d, table.i_q), strict=True))
    i_d, i_q = table.machine.current(psi_d[:, None], psi_q)
    if table.filled:
        if np.isnan(i_d).any():
            raise ConfigurationError(
                "The continued map does not reach all fluxes of its rectangle: choose a smaller --range."
            )
        return psi_d, psi_q, i_d, i_q
    known = table.machine.inside(i_d, i_q)
    return psi_d, psi_q, np.where(known, i_d, np.nan), np.where(known, i_q, np.nan)


def _spread(psi: FloatArray, count: int) -> FloatArray:
    """Return points with equal steps over the range of a flux, (count,), Wb."""
    return clean(np.linspace(float(np.nanmin(psi)), float(np.nanmax(psi)), count))
