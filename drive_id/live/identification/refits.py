"""Background fits of the live samples: scheduling, limit on processor time, and the last result."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.origins import ORIGINS
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.threads import interruptible
from drive_id.core.result.conclusion import Conclusion
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.resistance_error import growth
from drive_id.errors import DriveIdError
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.live_evidence import LiveEvidence, Snapshot
from drive_id.types import Progress

MOST_GROWTH = 1.25
"""Largest ratio of a request's samples to those of a fit at which the request reuses the fit's selection."""
_RENEWED_GROWTH = 1.1
"""The same ratio, above which a background fit selects its model again."""
_FEWEST_SAMPLES = 2000  # for a first provisional map: 0.2 s at 10 kHz
_LEAST_PERIOD = 1.0  # s between the starts of two fits
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Refit:
    """A finished fit of live samples."""

    settings: FitSettings
    samples: int  # number, rests not counted
    stamp: int  # of the last sample, ns
    conclusion: Conclusion
    selected: bool  # the fit selected its model itself instead of reusing an earlier selection

    @property
    def drive(self) -> IdentifiedDrive:
        """The identified drive."""
        return self.conclusion.drive

    def doubt(self, surest: tuple[int, float] | None) -> Message | None:
        """Return why R is less certain than it was from fewer samples; None if it is not."""
        fit = self.conclusion.fit
        if surest is None or fit is None or surest[0] >= self.samples:
            return None
        return growth(fit.assessment, self.drive.sigma_resistance, surest)


def moving(evidence: Evidence) -> int:
    """Return the number of samples with current: rests add nothing to a fit."""
    return evidence.samples - evidence.idle


def of_snapshot(snapshot: Snapshot, earlier: Conclusion | None) -> Refit:
    """Fit a snapshot, see :meth:`~drive_id.live.identification.live_evidence.Snapshot.conclude`."""
    conclusion = snapshot.conclude(earlier)
    evidence = snapshot.gathered.evidence
    return Refit(
        evidence.settings, moving(evidence), snapshot.join.last_stamp or 0, conclusion, selected=earlier is None
    )


RefitJob = Callable[[Progress], Refit | None]


class Refits:
    """Schedules background fits of live samples and keeps the last one; jobs run in other threads, one at a time."""

    def __init__(self, settings: IdentificationSettings, clock: Callable[[], float] = time.monotonic) -> None:
        self._share = settings.refit_share
        self._period = settings.provisional_map_period
        self.publishes = self._period > 0
        """Whether provisional maps are published."""
        self._clock = clock
        self.due = -np.inf
        """Earliest time of the next fit, s."""
        self.forget()

    def forget(self) -> None:
        """Discard the last fit when its samples are discarded."""
        self._selected: Refit | None = None
        self._latest: Refit | None = None
        self.surest: tuple[int, float] | None = None
        """Samples and standard error of R, ohm, of the fit so far whose R was the most certain."""
        self._finished = self._provisional_due = -np.inf
        self._seen = 0
        self.error = ""

    def earlier(self, settings: FitSettings, samples: int) -> Conclusion | None:
        """Return the conclusion that a fit of ``samples`` samples (rests not counted) may reuse, or None."""
        known = self._selected
        if known is None or known.settings != settings or not known.samples <= samples <= MOST_GROWTH * known.samples:
            return None
        return known.conclusion if known.conclusion.fit is not None or not ORIGINS[settings.method].windows else None

    def job(self, live: LiveEvidence) -> RefitJob | None:
        """Return a background fit if one is due; the same samples are never fitted twice."""
        now, samples = self._clock(), 0 if live.evidence is None else moving(live.evidence)
        if self._share <= 0 or now < self.due or samples < _FEWEST_SAMPLES or samples == self._seen:
            return None
        earlier = self.earlier(live.settings, samples)
        if earlier is not None and self._selected and samples <= _RENEWED_GROWTH * self._selected.samples:
            if not self.publishes or now < self._provisional_due:
                return None
        else:
            earlier = None
        self._seen = samples
        self._provisional_due = now + self._period
        return partial(self._run, live.snapshot(), earlier)

    def _run(self, snapshot: Snapshot, earlier: Conclusion | None, tell: Progress) -> Refit | None:
        start, spent = self._clock(), time.thread_time()
        try:
            with interruptible(partial(tell, "Refitting", None), alone=True):
                return of_snapshot(snapshot, earlier)
        except DriveIdError as error:
            self.error = str(error)
            return None
        except Exception as error:  # noqa: BLE001  # a bug must not end the thread silently
            _log.exception("A fit in the background failed")
            self.error = f"A fit in the background failed ({type(error).__name__}): report this as a bug."
            return None
        finally:  # also where it is cancelled
            end = self._clock()
            self.due = max(end, start + max(_LEAST_PERIOD, (time.thread_time() - spent) / self._share))

    def take(self, refit: Refit) -> None:
        """Keep a finished fit of the present samples, from the background or for a request."""
        self.error, self._finished = "", self._clock()
        self._latest = refit
        sigma = refit.drive.sigma_resistance
        if self.surest is None or sigma < self.surest[1]:
            self.surest = refit.samples, sigma
        if refit.selected:
            self._selected = refit

    def values(self) -> dict[str, str]:
        """Return the results of the last fit, for diagnostics."""
        if self._latest is None:
            return {"fit: error": self.error} if self.error else {}
        drive = self._latest.drive
        sigma = np.stack([drive.flux_map.sigma_d, drive.flux_map.sigma_q])
        flux = np.hypot(drive.flux_map.psi_d, drive.flux_map.psi_q).max()
        values = {
            "fit: samples": str(self._latest.samples),
            "fit: age [s]": f"{self._clock() - self._finished:.1f}",
            "fit: coverage": f"{drive.report.coverage:.4f}",
            "fit: resistance [ohm]": f"{drive.resistance:.6g}",
            "fit: sigma of resistance [ohm]": f"{drive.sigma_resistance:.3g}",
            "fit: median sigma of flux [%]": f"{100 * float(np.nanmedian(sigma)) / flux:.4g}",
        }
        return values | ({"fit: error": self.error} if self.error else {})
