"""Many bags on many processes: Dask accumulates each where a worker is free, and merges pairs of results as they come.

Only sums travel, some MB for each bag. Which worker does what changes nothing: the order of merging is that of
:func:`drive_id.fitting.merging.pairwise`, and Dask does again what a worker that died had done.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drive_id.core.accumulation.accumulated import Accumulated
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import DriveIdError, FleetError
from drive_id.files.messages.signals_file import SignalMap
from drive_id.fitting.dask_cluster import connected, local_workers, lost, watch
from drive_id.fitting.merging import Job, Part, check_sources, pairwise, part_of, radius_of, with_radius
from drive_id.types import Progress, silent

if TYPE_CHECKING:
    from distributed import Client, Future

_POLL = 0.05


def accumulate_on_cluster(
    sources: Sequence[Path],
    settings: FitSettings,
    cluster: str,
    *,
    signals: SignalMap | None = None,
    namespace: str = "",
    skip_bad: bool = False,
    tell: Progress = silent,
) -> Accumulated:
    """Accumulate bags and information files on a Dask cluster; the result does not depend on the cluster.

    Parameters
    ----------
    sources : sequence of Path
        Every worker must find them under these names.
    settings : FitSettings
        Without i_max, the radius is that of the first information file, or else of the recorded references.
    cluster : str
        Address of a scheduler, or ``local`` or ``local:N`` for N processes on this machine.
    signals : SignalMap, optional
    namespace : str
    skip_bad : bool
        Leave out sources that cannot be used, and warn of them.
    tell : callable, optional

    Raises
    ------
    FleetError
        When Dask is not installed, or the cluster is not there or is lost.
    DriveIdError
        When a source cannot be used, or information files were accumulated differently.
    """
    check_sources(sources)
    if local_workers(cluster) is None:  # its workers may run in other folders
        sources = [source.absolute() for source in sources]
    job = Job(settings, signals, namespace, named=len(sources) > 1, threads=False)  # a worker's thread is a core's
    tell("Connecting to workers", None)
    with connected(cluster, len(sources)) as client:
        if job.settings.i_max is None:
            asked = [client.submit(radius_of, source, job, pure=False) for source in sources]
            radii: dict[int, float | DriveIdError | None] = {}
            for number, radius in _results(client, asked, sources):
                radii[number] = radius
                tell("Reading references", len(radii) / len(sources))
            job = with_radius(job, sources, [radii[number] for number in range(len(sources))], skip_bad=skip_bad)
        return _accumulated(client, sources, job, skip_bad, tell)


def _accumulated(client: Client, sources: Sequence[Path], job: Job, skip_bad: bool, tell: Progress) -> Accumulated:
    tell("Accumulating", 0.0)
    parts = [client.submit(part_of, source, job.of(number), pure=False) for number, source in enumerate(sources)]
    refusals = [client.submit(_refused, part, pure=False) for part in parts]
    whole = pairwise(parts, partial(client.submit, Part.merged, pure=False))
    del parts  # what is merged is not kept
    for done, (_, refused) in enumerate(_results(client, refusals, sources), start=1):
        if refused and not skip_bad:
            raise refused[0]
        tell("Accumulating", done / len(sources))
    ((_, part),) = _results(client, [whole], sources[:1])
    found: Accumulated = part.result(job.settings)
    return found


def _refused(part: Part) -> tuple[DriveIdError, ...]:
    return part.refused


def _results(client: Client, futures: list[Future[Any]], sources: Sequence[Path]) -> Iterator[tuple[int, Any]]:
    """Yield number and result of futures as they are done; the list is emptied, so that Dask can forget them.

    Raises
    ------
    FleetError
        When the cluster is lost, or a source ends one worker after the other.
    """
    from distributed import CancelledError, KilledWorker, as_completed  # noqa: PLC0415  # slow, and not for everyone

    number = {future.key: k for k, future in enumerate(futures)}
    waiting = as_completed(futures, loop=client.loop, with_results=True)
    futures.clear()
    alive = time.monotonic()
    while not waiting.is_empty():
        if not waiting.has_ready():
            time.sleep(_POLL)
            alive = watch(client, alive)
        for future, result in waiting.next_batch(block=False):
            k = number[future.key]
            if future.status == "error":
                _, error, _ = result
                if not isinstance(error, KilledWorker):
                    raise error
                raise FleetError(
                    f"{sources[k]} ended one worker after the other: give the workers more memory, or leave it out."
                ) from error
            if isinstance(result, CancelledError):
                raise lost() from result
            yield k, result
