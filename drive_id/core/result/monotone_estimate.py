"""The estimated map made monotone on request: the nearest map with a convex co-energy, in standard errors."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.maps.flux_models import TensorSpline, fitted, sites
from drive_id.core.methods.method import Estimate, SimulationModel
from drive_id.core.numerics.bspline import Axis
from drive_id.errors import DataError, UnexplainedError
from drive_id.messages import Message
from drive_id.types import BoolArray, FloatArray

if TYPE_CHECKING:  # takes 0.1 s, which methods psm and joint do without
    from drive_id.core.maps.monotone import MonotoneMap

_FINE = 48  # splines per axis of a simulated map that shares none with harmonics
_FAR = 3.0
"""Standard errors beyond which a move contradicts the data."""
_LEAST_SIGMA = 0.1
"""Of the median: a point with a smaller standard error counts as if it had this one."""


def made_monotone(evidence: Evidence, estimate: Estimate, inside: BoolArray) -> Estimate:
    """Replace the estimated map by a reciprocal and monotone one, and say how far it moved.

    The map is fitted to the estimate at the grid points with data, weighted by their standard errors. Correlations
    between the errors of neighbouring points do not count. The standard errors stay those of the estimate. Outside
    the data, the map is the continuation of the monotone one.

    Raises UnexplainedError when no monotone map is anywhere near, because a flux falls with its current on the whole.
    """
    from drive_id.core.maps.monotone import REACH, fit_monotone  # noqa: PLC0415  # takes 0.1 s

    grid = evidence.visits.grid()
    i, psi, sigma = grid[inside], estimate.psi[inside], estimate.sigma[inside]
    known = bool(np.isfinite(sigma).all() and (sigma > 0).all())
    weights = np.maximum(sigma, _LEAST_SIGMA * np.median(sigma)) if known else None
    size = np.hypot(i[:, 0], i[:, 1]).max()
    excess = np.concatenate([i.min(axis=0) - grid.min(axis=(0, 1)), grid.max(axis=(0, 1)) - i.max(axis=0)]).max() / size
    try:
        found = fit_monotone(i, psi, weights, reach=max(REACH, 1 + excess))
    except DataError as error:
        raise UnexplainedError(f"The map cannot be made monotone: {error} Or set monotone to false.") from error
    moved = np.abs(found.psi(i) - psi)
    simulation = _simulation(estimate.simulation, found)
    statement, *warnings = _told(i, moved, sigma if known else None, active=found.convexity.active)
    return replace(
        estimate,
        model=found.space,
        gamma=found.gamma,
        psi=found.psi(grid),
        simulation=simulation,
        positive_definite=lambda points: np.linalg.eigvalsh(found.inductances(points))[:, 0] > 0,
        warnings=(*estimate.warnings, *warnings),
        statements=(*estimate.statements, statement),
    )


def _simulation(known: SimulationModel, found: MonotoneMap) -> SimulationModel:
    """Return the model with the map found; it shares its splines with the harmonics, if there are any."""
    axes = known.model.d, known.model.q
    d, q = axes if known.harmonics else (Axis(axis.low, axis.high, _FINE) for axis in axes)
    return replace(known, model=TensorSpline(d, q), gamma=fitted(found.psi(sites(d, q, 2)), d, q))


def _told(i: FloatArray, moved: FloatArray, sigma: FloatArray | None, *, active: bool) -> list[Message]:
    """Return a statement on moves (N, 2), Wb, at currents (N, 2), and a warning if they contradict the data."""
    if sigma is None:
        return [Message("made_monotone", active=active, flux=moved.max())]
    ratio = moved / sigma
    rms, most = float(np.sqrt(np.mean(ratio**2))), float(ratio.max())
    told = [Message("made_monotone.judged", active=active, flux=moved.max(), ratio=most, ratio_rms=rms)]
    if most > _FAR:
        d, q = i[ratio.max(axis=1).argmax()]
        told.append(Message("moved_by_monotone", ratio=most, i_d=d, i_q=q))
    return told
