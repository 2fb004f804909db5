"""Torque over the current plane, and the lines of operation on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.analysis.machine import MachineModel
from drive_id.analysis.trajectories import CurrentLocus, mtpa, mtpv
from drive_id.fitting.result import Identification
from drive_id.types import FloatArray


@dataclass(frozen=True, eq=False)
class Line:
    """A line of operation in the current plane, where there are data.

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
class TorqueMap:
    """Torque and the lines of operation of a machine whose pole pairs are known.

    Parameters
    ----------
    torque : (D, Q) float
        On the grid of the flux map, Nm, NaN where there are no data.
    lines : tuple of Line
        MTPA in both directions of torque, and MTPV; those that lie in the data.
    """

    torque: FloatArray
    lines: tuple[Line, ...]


def torque_map(result: Identification) -> TorqueMap | None:
    """Return torque and lines of operation; None when the pole pairs are unknown."""
    if result.pole_pairs is None:
        return None
    model, found = MachineModel.of(result), result.flux_map
    torque = model.torque(found.i_d[:, None], found.i_q)
    trajectories = {
        "MTPA": mtpa(model, result.i_max),
        "MTPA, negative torque": mtpa(model, result.i_max, sign=-1.0),
        "MTPV": mtpv(model, result.i_max),
    }
    lines = (_line(name, trajectory) for name, trajectory in trajectories.items())
    return TorqueMap(np.where(found.inside, torque, np.nan), tuple(line for line in lines if len(line.i_d) > 1))


def _line(name: str, found: CurrentLocus) -> Line:
    at = found.inside
    return Line(name, found.i_d[at], found.i_q[at], found.torque[at], found.sigma_torque[at])
