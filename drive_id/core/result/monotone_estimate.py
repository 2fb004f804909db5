"""The estimated map made monotone on request: the nearest map with a convex co-energy, in standard errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drive_id.common.messages import Message
from drive_id.core.methods.method import Estimate
from drive_id.errors import DataError, UnexplainedError
from drive_id.types import FloatArray

_FAR = 3.0
"""Standard errors beyond which a move contradicts the data."""
_LEAST_SIGMA = 0.1
"""Of the median: a point with a smaller standard error counts as if it had this one."""


def made_monotone(estimate: Estimate) -> Estimate:
    """Replace the estimated map by a reciprocal and monotone one, and say how far it moved.

    The map is fitted to the estimate at the grid points with data, weighted by their standard errors. Correlations
    between the errors of neighbouring points do not count. The standard errors stay those of the estimate. Outside
    the data, the map is the continuation of the monotone one.

    Raises UnexplainedError when no monotone map is anywhere near, because a flux falls with its current on the whole.
    """
    from drive_id.core.maps.monotone import REACH, fit_monotone  # noqa: PLC0415  # takes 0.1 s

    known, grid = estimate.flux_map, estimate.flux_map.grid()
    i, psi, sigma = (x[known.inside] for x in (grid, known.psi, known.sigmas))
    judged = bool(np.isfinite(sigma).all() and (sigma > 0).all())
    weights = np.maximum(sigma, _LEAST_SIGMA * np.median(sigma)) if judged else None
    size = np.hypot(i[:, 0], i[:, 1]).max()
    excess = np.concatenate([i.min(axis=0) - grid.min(axis=(0, 1)), grid.max(axis=(0, 1)) - i.max(axis=0)]).max() / size
    try:
        found = fit_monotone(i, psi, weights, reach=max(REACH, 1 + excess))
    except DataError as error:
        raise UnexplainedError(f"The map cannot be made monotone: {error} Or set monotone to false.") from error
    moved = np.abs(found.psi(i) - psi)
    statement, *warnings = _told(i, moved, sigma if judged else None, active=found.convexity.active)
    return replace(
        estimate,
        flux_map=replace(known, **dict(zip(("psi_d", "psi_q"), np.moveaxis(found.psi(grid), -1, 0), strict=True))),
        warnings=(*estimate.warnings, *warnings),
        statements=(*estimate.statements, statement),
    )


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
