"""Many sources on many processes: a Dask cluster accumulates each where a worker is free, and merges pairs of results.

The cluster is one that is running, given by its address, or processes that are started on this machine. Only running
sums travel, some MB per bag. The result does not depend on the cluster: the order of merging is that of
:func:`~drive_id.fitting.sources.pairwise`, and Dask repeats what a lost worker had done.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import struct
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import drive_id
from drive_id.core.accumulation.accumulated import Accumulated
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ClusterError, ConfigurationError, DriveIdError
from drive_id.fitting.sources import Job, Part, Sources, pairwise, part_of, radius_of, with_radius
from drive_id.types import Progress, silent

if TYPE_CHECKING:
    from distributed import Client, Future

_POLL = 0.05
"""Between two looks at the cluster, s."""

LOCAL = "local"
CONNECT_TIME = 10.0
"""How long to wait for a scheduler, s."""

START_TIME = 30.0
"""How long to wait for its first worker, s."""

PATIENCE = 60.0
"""How long to wait for a worker when all have gone, s."""

_LONGEST_GREETING = 1 << 20
"""Bytes. A Dask server speaks first: the length of its greeting as 8 bytes, then the greeting."""

_LOCAL_OPTIONS: dict[str, Any] = {
    "threads_per_worker": 1,
    "host": "127.0.0.1",
    "dashboard_address": None,
    "worker_dashboard_address": None,
    "scheduler_kwargs": {"dashboard": False, "dashboard_address": "127.0.0.1:0"},  # None alone means port 8787
    "silence_logs": logging.CRITICAL,
}
_LOGGERS = ("distributed", "distributed.client", "tornado.application")


def accumulate_on_cluster(sources: Sources, settings: FitSettings, tell: Progress = silent) -> Accumulated:
    """Accumulate bags and information files on a Dask cluster.

    Parameters
    ----------
    sources : Sources
        Every worker must find them under these names.
    settings : FitSettings
        Without i_max, it is that of the first information file, or else of the recorded references.
    tell : callable, optional

    Raises
    ------
    ClusterError
        When Dask is not installed, or the cluster cannot be reached or is lost.
    DriveIdError
        When a source cannot be used, or information files were accumulated differently.
    """
    if local_workers(sources.cluster) is None:  # its workers may run in other folders
        sources = replace(sources, paths=[path.absolute() for path in sources.paths])
    job = Job(settings, sources, threads=False)  # a worker's thread is a core's
    paths = sources.paths
    tell("Connecting to workers", None)
    with connected(sources.cluster, len(paths)) as client:
        if settings.i_max is None:
            asked = [client.submit(radius_of, path, job, pure=False) for path in paths]
            radii: dict[int, float | DriveIdError | None] = {}
            for number, radius in _results(client, asked, paths):
                radii[number] = radius
                tell("Reading references", len(radii) / len(paths))
            job = with_radius(job, [radii[number] for number in range(len(paths))])
        return _accumulated(client, job, tell)


def _accumulated(client: Client, job: Job, tell: Progress) -> Accumulated:
    tell("Accumulating", 0.0)
    paths = job.sources.paths
    parts = [client.submit(part_of, path, job.of(number), pure=False) for number, path in enumerate(paths)]
    refusals = [client.submit(_refused, part, pure=False) for part in parts]
    whole = pairwise(parts, partial(client.submit, Part.merged, pure=False))
    del parts  # so that the cluster can forget what is merged
    for done, (_, refused) in enumerate(_results(client, refusals, paths), start=1):
        if refused and not job.sources.skip_bad:
            raise refused[0]
        tell("Accumulating", done / len(paths))
    ((_, part),) = _results(client, [whole], paths[:1])
    found: Accumulated = part.result(job.settings)
    return found


def _refused(part: Part) -> tuple[DriveIdError, ...]:
    return part.refused


def _results(client: Client, futures: list[Future[Any]], sources: Sequence[Path]) -> Iterator[tuple[int, Any]]:
    """Yield number and result of futures as they complete; the list is emptied, so that Dask can forget them.

    Raises
    ------
    ClusterError
        When the cluster is lost, or a source kills one worker after another.
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
                raise ClusterError(
                    f"{sources[k]} killed one worker after another: give the workers more memory, or leave it out."
                ) from error
            if isinstance(result, CancelledError):
                raise lost() from result
            yield k, result


def local_workers(cluster: str) -> int | None:
    """Return how many processes to start on this machine; None when the cluster is an address.

    Raises
    ------
    ConfigurationError
        When the text is neither.
    """
    name, colon, count = cluster.partition(":")
    if name == LOCAL and not colon:
        return len(os.sched_getaffinity(0))
    if name == LOCAL:
        if not count.isdecimal() or int(count) < 1:
            raise ConfigurationError(
                f"--dask {cluster} does not say how many workers to start: write local or local:N."
            )
        return int(count)
    _host_and_port(cluster)
    return None


