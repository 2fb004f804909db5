"""A machine as the simulation sees it: one spline of the flux linkages, which *is* the machine.

Its average over the rotor position is known exactly and is the ground truth of an experiment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from drive_id.bench.kernels import evaluate_many
from drive_id.bench.parameters import SplineTable
from drive_id.bench.splines import build_table, mean_table
from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray, MachineMap

_SIXTH_NODES = 24  # angles in a period of a sixth harmonic that is added
_ROUGH_NODES = 9  # of the map that the current controller knows, along each axis


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine of splines; build it by :meth:`from_map`."""

    name: str
    table: SplineTable  # flux linkages over currents and rotor position
    mean: SplineTable  # their exact average over the rotor position
    rough: SplineTable  # what an engineer knows beforehand, for the current controller: the average on 9 x 9 points
    resistance: float  # ohm
    pole_pairs: int
    i_max: float  # largest current amplitude, A: the map's own, or less where the map reaches less far
    u_dc: float  # V

    @classmethod
    def from_map(
        cls, machine_map: MachineMap, *, harmonics: float = 1.0, sixth_harmonic: float = 0.0, i_max: float | None = None
    ) -> Machine:
        """Build a machine from a map.

        Parameters
        ----------
        harmonics : float, optional
            Factor on everything in the map that depends on the rotor position; 0 gives the averaged machine.
        sixth_harmonic : float, optional
            Adds f(i) e cos(6 theta) with this e, for maps without harmonics: the gradient of a co-energy, too.
        i_max : float, optional
            Current amplitude of the experiment, A. Default: that of the map as far as the map reaches.

        Raises
        ------
        ConfigurationError
            When the angles of the map do not fill a period, or no amplitude is given and the map has hardly a disc
            around zero current.
        """
        theta, psi = _with_harmonics(machine_map, harmonics, sixth_harmonic)
        table = build_table(machine_map.i_d, machine_map.i_q, theta, psi)
        mean = mean_table(table)
        amplitude = default_amplitude(machine_map) if i_max is None else i_max
        axis = np.linspace(-1.2 * amplitude, 1.2 * amplitude, _ROUGH_NODES)
        rough = build_table(axis, axis, None, _flux(mean, axis[:, None], axis, 0.0))
        source = machine_map
        return cls(source.name, table, mean, rough, source.resistance, source.pole_pairs, amplitude, source.u_dc)

    def flux(self, i_d: ArrayLike, i_q: ArrayLike, theta: ArrayLike) -> FloatArray:
        """Return the flux linkages (..., 2), Wb, at currents, A, and electrical angles, rad, that broadcast."""
        return _flux(self.table, i_d, i_q, theta)

    def mean_flux(self, i_d: ArrayLike, i_q: ArrayLike) -> FloatArray:
        """Return the flux linkages (..., 2) averaged over the rotor position, Wb, at currents, A."""
        return _flux(self.mean, i_d, i_q, 0.0)


def default_amplitude(machine_map: MachineMap) -> float:
    """Return the largest current amplitude, A, up to ``i_max``, whose disc the map covers.

    Raises ConfigurationError when that is less than a quarter of ``i_max``.
    """
    reach = min(-machine_map.i_d[0], machine_map.i_d[-1], -machine_map.i_q[0], machine_map.i_q[-1])
    amplitude = float(min(reach, machine_map.i_max))
    if amplitude < 0.25 * machine_map.i_max:
        raise ConfigurationError(
            f"The map of machine '{machine_map.name}' covers a disc of only {max(amplitude, 0.0):g} A around zero "
            f"current where i_max is {machine_map.i_max:g} A: extend the map, or set i_max to extrapolate it."
        )
    return amplitude


def _flux(table: SplineTable, i_d: ArrayLike, i_q: ArrayLike, theta: ArrayLike) -> FloatArray:
    d, q, angle = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (i_d, i_q, theta)))
    return evaluate_many(table, d.ravel(), q.ravel(), angle.ravel()).reshape(*d.shape, 6)[..., :2]


def _with_harmonics(
    machine_map: MachineMap, harmonics: float, sixth_harmonic: float
) -> tuple[FloatArray | None, FloatArray]:
    """Return the angles and the fluxes (D, Q, 2, H), or None and (D, Q, 2)."""
    average = np.stack((machine_map.psi_d, machine_map.psi_q), axis=-1)
    theta, psi_d, psi_q = machine_map.theta, machine_map.psi_d_theta, machine_map.psi_q_theta
    if theta is not None and psi_d is not None and psi_q is not None and harmonics != 0.0:
        psi = np.stack((psi_d, psi_q), axis=2)
        average = psi.mean(axis=-1)
        psi = average[..., None] + harmonics * (psi - average[..., None])
    elif sixth_harmonic != 0.0:
        theta = np.arange(_SIXTH_NODES, dtype=np.float64) * (2 * np.pi / 6 / _SIXTH_NODES)
        psi = np.repeat(average[..., None], _SIXTH_NODES, axis=-1)
    else:
        return None, average
    _check_period(machine_map.name, theta, sixth_harmonic)
    return theta, psi + sixth_harmonic * average[..., None] * np.cos(6 * theta)


def _check_period(name: str, theta: FloatArray, sixth_harmonic: float) -> None:
    steps = np.diff(theta)
    if len(theta) < 4 or np.ptp(steps) > 1e-6 * steps[0]:
        raise ConfigurationError(
            f"Machine '{name}' has angles that are not equally spaced, or fewer than 4: resample the map over theta."
        )
    periods = 2 * np.pi / (len(theta) * steps[0])
    if abs(periods - round(periods)) > 1e-6 or (sixth_harmonic != 0.0 and 6 % round(periods) != 0):
        raise ConfigurationError(
            f"The {len(theta)} angles of machine '{name}' fill {np.degrees(2 * np.pi / periods):g} degrees, which is "
            "no period of its harmonics: give one period (360 or 60 degrees) without the end point."
        )
