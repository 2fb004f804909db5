"""Read recordings on the workers of a Dask cluster, whose scheduler runs somewhere already."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import replace

from drive_id.errors import ConfigurationError, WorkerError
from drive_id.fitting.sources import Sources

_PATIENCE = 10.0
"""Time for the scheduler to answer, s; one on this machine takes 10 ms. Dask's own, 30 s, seem like a hang."""


@contextmanager
def on_dask(sources: Sources, address: str) -> Iterator[Sources]:
    """Give the sources as they are read by the workers of a cluster; its scheduler repeats what a lost worker had.

    Raises ConfigurationError without the extra ``dask`` or an answer, and WorkerError when the cluster gives up.
    """
    try:
        import distributed  # noqa: PLC0415  # an extra
    except ImportError as error:
        raise ConfigurationError("--dask needs the package distributed: pip install 'drive_id[dask]'.") from error
    try:
        client = distributed.Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            f"No Dask scheduler answers at {address} within {_PATIENCE:g} s: check the address, and start one with "
            "'dask scheduler'."
        ) from error
    with client:
        try:
            threads = client.nthreads()
            client.run(exec, "import drive_id")  # a worker that cannot would end at its first task, and we would wait
            workers = sources.workers if sources.workers > 1 else max(1, sum(threads.values()))
            yield replace(sources, workers=workers, executor=client.get_executor())
        except ModuleNotFoundError as error:
            raise ConfigurationError(
                f"A worker of the Dask cluster at {address} has no {error.name}: install drive_id there."
            ) from error
        except distributed.KilledWorker as error:
            raise WorkerError(f"The Dask cluster at {address} has given up: {error}") from error
        except CancelledError as error:
            raise WorkerError(f"The Dask scheduler at {address} has ended: start it, and this, again.") from error
