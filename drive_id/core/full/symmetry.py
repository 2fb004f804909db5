"""The resolver's offset, estimated from the mirror symmetry of a machine to its d axis."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from drive_id.core.full.calibration import Calibration, rotated
from drive_id.core.full.fit import FullFit
from drive_id.core.maps.flux_models import BasisRows
from drive_id.types import FloatArray

_LARGEST_ANGLE = np.deg2rad(20.0)
_LARGEST_ASYMMETRY = 0.01
"""Of the largest flux, left at the best angle: of a machine that is mirror-symmetric there is no more."""


def calibrate_angle(fit: FullFit, i_dq: FloatArray) -> Calibration:
    """Estimate the resolver's offset from psi_d(i_d, -i_q) = psi_d(i_d, i_q), psi_q(i_d, -i_q) = -psi_q(i_d, i_q).

    An offset turns currents and fluxes together, which no voltage shows; a machine whose rotor is not symmetric to its
    d axis has no such symmetry, and then there is nothing to calibrate with.

    Parameters
    ----------
    fit : FullFit
    i_dq : (N, 2) float
        Currents with data, as measured, whose mirror images have data, too, A.

    Returns
    -------
    Calibration
        Measured minus true electrical angle, rad.
    """
    name, unit = "resolver_offset", "rad"
    if len(i_dq) < 16:
        return Calibration(
            name,
            0.0,
            float("nan"),
            unit,
            False,
            "An offset of the angle cannot be found without currents of both signs of i_q.",
        )
    mirror = np.array([1.0, -1.0])

    def sides(angle: float) -> list[tuple[FloatArray, BasisRows]]:
        return [(sign, fit.model.flux.rows(rotated(i_dq * sign, -angle))) for sign in (np.ones(2), mirror)]

    def difference(angle: float) -> FloatArray:
        """Return by how much the map, turned back by an angle, breaks the symmetry, (N, 2)."""
        one, other = (sign * rotated(rows.dot(gamma), angle) for sign, rows in sides(angle))
        return np.asarray(one - other)

    def form(angle: float, weights: FloatArray) -> FloatArray:
        """Return what the sum of the differences times weights (N, 2) is to the map's coefficients, (P,)."""
        one, other = (
            rows.sparse(len(gamma)).T @ rotated(sign * weights, -angle).ravel() for sign, rows in sides(angle)
        )
        return np.asarray(one - other)

    gamma = fit.solution.residual[fit.model.map]
    found = minimize_scalar(
        lambda angle: float(np.sum(difference(angle) ** 2)),
        bounds=(-_LARGEST_ANGLE, _LARGEST_ANGLE),
        method="bounded",
        options={"xatol": 1e-7},
    )
    angle, step = float(found.x), 1e-4
    slope = (difference(angle + step) - difference(angle - step)) / (2 * step)
    moves = form(angle, slope) @ fit.changes[fit.model.map]
    sigma = float(np.linalg.norm(moves) / np.sum(slope**2))
    size = float(np.abs(fit.model.flux.rows(i_dq).dot(gamma)).max())
    asymmetry = float(np.sqrt(np.mean(difference(angle) ** 2))) / size
    degrees = f"{np.rad2deg(angle):+.4f} +- {np.rad2deg(sigma):.4f} degrees"
    if asymmetry > _LARGEST_ASYMMETRY or abs(angle) > 0.98 * _LARGEST_ANGLE:
        reason = (
            f"No angle makes the map mirror-symmetric ({100 * asymmetry:.1f} % are left at {degrees}): the machine is "
            "asymmetric, or the angle is far off, so no offset of the angle was taken out."
        )
        return Calibration(name, angle, sigma, unit, False, reason)
    sentence = f"The measured angle was taken to be {degrees} too large, for which the map is mirror-symmetric."
    return Calibration(name, angle, sigma, unit, True, sentence)
