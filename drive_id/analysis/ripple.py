"""Torque over the rotor position, from the harmonics of the flux linkages.

With the co-energy W(i, theta) of one phase pair, psi = dW/di, the torque at constant current is
``1.5 p (psi_d i_q - psi_q i_d + dW/dtheta)``. The last term follows from the fluxes up to what does not depend on the
current: cogging at zero current shows in no voltage and is not included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.analysis.machine import MachineModel
from drive_id.core.maps.surfaces import Surfaces
from drive_id.types import FloatArray

_NODES = 12  # of Gauss-Legendre's rule from zero current to each point
_ANGLES_PER_PERIOD = 24  # of the highest harmonic: its peak is met to 1 %


@dataclass(frozen=True, eq=False)
class TorqueRipple:
    """The part of the torque that varies with the rotor position; build it by :meth:`of`."""

    model: MachineModel
    orders: tuple[int, ...]  # electrical
    cosines: tuple[Surfaces, ...]  # amplitudes of each order, Wb
    sines: tuple[Surfaces, ...]  # likewise

    @classmethod
    def of(cls, model: MachineModel) -> TorqueRipple:
        """Build it from the harmonics of the model's map."""
        found = model.flux_map
        axes, waves = (found.i_d, found.i_q), found.harmonics
        return cls(
            model,
            tuple(wave.order for wave in waves),
            tuple(Surfaces.over(*axes, wave.psi_d_cos, wave.psi_q_cos) for wave in waves),
            tuple(Surfaces.over(*axes, wave.psi_d_sin, wave.psi_q_sin) for wave in waves),
        )

    def amplitudes(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the torque's amplitudes of cos(h theta) and sin(h theta) (H, ...), Nm, at currents (...), A."""
        factor = 1.5 * self.model.known_pole_pairs()
        shape = (len(self.orders), *np.shape(i_d))
        cosine, sine = np.zeros(shape), np.zeros(shape)
        for k, order in enumerate(self.orders):
            parts = []
            for surface in (self.cosines[k], self.sines[k]):
                psi = surface.values(i_d, i_q)
                parts.append((psi[..., 0] * i_q - psi[..., 1] * i_d, _energy(surface, i_d, i_q)))
            (torque_cosine, energy_cosine), (torque_sine, energy_sine) = parts
            cosine[k] = factor * (torque_cosine + order * energy_sine)
            sine[k] = factor * (torque_sine - order * energy_cosine)
        return cosine, sine

    def over_angle(self, i_d: FloatArray, i_q: FloatArray, theta: FloatArray) -> FloatArray:
        """Return the varying part of the torque (..., T), Nm, at electrical angles (T,), rad."""
        cosine, sine = self.amplitudes(i_d, i_q)
        angle = np.array(self.orders)[:, None] * theta
        parts = [np.tensordot(cosine, np.cos(angle), (0, 0)), np.tensordot(sine, np.sin(angle), (0, 0))]
        return np.asarray(parts[0] + parts[1])

    def peak_to_peak(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Return the difference of the largest and the smallest torque over the rotor position (...), Nm."""
        if not self.orders:
            return np.zeros(np.shape(i_d))
        common = int(np.gcd.reduce(self.orders))
        count = _ANGLES_PER_PERIOD * max(self.orders) // common
        theta = np.arange(count, dtype=np.float64) * (2 * np.pi / common / count)
        return np.asarray(np.ptp(self.over_angle(i_d, i_q, theta), axis=-1))


def _energy(surface: Surfaces, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Return the integral of psi di (...), J, from zero to currents (...), A, along straight lines."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    share = 0.5 * (nodes + 1)
    psi = surface.values(np.multiply.outer(share, i_d), np.multiply.outer(share, i_q))
    power = psi[..., 0] * i_d + psi[..., 1] * i_q
    return np.asarray(np.tensordot(0.5 * weights, power, axes=1))
