"""A Dask cluster of processes of our own, which a test may kill."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class OwnCluster:
    """A scheduler and workers without nannies, so that one that dies stays dead."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file = folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--port", "0", "--no-show", "--scheduler-file", self._file)
        self.workers: list[subprocess.Popen] = []
        self._started = 0
        self.address = str(self._wait()["address"])

    def _start(self, what: str, *arguments: object) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", *map(str, arguments)]
        with (self._folder / f"{what}.log").open("a") as log:
            return subprocess.Popen(
                [*command, "--host", "127.0.0.1", "--no-dashboard"], cwd=self._folder, stdout=log, stderr=log
            )

    def _wait(self) -> dict:
        for _ in range(600):
            time.sleep(0.1)
            try:
                return json.loads(self._file.read_text())
            except (OSError, ValueError):
                continue
        raise AssertionError((self._folder / "scheduler.log").read_text())

    def keep_workers(self, count: int) -> None:
        """Start workers until so many are alive; they come last in ``workers``, which lost those that died."""
        self.workers = [worker for worker in self.workers if worker.poll() is None]
        if len(self.workers) == count:
            return
        self._started += count - len(self.workers)
        self.workers += [
            self._start(
                "worker", self.address, "--no-nanny", "--nthreads", 1, "--local-directory", self._folder / "scratch"
            )
            for _ in range(count - len(self.workers))
        ]
        log = self._folder / "worker.log"
        for _ in range(600):
            if log.read_text().count("Registered to") == self._started:
                return
            time.sleep(0.1)
        raise AssertionError(log.read_text())

    def kill(self, process: subprocess.Popen) -> None:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            if process.poll() is None:
                self.kill(process)


@contextmanager
def own_cluster(folder: Path, workers: int) -> Iterator[OwnCluster]:
    cluster = OwnCluster(folder)
    try:
        cluster.keep_workers(workers)
        yield cluster
    finally:
        cluster.close()
