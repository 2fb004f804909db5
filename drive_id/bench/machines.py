"""The shipped machines, each the gradient of one analytic co-energy over currents and rotor position.

With x = (i_d + i_f)/a and y = i_q/b the co-energy is

    W = E (s - 1) + psi_0 i_d + 1/2 L_sd i_d^2 + 1/2 L_sq i_q^2
        + sum_h E (k_h s cos(h theta) + m_h x y / s sin(h theta)),        s = sqrt(1 + x^2 + y^2),

so that both axes saturate together (cross-saturation), E/a^2 and E/b^2 are the unsaturated main inductances, i_f and
psi_0 stand for the magnet, and psi = dW/di is reciprocal and free of hysteresis by construction. W keeps its value
when i_q and theta change sign together: the machines are mirror-symmetric, as real ones with symmetric rotors are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray, MachineMap

_NODES_PER_I_MAX = 32  # of the sampled map, from zero current to i_max
_NODES_OUTSIDE = 9  # beyond i_max, on each side
_NODES_THETA = 24  # angles in a period of the harmonics


@dataclass(frozen=True)
class CoEnergyMachine:
    """Parameters of the co-energy above."""

    name: str
    magnet_flux: float  # psi_0, the magnet's flux linkage past the saturating iron, Wb
    magnet_current: float  # i_f, which stands for the magnet's flux in the saturating iron, A
    main_inductance: tuple[float, float]  # unsaturated, without the linear part, of d and q, H
    saturation_current: float  # b, at which q alone begins to saturate, A; on d scaled by the root of the inductances
    linear_inductance: tuple[float, float]  # L_sd, L_sq, H
    harmonics: tuple[tuple[int, float, float], ...]  # h, k_h, m_h
    resistance: float  # ohm
    pole_pairs: int
    i_max: float  # A
    u_dc: float  # V

    def flux(self, i_d: FloatArray, i_q: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return psi_d = dW/di_d and psi_q = dW/di_q, Wb, at currents, A, and electrical angles, rad; all broadcast."""
        b = self.saturation_current
        a = b * float(np.sqrt(self.main_inductance[1] / self.main_inductance[0]))
        energy = self.main_inductance[1] * b**2
        x, y = (i_d + self.magnet_current) / a, i_q / b
        s = np.sqrt(1 + x**2 + y**2)
        on_x, on_y = np.ones_like(theta), np.zeros_like(theta)
        for h, k, m in self.harmonics:
            on_x = on_x + k * np.cos(h * theta)
            on_y = on_y + m * np.sin(h * theta)
        # d(xy/s)/dx = y (1 + y^2)/s^3
        w_x = energy * (x / s * on_x + y * (1 + y**2) / s**3 * on_y)
        w_y = energy * (y / s * on_x + x * (1 + x**2) / s**3 * on_y)
        return w_x / a + self.magnet_flux + self.linear_inductance[0] * i_d, w_y / b + self.linear_inductance[1] * i_q

    def to_map(self) -> MachineMap:
        """Sample the fluxes on a grid somewhat larger than the current disc and over one period of the harmonics."""
        half = _NODES_PER_I_MAX + _NODES_OUTSIDE
        axis = np.arange(-half, half + 1, dtype=np.float64) * (self.i_max / _NODES_PER_I_MAX)
        d, q = axis[:, None], axis[None, :]
        theta = np.arange(_NODES_THETA, dtype=np.float64) * (2 * np.pi / 6 / _NODES_THETA)
        psi_d_theta, psi_q_theta = self.flux(d[..., None], q[..., None], theta)
        return MachineMap(
            name=self.name,
            i_d=axis,
            i_q=axis,
            psi_d=psi_d_theta.mean(axis=-1),
            psi_q=psi_q_theta.mean(axis=-1),
            resistance=self.resistance,
            pole_pairs=self.pole_pairs,
            i_max=self.i_max,
            u_dc=self.u_dc,
            theta=theta,
            psi_d_theta=psi_d_theta,
            psi_q_theta=psi_q_theta,
        )


MACHINES = {
    machine.name: machine
    for machine in (
        # A traction machine with buried magnets.
        CoEnergyMachine(
            "ipm", 0.045, 200.0, (0.12e-3, 0.34e-3), 220.0, (0.06e-3, 0.06e-3), ((6, 0.015, 0.01), (12, 0.006, -0.004)),
            resistance=10e-3, pole_pairs=4, i_max=300.0, u_dc=400.0,
        ),
        # A servo machine with surface magnets: hardly salient, saturating a little.
        CoEnergyMachine(
            "spm", 0.085, 10.0, (2.4e-3, 2.6e-3), 28.0, (0.6e-3, 0.6e-3), ((6, 0.02, 0.012), (12, 0.008, 0.005)),
            resistance=0.35, pole_pairs=3, i_max=20.0, u_dc=325.0,
        ),
        # An industrial reluctance machine with weak magnets on d and the strongly saturating iron path on q.
        CoEnergyMachine(
            "pmsyrm", 0.04, 10.0, (6.0e-3, 45e-3), 8.0, (3.0e-3, 2.5e-3), ((6, 0.008, 0.008), (12, 0.004, -0.005)),
            resistance=0.30, pole_pairs=2, i_max=40.0, u_dc=540.0,
        ),
    )
}  # fmt: skip
"""The shipped machines by name."""


def machine_map(name: str) -> MachineMap:
    """Return the map of a shipped machine; raises ConfigurationError when there is no machine of that name."""
    if name not in MACHINES:
        raise ConfigurationError(
            f"There is no machine '{name}': choose one of {', '.join(MACHINES)}, or give a machine file (.npz or .mat)."
        )
    return MACHINES[name].to_map()
