"""Parameters of Simscape: the FEM-Parameterized PMSM (dq0, over the rotor angle), and tables of inductances."""

from __future__ import annotations

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.exchange.exports.writers.archives import mat_bytes

_SPAN = 2 * np.pi / 3
"""Electrical angle after which the block repeats its tables."""
_LOST = 0.03
"""Flux that tables of L_d and L_q may lose, relative to the largest."""


def write_fem(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write tables [i_d, i_q, theta]; theta is mechanical, in degrees, from 0 to 120 / N, the first position repeated.

    Harmonics that do not repeat after a third of an electrical revolution are left out if they are small.
    """
    check_symmetric(table)
    table = table.repeating(_SPAN)
    pairs = table.machine.known_pole_pairs()
    theta = np.append(table.angles(_SPAN), _SPAN)
    psi_d, psi_q = table.psi_theta(theta)
    return mat_bytes(
        {
            "nPolePairs": float(pairs),
            "idVec2": table.i_d,
            "iqVec2": table.i_q,
            "xVec2": np.degrees(theta) / pairs,
            "fluxD_dq0": psi_d,
            "fluxQ_dq0": psi_q,
            "flux0_dq0": np.zeros_like(psi_d),
            "Torque_dq0": table.torque_theta(theta),
            "Rs": table.known_resistance(),
            "inside": table.inside,
        }
    )


def write_tabulated(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write tables of apparent inductances with ``psi_d = Ld i_d + pmFlux`` and ``psi_q = Lq i_q``.

    ``pmFluxMatrix`` is psi_d at i_d = 0, which changes with i_q, so that Ld is finite everywhere. psi_q at i_q = 0,
    which is zero in a symmetric machine, is lost.
    """
    i_d, i_q = table.grid
    l_d, l_q = table.machine.apparent_inductances(i_d, i_q)
    magnet, rest = table.machine.psi_dq(0.0 * i_d, i_q)[0], table.machine.psi_dq(i_d, 0.0 * i_q)[1]
    largest = float(np.nanmax(np.hypot(*table.psi)))
    if np.abs(rest[table.inside]).max() > _LOST * largest:
        raise ConfigurationError(
            f"psi_q is up to {np.abs(rest[table.inside]).max():.3g} Wb at i_q = 0, which tables of L_q cannot hold: "
            "export --format simscape instead."
        )
    return mat_bytes(
        {
            "nPolePairs": float(table.machine.known_pole_pairs()),
            "idVec": table.i_d,
            "iqVec": table.i_q,
            "LdMatrix": table.masked(l_d),
            "LqMatrix": table.masked(l_q),
            "pmFluxMatrix": table.masked(magnet),
            "pmFlux": float(table.machine.psi_dq(0.0, 0.0)[0]),
            "Rs": table.known_resistance(),
            "inside": table.inside,
        }
    )


def check_symmetric(table: MapTable) -> None:
    """Check that the d axis is symmetric about zero, as the block requires.

    Raises ConfigurationError when it is not.
    """
    if not np.allclose(table.i_d, -table.i_d[::-1], rtol=0, atol=1e-9 * table.i_d[-1] if table.i_d[-1] > 0 else 0.0):
        raise ConfigurationError(
            f"The d axis runs from {table.i_d[0]:g} to {table.i_d[-1]:g} A, but Simscape wants it symmetric about 0: "
            "choose --range -X X or such an --axis-d."
        )
