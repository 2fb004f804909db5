"""From recordings to an identified drive."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks import samples as checks
from drive_id.core.fit_settings import FitSettings
from drive_id.core.methods.registry import method_named
from drive_id.core.numerics.bspline import Axis
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identification import Identification
from drive_id.core.validation.metrics import nrmse, true_flux
from drive_id.errors import DataError
from drive_id.types import FloatArray, GroundTruth, Progress, Samples, silent

_USUAL_QUANTILE = 0.999
_SPIKE_FACTOR = 1.2


def identify(
    recordings: Sequence[Samples], settings: FitSettings | None = None, tell: Progress = silent
) -> Identification:
    """Identify flux maps, resistance and inverter voltage error jointly from one or several recordings.

    Parameters
    ----------
    recordings : sequence of Samples
        Of the same drive; periods and speeds may differ.
    settings : FitSettings, optional
    tell : callable, optional

    Returns
    -------
    Identification

    Raises
    ------
    StandstillError, CoverageError, DataError
        When no trustworthy map can come of these samples.
    """
    settings = settings or FitSettings()
    with one_blas_thread(with_scipy=method_named(settings.method).windows):
        evidence = gather(recordings, settings, tell)
        tell("Solving and validating", 1.0)
        return conclude(evidence, recordings)


def gather(recordings: Sequence[Samples], settings: FitSettings, tell: Progress = silent) -> Evidence:
    """Check recordings and accumulate the evidence of all their samples; see :func:`identify`."""
    if not recordings:
        raise DataError("There are no recordings to identify from: give at least one.")
    checks.check_rotation(recordings)
    currents = [frames.to_dq(samples.i_abc, samples.angle) for samples in recordings]
    checks.check_trajectory(recordings, currents)
    evidence = _prepare(settings, recordings, currents)
    total = sum(len(samples) for samples in recordings)
    for samples in recordings:
        share = partial(_tell_share, tell, evidence.samples, total)
        if settings.conditions:
            evidence.next_recording()
        evidence.add(samples, share)
    return evidence


def score(identification: Identification, truth: GroundTruth) -> tuple[float, float]:
    """Return the NRMSE of psi_d and psi_q at the map's points with data within the true disc, dimensionless."""
    flux_map = identification.flux_map
    grid = flux_map.grid()
    chosen = grid[flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= truth.i_max)]
    true_psi = true_flux(truth, chosen)
    known = np.isfinite(true_psi).all(axis=1)
    return nrmse(identification.flux(chosen)[known], true_psi[known])


def _tell_share(tell: Progress, before: int, total: int, done: int) -> None:
    tell("Accumulating", (before + done) / total)


def _prepare(settings: FitSettings, recordings: Sequence[Samples], currents: Sequence[FloatArray]) -> Evidence:
    if settings.i_max is not None:
        return Evidence.within(settings, settings.i_max)
    i_dq = np.concatenate(currents)
    amplitude = np.hypot(*i_dq.T)
    usual = float(np.quantile(amplitude, _USUAL_QUANTILE))
    trusted = i_dq[amplitude <= _SPIKE_FACTOR * usual]  # a single faulty sample must not stretch the axes
    low, high = trusted.min(axis=0), trusted.max(axis=0)
    d, q = Axis(low[0], high[0], settings.splines_d), Axis(low[1], high[1], settings.splines_q)
    return Evidence(settings, d, q, _radius(recordings, usual))


def _radius(recordings: Sequence[Samples], usual: float) -> float:
    """Return the amplitude of the references, A, where all recordings have some that the currents followed.

    Otherwise what all but a few noisy samples stay below.
    """
    amplitudes = [_largest_reference(samples) for samples in recordings]
    wanted = max(amplitudes) if all(amplitudes) else 0.0
    return min(wanted, usual) if _SPIKE_FACTOR * wanted >= usual else usual


def _largest_reference(samples: Samples) -> float:
    if samples.i_dq_reference is None:
        return 0.0
    amplitude = np.hypot(*samples.i_dq_reference.T)
    return float(np.max(amplitude, initial=0.0, where=np.isfinite(amplitude)))
