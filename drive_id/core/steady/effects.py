"""Effects in real logs beyond the voltage equation; they are tested, and fitted if significant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.core.frames import J
from drive_id.core.steady.flux_bases import FluxBasis, affine_rows, linearized
from drive_id.core.steady.operating_points import OperatingPoints
from drive_id.types import FloatArray


@dataclass(frozen=True)
class Effect:
    """One effect."""

    name: str
    several_speeds: bool  # it takes several speeds to tell it from the fluxes
    odd: bool = False  # it is a part of the map that is not symmetric about the d axis


IRON_LOSS = Effect("iron loss", several_speeds=True)
DELAY = Effect("delay", several_speeds=True)
ASYMMETRY = Effect("asymmetry", several_speeds=False, odd=True)
EFFECTS = (IRON_LOSS, DELAY, ASYMMETRY)


def effect_columns(effect: Effect, points: OperatingPoints, basis: FluxBasis, gamma: FloatArray) -> FloatArray:
    """Return the voltages of an effect at the points.

    Iron loss: eddy currents ``i_e = omega J psi / R_c`` flow beside those of the windings, so the flux belongs to
    ``i - i_e``, and ``-omega^2 J L J psi / R_c`` adds to the voltage; the coefficient is 1 / R_c. Delay: the dq frame
    of the voltages lags by omega times the coefficient, s. Asymmetry: psi_q at zero current and L_dq.

    Parameters
    ----------
    gamma : (C,) float
        Fluxes as known so far.

    Returns
    -------
    (P, 2, K) float
        Per unit of the K coefficients.
    """
    speed = points.speed[:, None, None]
    if effect.odd:
        return np.asarray(speed * np.einsum("ab,nbk->nak", J, affine_rows(points.i_dq)[..., 3:]))
    if effect == DELAY:
        return np.asarray(speed * (points.u_dq @ J.T)[..., None])
    psi, inductance = linearized(basis, gamma, points.i_dq)
    return np.asarray(-(speed**2) * np.einsum("ab,nbc,cd,nd->na", J, inductance, J, psi)[..., None])
