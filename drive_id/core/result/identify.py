"""Identify a drive from samples in memory."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import shortened
from drive_id.core.checks.prescan import Prescan
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.validation.metrics import nrmse, true_flux
from drive_id.errors import DataError
from drive_id.types import GroundTruth, Progress, Samples, silent


def identify(
    recordings: Sequence[Samples], settings: FitSettings | None = None, tell: Progress = silent
) -> IdentifiedDrive:
    """Identify flux maps, resistance and inverter voltage error jointly from recordings of one drive.

    Periods and speeds may differ. Raises StandstillError, CoverageError, DataError when these samples cannot give a
    trustworthy map.
    """
    settings = settings or FitSettings()
    with one_blas_thread():
        evidence = gather(recordings, settings, tell)
        tell("Solving", None)
        return conclude(evidence, [shortened(samples) for samples in recordings])


def gather(recordings: Sequence[Samples], settings: FitSettings, tell: Progress = silent) -> Evidence:
    """Check recordings and accumulate all their samples; see :func:`identify`."""
    if not recordings:
        raise DataError("There are no recordings to identify from: give at least one.")
    prescan = Prescan()
    for samples in recordings:
        prescan.add(samples)
    prescan.check(settings.method)
    evidence = prescan.prepare(settings)
    total = sum(len(samples) for samples in recordings)
    for samples in recordings:
        share = partial(_tell_share, tell, evidence.samples, total)
        evidence.next_recording()
        evidence.add(samples, share)
    return evidence


def score(identification: IdentifiedDrive, truth: GroundTruth) -> tuple[float, float]:
    """Return the NRMSE of psi_d and psi_q at the map's points with data within the true disc, dimensionless."""
    flux_map = identification.flux_map
    grid = flux_map.grid()
    true_psi = true_flux(truth, grid)
    known = flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= truth.i_max) & np.isfinite(true_psi).all(axis=-1)
    return nrmse(flux_map.psi[known], true_psi[known])


def _tell_share(tell: Progress, before: int, total: int, done: int) -> None:
    tell("Accumulating", (before + done) / total)
