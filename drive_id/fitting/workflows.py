"""What the command line and the nodes do with recorded bags: fit them, or accumulate them for a fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from drive_id.core.accumulation.accumulated import Accumulated
from drive_id.core.fit_settings import FitSettings
from drive_id.core.methods.registry import method_named
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identification import Identification
from drive_id.core.result.identify import score
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.results.folder import Provenance, check_output, write_results
from drive_id.files.results.information import check_information_output, write_information
from drive_id.files.results.information_name import is_information
from drive_id.fitting.merging import accumulate_sources
from drive_id.fitting.streaming import accumulate
from drive_id.types import Progress, Samples, silent

Draw = Callable[[Identification, Sequence[Samples], str], Mapping[str, bytes]]
"""Returns pictures by file name, of a result, excerpts of its samples, and the machine's name, empty if unknown."""


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
    draw: Draw | None = None,
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
        Dask cluster that accumulates them, see ``accumulate_on_cluster``; empty: this process.
    skip_bad : bool
        Leave out bags that cannot be used, and warn of them.
    force : bool
        Write into a folder that holds other files.
    draw : callable, optional
        Makes the pictures beside the result files, see :data:`Draw`.
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
    gather = _gatherer(bags, cluster, skip_bad=skip_bad, output=output if resumable else None)
    fit = _fit(gather, bags, settings, signals, namespace, tell)
    if output is not None:
        tell("Writing", None)
        pictures = draw(fit.identification, fit.recording.validation, fit.provenance.machine) if draw else {}
        write_results(output, fit.identification, fit.provenance, force=force, pictures=pictures)
    return fit


def _fit(
    gather: Callable[..., Accumulated],
    bags: Sequence[Path],
    settings: FitSettings,
    signals: SignalMap | None,
    namespace: str,
    tell: Progress,
) -> Fit:
    if not any(is_information(bag) for bag in bags):  # these know their own
        settings.check_recordings(len(bags))
    with one_blas_thread(with_scipy=method_named(settings.method).windows):
        recording = gather(bags, settings, signals=signals, namespace=namespace, tell=tell)
        tell("Solving", None)
        identification = conclude(recording.evidence, recording.validation)
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
    with one_blas_thread(with_scipy=method_named(settings.method).windows):
        accumulated = gather(bags, settings, signals=signals, namespace=namespace, tell=tell)
    tell("Writing", None)
    write_information(output, accumulated)
    return accumulated


def _gatherer(
    bags: Sequence[Path], cluster: str, *, skip_bad: bool, apart: bool = False, output: Path | None = None
) -> Callable[..., Accumulated]:
    """Return what turns bags into evidence: all of them together, or each by itself, here or on a cluster."""
    if cluster:
        from drive_id.fitting.cluster import accumulate_on_cluster  # noqa: PLC0415  # asyncio takes a while

        return partial(accumulate_on_cluster, cluster=cluster, skip_bad=skip_bad)
    if apart or skip_bad or any(is_information(bag) for bag in bags):
        return partial(accumulate_sources, skip_bad=skip_bad)
    if output is None:
        return accumulate
    return partial(accumulate, checkpoint=output.absolute().with_name(f".{output.absolute().name}.checkpoint"))
