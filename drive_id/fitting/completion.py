"""From an identified drive to a result: what the shaft tells, and what is known of the experiment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.origins import METHODS, ORIGINS
from drive_id.common.temperature import REFERENCE_TEMPERATURE
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.result.identify import score
from drive_id.core.result.mechanics import with_mechanics
from drive_id.core.result.torque import with_torque
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.results.identification import Provenance
from drive_id.fitting.result import Identification
from drive_id.types import GroundTruth, Samples

_YEAR_2000 = 946_684_800_000_000_000
"""ns; earlier stamps are not times of day."""

_LARGE_FLUX = 10.0
"""Flux linkage, Wb, beyond that of most machines: slow direct drives on 400 V reach 3, and are read in right units."""


def completed(
    drive: IdentifiedDrive,
    settings: FitSettings,
    *,
    excerpts: Sequence[Samples],
    duration: float,
    last_stamp: int,
    truth: GroundTruth | None = None,
    signals: SignalMap | None = None,
    inputs: Mapping[str, str] | None = None,
    warnings: tuple[Message, ...] = (),
) -> Identification:
    """Return the result of a fit: what torque and motion of the shaft tell, and what is known of the experiment.

    The range of speeds is that of the excerpts, the drive is scored against the truth, and the signals know the pole
    pairs where the recorded angle is mechanical. Duration in s, last stamp in ns; inputs are files and their sha256. To
    the warnings about the recording come those of settings that the method ignores, and of a truth that has nothing in
    common with the map.
    """
    recorded = truth.pole_pairs if truth else signals.resolver.pole_pairs if signals else None
    pole_pairs = settings.pole_pairs or recorded
    turning = drive.origin.turning
    if turning:
        drive = with_mechanics(with_torque(drive, excerpts, pole_pairs), excerpts, pole_pairs, settings)
    if drive.torque is not None or (drive.mechanics is not None and drive.mechanics.gain is not None):
        drive = replace(drive, statements=tuple(said for said in drive.statements if said.code != "common_gain"))
    nrmse = score(drive, truth) if truth and turning else None
    referred = "temperatures" not in ORIGINS[settings.method].ignores and (
        bool(settings.temperatures) or any(part.winding_temperature is not None for part in excerpts)
    )
    when = datetime.fromtimestamp(last_stamp * 1e-9, timezone.utc) if last_stamp > _YEAR_2000 else None
    warnings += (*_ignored(settings), *_implausible(drive, settings.pole_pairs, recorded))
    if nrmse and not np.isfinite(nrmse).all():
        warnings += (Message("not_scored"),)
    speeds = [float(end) for part in excerpts for end in (part.speed.min(), part.speed.max())]
    provenance = Provenance(
        inputs=inputs or {},
        settings=settings,
        machine=settings.machine or (truth.machine if truth else ""),
        nrmse=nrmse,
        warnings=warnings,
        pole_pairs=pole_pairs,
        u_dc=_link(settings, truth, excerpts),
        speed_range=(min(speeds), max(speeds)) if speeds else None,
        duration=duration,
        date=(when or datetime.now(timezone.utc)).isoformat(timespec="seconds"),
        temperature=REFERENCE_TEMPERATURE if referred else None,
        last_stamp=max(last_stamp, 0),
    )
    return Identification(drive, provenance, tuple(excerpts), truth, last_stamp)


def _implausible(drive: IdentifiedDrive, given: int | None, recorded: int | None) -> Iterator[Message]:
    """Yield what no machine has, or contradicts the recording: a wrong unit or setting, which fits as well."""
    flux_map = drive.flux_map
    largest = float(np.abs(flux_map.psi[flux_map.inside]).max(initial=0.0))
    if largest > _LARGE_FLUX:
        yield Message("large_flux", flux=largest, voltage=2 * np.pi * 50 * largest)
    if given and recorded and given != recorded:
        yield Message("other_pole_pairs", given=given, recorded=recorded)


def _link(settings: FitSettings, truth: GroundTruth | None, excerpts: Sequence[Samples]) -> float | None:
    """Return the DC-link voltage, V: set, of the simulation, or the median of what was recorded; None if unknown."""
    told = truth.details.get("u_dc") if truth else None
    if given := settings.u_dc_reference or (settings.u_dc[0] if settings.u_dc else None) or told:
        return float(given)
    links = [part.dc_link_voltage for part in excerpts if part.dc_link_voltage is not None]
    links = [known for link in links if (known := link[np.isfinite(link)]).size]
    return float(np.median(np.concatenate(links))) if links else None


def _ignored(settings: FitSettings) -> tuple[Message, ...]:
    """Return a warning of settings that the method ignores, if there are any."""
    idle = settings.idle()
    if not idle:
        return ()
    others = [name for name in METHODS if not set(idle) & set(ORIGINS[name].ignores)]
    methods = " or ".join(", ".join(others).rsplit(", ", 1)) if others else None
    return (
        Message("ignored", method=settings.method, settings=", ".join(idle), several=len(idle) > 1, others=methods),
    )
