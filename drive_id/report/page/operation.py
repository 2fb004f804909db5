"""Torque over the current plane, and the lines of operation on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.fitting.result import Identification
from drive_id.types import FloatArray


@dataclass(frozen=True, eq=False)
class Line:
    """A line of operation in the current plane.

    Parameters
    ----------
    name : str
    i_d, i_q : (N,) float
        A.
    torque, sigma_torque : (N,) float
        Nm; sigma is NaN where unknown.
    """

    name: str
    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    sigma_torque: FloatArray


@dataclass(frozen=True, eq=False)
class Operation:
    """Torque and the lines of operation of a machine whose pole pairs are known.

    Parameters
    ----------
    torque : (D, Q) float
        On the grid of the flux map, Nm, NaN where there are no data.
    lines : tuple of Line
        MTPA, and MTPV where it lies in the data.
    """

    torque: FloatArray
    lines: tuple[Line, ...] = ()


def operation_of(result: Identification) -> Operation | None:
    """Return torque and lines of operation; None when the pole pairs are unknown."""
    if result.pole_pairs is None:
        return None
    found = result.flux_map
    torque = 1.5 * result.pole_pairs * (found.psi_d * found.i_q - found.psi_q * found.i_d[:, None])
    return Operation(np.where(found.inside, torque, np.nan))
