"""What the command line and the nodes do with recorded bags: fit them, or accumulate them for a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from drive_id.analysis.painting import Painter
from drive_id.core import frames
from drive_id.core.accumulated import Accumulated
from drive_id.core.conclusion import conclude
from drive_id.core.fit_settings import FitSettings
from drive_id.core.identification import FluxMap, Identification
from drive_id.core.identify import Progress, score, silent
from drive_id.core.threads import one_blas_thread
from drive_id.files.information import check_information_output, write_information
from drive_id.files.information_name import is_information
from drive_id.files.results import PICTURE, Provenance, check_output, write_results
from drive_id.files.signals import SignalMap
from drive_id.merging import accumulate_sources
from drive_id.streaming import accumulate


@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit of bags yields.

    Parameters
    ----------
    recording : Accumulated
    identification : Identification
    provenance : Provenance
    """

    recording: Accumulated
    identification: Identification
    provenance: Provenance

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about the recording and about the fit."""
        return (*self.provenance.warnings, *self.identification.report.warnings)


def fit_bags(
    bags: Sequence[Path],
    output: Path | None,
    settings: FitSettings,
    *,
    signals: SignalMap | None = None,
    namespace: str = "",
    cluster: str = "",
    skip_bad: bool = False,
    force: bool = False,
    picture: bool = True,
    painter: Painter | None = None,
    resumable: bool = True,
    tell: Progress = silent,
) -> Fit:
    """Fit one or several bags of one drive and write the results.

    Parameters
    ----------
    bags : sequence of Path
        And information files.
    output : Path, optional
        Folder for the result files; none are written without.
    settings : FitSettings
    signals : SignalMap, optional
        Where to find the signals in bags that are not ours.
    namespace : str
        Of the drive, when a bag holds several.
    cluster : str
        Dask cluster that accumulates them, see :func:`drive_id.fleet.accumulate_on_cluster`; empty: this process.
    skip_bad : bool
        Leave out bags that cannot be used, and warn of them.
    force : bool
        Write into a folder that holds other files.
    picture : bool
        Draw the maps beside the result files.
    painter : Painter, optional
        To draw it: one that was started early is ready when it is needed.
    resumable : bool
        While long bags are read, keep a checkpoint beside the output; another call goes on from it after an interrupt.
    tell : callable, optional

    Returns
    -------
    Fit

    Raises
    ------
    DriveIdError
        Nothing is written then.
    """
    if output is not None:
        check_output(output, force=force)
    with painter or Painter(wanted=picture and output is not None) as at_work:
        gather = _gatherer(bags, cluster, skip_bad=skip_bad, output=output if resumable else None)
        begin = partial(_begin_picture, at_work) if picture and output is not None else None
        fit = _fit(gather, bags, settings, signals, namespace, tell, begin)
        if output is not None:
            tell("Writing", 0.0)
            pictures = {PICTURE: at_work.picture()} if picture else {}
            write_results(output, fit.identification, fit.provenance, force=force, pictures=pictures)
    return fit


def _fit(
    gather: Callable[..., Accumulated],
    bags: Sequence[Path],
    settings: FitSettings,
    signals: SignalMap | None,
    namespace: str,
    tell: Progress,
    on_map: Callable[[Accumulated, FitSettings, FluxMap], None] | None,
) -> Fit:
    if not any(is_information(bag) for bag in bags):  # these know their own
        settings.check_recordings(len(bags))
    with one_blas_thread(with_scipy=settings.method == "full"):
        recording = gather(bags, settings, signals=signals, namespace=namespace, tell=tell)
        tell("Solving and validating", 1.0)
        told = partial(on_map, recording, settings) if on_map else lambda _: None
        identification = conclude(recording.evidence, recording.validation, told)
    truth = recording.truth
    nrmse = score(identification, truth) if truth else None
    strange = ("None of the map lies in the disc of the recorded truth: check the scale of the currents.",)
    idle = ", ".join(settings.idle())
    unheard = (f"Method {settings.method} does not look at {idle}: choose another method, or leave it out.",)
    provenance = Provenance(
        inputs=recording.digests,
        settings=settings,
        machine=truth.machine if truth else "",
        nrmse=nrmse,
        warnings=recording.warnings
        + (unheard if idle else ())
        + (strange if nrmse and not np.isfinite(nrmse).all() else ()),
    )
    return Fit(recording, identification, provenance)


def accumulate_bags(
    bags: Sequence[Path],
    output: Path,
    settings: FitSettings,
    *,
    signals: SignalMap | None = None,
    namespace: str = "",
    cluster: str = "",
    skip_bad: bool = False,
    tell: Progress = silent,
) -> Accumulated:
    """Accumulate bags of one drive, each by itself, and write an information file; parameters as of :func:`fit_bags`.

    Raises
    ------
    DriveIdError
        Nothing is written then.
    """
    check_information_output(output)
    gather = _gatherer(bags, cluster, skip_bad=skip_bad, apart=True)
    with one_blas_thread(with_scipy=settings.method == "full"):
        accumulated = gather(bags, settings, signals=signals, namespace=namespace, tell=tell)
    tell("Writing", 0.0)
    write_information(output, accumulated)
    return accumulated


def _gatherer(
    bags: Sequence[Path], cluster: str, *, skip_bad: bool, apart: bool = False, output: Path | None = None
) -> Callable[..., Accumulated]:
    """Return what turns bags into evidence: all of them together, or each by itself, here or on a cluster."""
    if cluster:
        from drive_id.fleet import accumulate_on_cluster  # noqa: PLC0415  # asyncio takes a while

        return partial(accumulate_on_cluster, cluster=cluster, skip_bad=skip_bad)
    if apart or skip_bad or any(is_information(bag) for bag in bags):
        return partial(accumulate_sources, skip_bad=skip_bad)
    if output is None:
        return accumulate
    return partial(accumulate, checkpoint=output.absolute().with_name(f".{output.absolute().name}.checkpoint"))


def _begin_picture(painter: Painter, recording: Accumulated, settings: FitSettings, flux_map: FluxMap) -> None:
    """Begin to draw the identified maps with the trajectory over them."""
    i_dq = np.concatenate([frames.to_dq(part.i_abc, part.angle) for part in recording.validation])
    name = f"{recording.truth.machine}, " if recording.truth else ""
    painter.begin(flux_map, recording.evidence.i_max, i_dq, f"{name}method {settings.method}")
