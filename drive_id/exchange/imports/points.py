"""A flux map as a file holds it: currents and flux linkages point by point, on a grid or scattered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray

SCALARS = ("resistance", "pole_pairs", "i_max", "u_dc")
"""What a file may tell of the machine besides its map: ohm, 1, A, V."""

_LARGEST = 1e12  # in whatever unit a file has


@dataclass(frozen=True, eq=False)
class MapPoints:
    """Flux linkages at N pairs of currents, possibly at H rotor positions each.

    Parameters
    ----------
    i_dq : (N, 2) float
        A, in the conventions of the file.
    psi_dq : (N, 2, H) float
        Wb; H is 1 for a map that does not depend on the rotor position.
    theta : (H,) float or None
        Electrical angles, rad, equally spaced over one period without its end point.
    torque : (N,) float or None
        Mean over the rotor position, Nm.
    sigma_dq : (N, 2) float or None
        Standard errors of the mean flux linkages, Wb.
    scalars : mapping of str to float
        Those of :data:`SCALARS` that the file tells.
    axis : {"pm", "sr"} or None
        The axis convention, if the file tells it.
    shape : (int, int) or None
        Of the grid that the points were read from, when its index order had to be assumed.
    machine : str
        Name; empty when unknown.
    """

    i_dq: FloatArray
    psi_dq: FloatArray
    theta: FloatArray | None = None
    torque: FloatArray | None = None
    sigma_dq: FloatArray | None = None
    scalars: Mapping[str, float] = field(default_factory=dict)
    axis: str | None = None
    shape: tuple[int, int] | None = None
    machine: str = ""

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
        found._check()  # noqa: SLF001  # of its own class
        return found

    def _check(self) -> None:
        theta, count = self.theta, self.psi_dq.shape[2]
        if theta is not None and theta.shape != (count,):
            raise ConfigurationError(
                f"The map has {theta.size} rotor positions for fluxes at {count}: make them match."
            )
        if len(self.i_dq) < 16:
            raise ConfigurationError(f"The map has {len(self.i_dq)} points with data: at least 16 are needed.")
        if not (np.isfinite(self.i_dq).all() and np.isfinite(self.psi_dq).all()):
            raise ConfigurationError("The map holds NaN or infinite currents or fluxes: remove these points.")
        if max(float(np.abs(self.i_dq).max()), float(np.abs(self.psi_dq).max())) > _LARGEST:
            raise ConfigurationError(
                f"The map holds currents or fluxes beyond {_LARGEST:g}: check the columns and units."
            )
        if np.any(np.ptp(self.i_dq, axis=0) == 0):
            raise ConfigurationError("All points of the map have the same i_d or i_q: a map needs both to vary.")
        if not self.psi_dq.any():
            raise ConfigurationError("All flux linkages of the map are zero: check which columns or fields are read.")

    @property
    def mean_psi_dq(self) -> FloatArray:
        """Flux linkages averaged over the rotor position, (N, 2), Wb."""
        return np.asarray(self.psi_dq.mean(axis=2))


def of_grid(i_d: FloatArray, i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the points of a grid.

    Parameters
    ----------
    i_d, i_q : (D,), (Q,) float
        Axes, A.
    psi_d, psi_q : (D, Q) or (D, Q, H) float
        Wb.

    Returns
    -------
    i_dq : (D * Q, 2) float
    psi_dq : (D * Q, 2, H) float
    """
    i_dq = np.stack(np.meshgrid(i_d, i_q, indexing="ij"), axis=-1).reshape(-1, 2)
    psi = np.stack([psi_d, psi_q], axis=2)
    return i_dq, psi.reshape(len(i_dq), 2, -1)
