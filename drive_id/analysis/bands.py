"""Standard errors of derived figures, from the joint errors of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drive_id.core.maps.continuation import LongerGrid
from drive_id.core.maps.surfaces import Surfaces
from drive_id.types import FloatArray

if TYPE_CHECKING:
    from drive_id.core.result.identification import IdentifiedDrive

_ANY_CORRELATION = np.sqrt(2.0)
"""Two errors of unknown correlation add up to at most this times the root of their squares."""
IRON_LOSS = ("iron_loss_conductance", "iron_loss_hysteresis", "iron_loss_current")
"""Names of the parts of the iron loss among what a fit identifies."""
BY_SPEED = "resistance_by_speed"
"""Name of the rise of the resistance with the speed, likewise."""


@dataclass(frozen=True, eq=False)
class ModelErrors:
    """Changes due to M independent causes of error, of one standard error each, on the grid of an extrapolated map.

    A figure that changes by c_k with cause k has the standard error ``sqrt(sum_k c_k^2)``.
    """

    i_d: FloatArray  # (D,), A
    i_q: FloatArray  # (Q,), A
    psi_d: FloatArray  # (M, D, Q), Wb
    psi_q: FloatArray  # (M, D, Q), Wb
    resistance: FloatArray  # (M,), ohm
    inverter_voltage: FloatArray  # (M, C), V
    iron: FloatArray  # (M, 3), of the parts of the iron loss: conductance, S; hysteresis, S rad/s; coercivity, A
    joint: bool
    """Whether correlations are known. Otherwise each flux linkage has one common error over the whole map, the bands
    hold for any correlation, and the errors of slopes are unknown."""

    @classmethod
    def of(cls, drive: IdentifiedDrive, longer: LongerGrid, *, warmer: float, magnet: float) -> ModelErrors | None:
        """Return the errors of an identified drive; None when its standard errors are not known.

        Parameters
        ----------
        longer : LongerGrid
            To which the map is continued.
        warmer : float
            Factor on the resistance by its temperature.
        magnet : float
            Kelvin by which the magnet is warmer than the map's temperature.
        """
        found, modes = drive.flux_map, drive.error_modes
        if modes is not None:
            fluxes = np.concatenate([modes.psi_d, modes.psi_q])
            resistance, voltage = modes.resistance, modes.inverter_voltage
        else:
            sigmas = [np.where(found.inside, sigma, 0.0) for sigma in (found.sigma_d, found.sigma_q)]
            if not np.isfinite(sigmas).all() or not np.any(sigmas):
                return None
            fluxes = np.zeros((8, *found.inside.shape))
            fluxes[0], fluxes[5] = (_ANY_CORRELATION * sigma for sigma in sigmas)
            resistance, voltage = np.zeros(4), np.zeros((4, len(drive.inverter_current)))
            resistance[2] = _known(drive.sigma_resistance)
            if drive.sigma_inverter_voltage is not None:
                voltage[3] = _known(drive.sigma_inverter_voltage)
        psi_d, psi_q = np.split(longer.whole(fluxes), 2)
        by_magnet = []
        if magnet and drive.magnet_coefficient is not None:
            by_magnet = [magnet * float(_known(drive.magnet_coefficient[1]))]
        by_iron = _of_iron(drive)
        first, more = len(resistance), (0, len(by_magnet) + len(by_iron))
        psi_d, psi_q = (np.pad(psi, (more, (0, 0), (0, 0))) for psi in (psi_d, psi_q))
        psi_d[first : first + len(by_magnet)] = np.reshape(by_magnet, (-1, 1, 1))
        iron = np.concatenate([np.zeros((first + len(by_magnet), len(IRON_LOSS))), by_iron])
        resistance, voltage = np.pad(warmer * resistance, more), np.pad(voltage, (more, (0, 0)))
        return cls(longer.i_d, longer.i_q, psi_d, psi_q, resistance, voltage, iron, joint=modes is not None)

    def __len__(self) -> int:
        return len(self.resistance)

    @cached_property
    def _surfaces(self) -> tuple[Surfaces, ...]:
        pairs = zip(self.psi_d, self.psi_q, strict=True)
        return tuple(Surfaces.over(self.i_d, self.i_q, psi_d, psi_q) for psi_d, psi_q in pairs)

    def fluxes(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Return the changes of psi_dq (M, ..., 2), Wb, at currents (...), A."""
        return np.stack([surface.values(i_d, i_q) for surface in self._surfaces])

    def inductances(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Return the changes of the incremental inductances (M, ..., 2, 2), H; NaN without known correlations."""
        slopes = np.stack([surface.slopes(i_d, i_q) for surface in self._surfaces])
        return slopes if self.joint else np.full(slopes.shape, np.nan)


def combined(changes: FloatArray) -> FloatArray:
    """Return the standard error (...) of a figure with changes (M, ...)."""
    return np.asarray(np.sqrt(np.sum(changes**2, axis=0)))


def _of_iron(drive: IdentifiedDrive) -> FloatArray:
    """Return one cause of error for each identified part of the iron loss (0 to 3, 3): its own standard error."""
    sigmas = {entry.name: entry.sigma for entry in drive.calibrations if entry.applied and entry.name in IRON_LOSS}
    found = np.diag(_known(np.array([sigmas.get(name, 0.0) for name in IRON_LOSS])))
    return found[[name in sigmas for name in IRON_LOSS]]


def _known(value: FloatArray | float) -> FloatArray:
    """Return a standard error, 0 where it is not known."""
    return np.asarray(np.where(np.isfinite(value), value, 0.0))