@contextmanager
def connected(cluster: str, most_workers: int) -> Iterator[Client]:
    """Connect to a cluster, or start one of at most ``most_workers`` processes that ends with the context.

    Parameters
    ----------
    cluster : str
        Address of a scheduler, or ``local`` or ``local:N``.
    most_workers : int

    Raises
    ------
    ClusterError
        When Dask is not installed, or the cluster cannot be reached or used.
    """
    try:
        import dask.config  # noqa: PLC0415
        from distributed import Client, LocalCluster  # noqa: PLC0415  # slow to import, and not for everyone
    except ImportError as error:
        raise ClusterError(
            "Dask is not installed, and --dask needs it: pip install 'distributed>=2024.1', or leave out --dask."
        ) from error
    workers = local_workers(cluster)
    with ExitStack() as stack:
        stack.enter_context(_silence())
        if workers is None:
            _reach(cluster)
            try:
                client = stack.enter_context(Client(cluster, timeout=CONNECT_TIME, set_as_default=False))
            except (OSError, ValueError) as error:
                raise _absent(cluster) from error
            _check_workers(client, cluster)
        else:
            scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="drive_id-"))
            quiet = {"temporary-directory": scratch, "distributed.scheduler.http.routes": []}
            stack.enter_context(dask.config.set(quiet))
            count = min(workers, most_workers)
            try:
                with _undisturbed():
                    local = LocalCluster(n_workers=count, local_directory=scratch, **_LOCAL_OPTIONS)
                    stack.enter_context(local)
            except (RuntimeError, OSError, TimeoutError, asyncio.TimeoutError) as error:
                raise ClusterError(
                    f"{count} workers did not start on this machine ({str(error).rstrip('.') or repr(error)}): "
                    "ask for fewer by --dask local:N, or make room in memory and on the disk."
                ) from error
            client = stack.enter_context(Client(local, set_as_default=False))
        yield client


def watch(client: Client, alive: float) -> float:
    """Return when workers were last seen, in the time of :func:`time.monotonic`.

    Raises
    ------
    ClusterError
        When there have been none for :data:`PATIENCE`, or the scheduler is gone.
    """
    if client.status not in ("running", "connecting"):
        raise lost()
    if client.status == "running" and client.scheduler_info()["workers"]:
        return time.monotonic()
    if time.monotonic() - alive > PATIENCE:
        raise lost()
    return alive


def lost() -> ClusterError:
    """Return the error for a lost cluster."""
    return ClusterError("The Dask cluster was lost during the fit: restart it and repeat.")


def software() -> str:
    """Return the version of drive_id in this process."""
    return drive_id.__version__


def _host_and_port(cluster: str) -> tuple[str, int]:
    try:
        parts = urlsplit(cluster if "://" in cluster else f"tcp://{cluster}")
        if parts.scheme in ("tcp", "tls") and parts.hostname and parts.port:
            return parts.hostname, parts.port
    except ValueError:
        pass  # not a port number
    raise ConfigurationError(
        f"--dask {cluster} is not the address of a Dask scheduler: write tcp://HOST:PORT, or local for workers here."
    )


def _reach(cluster: str) -> None:
    """Probe the port first: Dask waits long for a closed port, and forever for another service."""
    try:
        with socket.create_connection(_host_and_port(cluster), timeout=CONNECT_TIME) as knocking:
            if cluster.startswith("tls"):
                return  # encrypted from the first byte
            (length,) = struct.unpack("<Q", knocking.recv(8, socket.MSG_WAITALL))
    except (OSError, struct.error) as error:
        raise _absent(cluster) from error
    if length > _LONGEST_GREETING:
        raise _absent(cluster)


def _absent(cluster: str) -> ClusterError:
    return ClusterError(
        f"There is no Dask scheduler at {cluster}: check the address, or start workers here by --dask local."
    )


def _check_workers(client: Client, cluster: str) -> None:
    """Refuse a cluster without workers, or with another version of drive_id."""
    try:
        client.wait_for_workers(1, timeout=START_TIME)
    except (TimeoutError, asyncio.TimeoutError) as error:
        raise ClusterError(
            f"The Dask scheduler at {cluster} has no workers: start some, with 'dask worker {cluster}'."
        ) from error
    for worker, version in client.run(software, on_error="return").items():
        if version != drive_id.__version__:
            has = f"drive_id {version}" if isinstance(version, str) else f"no drive_id that runs ({version!r:.100})"
            raise ClusterError(
                f"The Dask worker {worker} has {has}, and here is {drive_id.__version__}: install the same there."
            )


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Defer Ctrl-C until the workers have started: it would leave half of them running. Workers never receive it.

    Threads and processes that are started inherit the blocked signal.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    resource_tracker.ensure_running()  # would unblock it later
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))  # if another thread takes it
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler or signal.SIG_DFL)
    if came:
        raise KeyboardInterrupt


@contextmanager
def _silence() -> Iterator[None]:
    """Silence Dask's log: we report errors in a sentence, and Dask repairs the rest itself."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
