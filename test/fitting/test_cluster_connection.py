"""Clusters that are not there, or cannot do our work: one sentence, soon."""

from __future__ import annotations

import logging
import os
import signal
import socket
import socketserver
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from threading import Thread
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from dask_processes import own_cluster

from drive_id.errors import ClusterError, ConfigurationError
from drive_id.fitting import cluster
from drive_id.fitting.cluster import connected, local_workers

pytest.importorskip("distributed", reason="the extra 'fleet' is not installed")


def refused(address: str) -> str:
    with pytest.raises(ClusterError) as caught, connected(address, 1):
        pass
    return str(caught.value)


def test_how_many_processes():
    assert local_workers("local") == len(os.sched_getaffinity(0))
    assert local_workers("local:3") == 3
    for address in ("tcp://localhost:8786", "localhost:8786", "tls://[::1]:8786"):
        assert local_workers(address) is None


@pytest.mark.parametrize("text", ["local:", "local:0", "local:-1", "local:many", "local:1.5"])
def test_no_count_of_processes(text):
    with pytest.raises(ConfigurationError) as caught:
        local_workers(text)
    assert str(caught.value) == f"--dask {text} does not say how many workers to start: write local or local:N."


@pytest.mark.parametrize("text", ["", "localhost", "http://localhost:8786", "tcp://:8786", "localhost:port", "a b:1:2"])
def test_no_address(text):
    with pytest.raises(ConfigurationError, match=r"is not the address of a Dask scheduler: write tcp://HOST"):
        local_workers(text)


def test_nobody_there():
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))  # and does not listen
        address = f"tcp://127.0.0.1:{held.getsockname()[1]}"
        start = time.monotonic()
        said = refused(address)
    assert said == (
        f"There is no Dask scheduler at {address}: check the address, or start workers here by --dask local."
    )
    assert time.monotonic() - start < 5.0


class Stranger(socketserver.BaseRequestHandler):
    """Greets, and then listens."""

    greeting = b""

    def handle(self):
        self.request.sendall(self.greeting)
        self.request.recv(1)


@pytest.mark.parametrize("greeting", [b"", b"SSH-2.0-OpenSSH_9.6\r\n", b"HTTP"])
def test_somebody_else_there(greeting, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIME", 0.5)
    handler = type("Handler", (Stranger,), {"greeting": greeting})
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), handler) as server:
        Thread(target=server.serve_forever).start()
        address = f"127.0.0.1:{server.server_address[1]}"
        said = refused(address)
        server.shutdown()
    assert said.startswith(f"There is no Dask scheduler at {address}: ")


def test_a_scheduler_without_workers(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "START_TIME", 0.5)
    with own_cluster(tmp_path, workers=0) as found:
        address = found.address
        said = refused(address)
    assert said == f"The Dask scheduler at {address} has no workers: start some, with 'dask worker {address}'."


def test_workers_of_another_version(tmp_path, monkeypatch):
    with own_cluster(tmp_path, workers=1) as found:
        monkeypatch.setattr("drive_id.__version__", "9.9")
        said = refused(found.address)
    assert said.endswith("and here is 9.9: install the same there.")


def test_workers_that_die_while_they_start(tmp_path, monkeypatch):
    from dask import config

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with config.set({"distributed.worker.preload": ["import os; os._exit(3)"]}):
        said = refused("local:1")
    assert said.startswith("1 workers did not start on this machine (")
    assert said.endswith("make room in memory and on the disk.")
    assert not list(tmp_path.iterdir())


def test_without_dask(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    said = refused("local:1")
    assert said == (
        "Dask is not installed, and --dask needs it: pip install 'distributed>=2024.1', or leave out --dask."
    )


def test_nothing_is_left_of_processes_of_our_own(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    levels = [logging.getLogger(name).level for name in ("distributed", "distributed.client")]
    with connected("local:3", most_workers=2) as client:
        pids = client.run(os.getpid)
        assert len(pids) == 2
        assert os.getpid() not in pids.values()
        dashboard = client.dashboard_link
        with pytest.raises(HTTPError):
            urlopen(dashboard)
        assert "127.0.0.1" in dashboard
        assert ":8787" not in dashboard
    assert not [pid for pid in pids.values() if Path(f"/proc/{pid}").exists()]
    assert not list(tmp_path.iterdir())
    assert [logging.getLogger(name).level for name in ("distributed", "distributed.client")] == levels


def test_an_interrupt_while_workers_start_waits_for_them():
    """And ends them; it comes to the whole group, as Ctrl-C does."""
    code = """
import drive_id.fitting.cluster as cluster
print("go", flush=True)
try:
    with cluster.connected("local:2", 2):
        print("connected", flush=True)
        input()
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""
    command = [sys.executable, "-c", code]
    process = subprocess.Popen(
        command, start_new_session=True, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    with process:
        assert process.stdout.readline() == "go\n"
        time.sleep(1.5)
        os.killpg(process.pid, signal.SIGINT)
        out, _ = process.communicate(timeout=120)
    assert out.splitlines()[-1] == "interrupted"
    assert set(out.splitlines()) <= {"connected", "interrupted"}
