"""A flux map as a file holds it: currents and flux linkages point by point, on a grid or scattered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from drive_id.common.quantity import counted
from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray

SCALARS = ("resistance", "pole_pairs", "i_max", "u_dc")
"""What a file may tell of the machine besides its map: ohm, 1, A, V."""

_LARGEST = 1e12  # in whatever unit a file has


@dataclass(frozen=True, eq=False)
class MapPoints:
    """Flux linkages at N pairs of currents, possibly at H rotor positions each."""

    i_dq: FloatArray  # (N, 2), A, in the conventions of the file
    psi_dq: FloatArray  # (N, 2, H), Wb; H is 1 for a map that does not depend on the rotor position
    theta: FloatArray | None = None  # (H,), electrical, rad, equally spaced over one period without its end point
    torque: FloatArray | None = None  # (N,), mean over the rotor position, Nm
    sigma_dq: FloatArray | None = None  # (N, 2), standard errors of the mean flux linkages, Wb
    scalars: Mapping[str, float] = field(default_factory=dict)  # those of :data:`SCALARS` that the file tells
    axis: str | None = None  # axis convention "pm" or "sr", if the file tells it
    shape: tuple[int, int] | None = None  # of the grid, when its index order had to be assumed
    machine: str = ""  # its name; empty when unknown

    def complete(self) -> MapPoints:
        """Return the points whose flux linkages are not NaN.

        Raises ConfigurationError when there are too few, the numbers of values differ, or values are infinite or
        missing.
        """
        known = np.asarray(~np.isnan(self.psi_dq).any(axis=(1, 2)))
        optional = {"torques": self.torque, "standard errors": self.sigma_dq}
        for name, values in {"currents": self.i_dq, **optional}.items():
            if values is not None and len(values) != len(known):
                raise ConfigurationError(f"The map has {len(values)} {name} for {len(known)} fluxes: make them match.")
        torque, sigma = (None if values is None else values[known] for values in optional.values())
        found = replace(self, i_dq=self.i_dq[known], psi_dq=self.psi_dq[known], torque=torque, sigma_dq=sigma)
        theta, count = found.theta, found.psi_dq.shape[2]
        if theta is not None and theta.shape != (count,):
            raise ConfigurationError(
                f"The map has {theta.size} rotor positions for fluxes at {count}: make them match."
            )
        if len(found.i_dq) < 16:
            raise ConfigurationError(
                f"The map has {counted(len(found.i_dq), 'point')} with data: at least 16 are needed."
            )
        if not (np.isfinite(found.i_dq).all() and np.isfinite(found.psi_dq).all()):
            raise ConfigurationError("The map holds NaN or infinite currents or fluxes: remove these points.")
        if max(float(np.abs(found.i_dq).max()), float(np.abs(found.psi_dq).max())) > _LARGEST:
            raise ConfigurationError(
                f"The map holds currents or fluxes beyond {_LARGEST:g}: check the columns and units."
            )
        if np.any(np.ptp(found.i_dq, axis=0) == 0):
            raise ConfigurationError("All points of the map have the same i_d or i_q: a map needs both to vary.")
        if not found.psi_dq.any():
            raise ConfigurationError("All flux linkages of the map are zero: check which columns or fields are read.")
        return found

    @property
    def mean_psi_dq(self) -> FloatArray:
        """Flux linkages averaged over the rotor position, (N, 2), Wb."""
        return np.asarray(self.psi_dq.mean(axis=2))


def of_grid(i_d: FloatArray, i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return currents (D * Q, 2) and flux linkages (D * Q, 2, H) at the points of a grid.

    Of axes (D,) and (Q,), A, and maps (D, Q) or (D, Q, H), Wb.
    """
    i_dq = np.stack(np.meshgrid(i_d, i_q, indexing="ij"), axis=-1).reshape(-1, 2)
    psi = np.stack([psi_d, psi_q], axis=2)
    return i_dq, psi.reshape(len(i_dq), 2, -1)
