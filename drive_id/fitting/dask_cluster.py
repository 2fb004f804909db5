"""A Dask cluster to work on: one that is there, by its address, or some processes on this machine."""

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
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import drive_id
from drive_id.errors import ConfigurationError, FleetError

if TYPE_CHECKING:
    from distributed import Client

LOCAL = "local"
CONNECT_TIME = 10.0
"""How long to wait for a scheduler, s."""

START_TIME = 30.0
"""How long to wait for its first worker, s."""

PATIENCE = 60.0
"""How long to wait for a worker when all have gone, s."""

_LONGEST_GREETING = 1 << 20
"""A Dask server speaks first: the length of its greeting, in 8 bytes, and the greeting."""

_LOCAL_OPTIONS: dict[str, Any] = {
    "threads_per_worker": 1,
    "host": "127.0.0.1",
    "dashboard_address": None,
    "worker_dashboard_address": None,
    "scheduler_kwargs": {"dashboard": False, "dashboard_address": "127.0.0.1:0"},  # None alone means port 8787
    "silence_logs": logging.CRITICAL,
}
_LOGGERS = ("distributed", "distributed.client", "tornado.application")


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
    """Connect to a cluster; one of our own, of at most ``most_workers`` processes, is ended at last.

    Parameters
    ----------
    cluster : str
        Address of a scheduler, or ``local`` or ``local:N``.
    most_workers : int

    Raises
    ------
    FleetError
        When Dask is not installed, or there is no such cluster, or it cannot do our work.
    """
    try:
        import dask.config  # noqa: PLC0415
        from distributed import Client, LocalCluster  # noqa: PLC0415  # slow to import, and not for everyone
    except ImportError as error:
        raise FleetError(
            "Dask is not installed, and --dask needs it: pip install 'distributed>=2024.1', or work without --dask."
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
            with _undisturbed():
                local = LocalCluster(n_workers=min(workers, most_workers), local_directory=scratch, **_LOCAL_OPTIONS)
                stack.enter_context(local)
            client = stack.enter_context(Client(local, set_as_default=False))
        yield client


def watch(client: Client, alive: float) -> float:
    """Return when workers were last there, in the time of :func:`time.monotonic`.

    Raises
    ------
    FleetError
        When there have been none for long, or the scheduler is gone.
    """
    if client.status not in ("running", "connecting"):
        raise lost()
    if client.status == "running" and client.scheduler_info()["workers"]:
        return time.monotonic()
    if time.monotonic() - alive > PATIENCE:
        raise lost()
    return alive


def lost() -> FleetError:
    """Return the error of a cluster that went away."""
    return FleetError("The Dask cluster was lost in the middle of the work: start it again and repeat.")


def software() -> str:
    """Return the version of drive_id in this process."""
    return drive_id.__version__


def _host_and_port(cluster: str) -> tuple[str, int]:
    try:
        parts = urlsplit(cluster if "://" in cluster else f"tcp://{cluster}")
        if parts.scheme in ("tcp", "tls") and parts.hostname and parts.port:
            return parts.hostname, parts.port
    except ValueError:
        pass  # a port that is none
    raise ConfigurationError(
        f"--dask {cluster} is no address of a Dask scheduler: write tcp://HOST:PORT, or local to start workers here."
    )


def _reach(cluster: str) -> None:
    """Knock at the port first: Dask tries long where nobody is, and waits for ever where somebody else is."""
    try:
        with socket.create_connection(_host_and_port(cluster), timeout=CONNECT_TIME) as knocking:
            if cluster.startswith("tls"):
                return  # encrypted from the first byte
            (length,) = struct.unpack("<Q", knocking.recv(8, socket.MSG_WAITALL))
    except (OSError, struct.error) as error:
        raise _absent(cluster) from error
    if length > _LONGEST_GREETING:
        raise _absent(cluster)


def _absent(cluster: str) -> FleetError:
    return FleetError(
        f"There is no Dask scheduler at {cluster}: check the address, or start workers here by --dask local."
    )


def _check_workers(client: Client, cluster: str) -> None:
    """Refuse a cluster without workers, or with workers that cannot do this work."""
    try:
        client.wait_for_workers(1, timeout=START_TIME)
    except (TimeoutError, asyncio.TimeoutError) as error:
        raise FleetError(
            f"The Dask scheduler at {cluster} has no workers: start some, with 'dask worker {cluster}'."
        ) from error
    for worker, version in client.run(software, on_error="return").items():
        if version != drive_id.__version__:
            has = f"drive_id {version}" if isinstance(version, str) else f"no drive_id that runs ({version!r:.100})"
            raise FleetError(
                f"The Dask worker {worker} has {has}, and here is {drive_id.__version__}: install the same there."
            )


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Let Ctrl-C wait until the workers have started, for it would leave half of them, and never come to the workers.

    A signal that is blocked here is blocked in the threads and processes that are started.
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
    """Keep Dask from telling what we tell in a sentence, or what it mends itself."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
