#!/usr/bin/env python3
"""Run one experiment as supervisory software would: only through the services of the nodes.

Requires the nodes ``trajectory_publisher``, ``recorder`` and ``identification``, and a drive (here ``bench_simulator``)
that publishes ``phase_currents``, ``phase_voltages`` and ``resolver`` and follows ``current_reference``::

    wait until all nodes are ready and the drive publishes
    recorder/start  ->  trajectory_publisher/start  ->  wait for the end of the trajectory  ->  recorder/stop
    identification/identify from the live samples and from the recording

All names are relative: ``--ros-args -r __ns:=/drive_1`` selects the nodes of a namespace. ``--truth`` names the file
written by ``bench_simulator``; the true values are then shown next to the results.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from drive_id_msgs.msg import FluxMap
from drive_id_msgs.srv import Identify, StartRecording, StopRecording
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from rich.console import Console
from rich.table import Table
from std_srvs.srv import Trigger

from drive_id.core.validation.metrics import nrmse, true_flux
from drive_id.errors import DriveIdError
from drive_id.files.machines.ground_truth import decode_truth
from drive_id.types import GroundTruth

NODES = ("trajectory_publisher", "recorder", "identification")
IDLE, TRIPPED = "idle", "tripped"
_HEARTBEAT = 5.0  # s between reports of what is under way
_WIDTH = 200  # characters: more than the table ever takes, so that it looks the same on every terminal
REQUESTS = {  # title of the column: whether from the recording, method
    "live, joint": (False, "joint"),  # at once: its sums are accumulated already
    "live, full": (False, "full"),
    "recording, full": (True, "full"),
    "recording, psm": (True, "psm"),
}


class ExperimentError(Exception):
    """A service refused, or did not answer in time: a sentence says which, and why."""


class Supervisor(Node):
    """Calls services one after the other, each with a deadline."""

    def __init__(self, timeout: float) -> None:
        super().__init__("supervisor")
        self.timeout = timeout
        self.started = False
        """Whether there is something to stop."""
        self._names = {self.resolve_service_name(node): node for node in NODES}
        self._statuses: dict[str, DiagnosticStatus] = {}
        self._states: list[str] = []
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        kinds = {
            "recorder/start": StartRecording,
            "recorder/stop": StopRecording,
            "trajectory_publisher/start": Trigger,
            "trajectory_publisher/stop": Trigger,
            "identification/reset": Trigger,
            "identification/identify": Identify,
        }
        self._kinds = kinds
        # Not "_clients": that name is the node's own.
        self._service_clients = {name: self.create_client(kind, name) for name, kind in kinds.items()}

    def wait_until_ready(self, timeout: float) -> None:
        """Wait until all nodes offer their services and report, and the publisher hears the drive."""

        def waiting() -> str:
            missing = {name.partition("/")[0] for name, client in self._service_clients.items() if not ready(client)}
            missing |= set(NODES) - set(self._statuses)
            if missing:
                names = " and ".join(sorted(missing))
                return f"waiting for {names} (the first start compiles the numerical kernels: about 30 s)"
            status = self._statuses["trajectory_publisher"]
            return f"waiting for the drive: {status.message}" if status.level == DiagnosticStatus.WARN else ""

        def ready(client: Any) -> bool:
            return bool(client.service_is_ready())

        self.wait(lambda: not waiting(), lambda: f"still {waiting()}", waiting, timeout)

    def call(self, name: str, /, **fields: Any) -> Any:
        """Call a service and return its response, which tells of success itself."""
        future = self._service_clients[name].call_async(self._kinds[name].Request(**fields))
        node = name.partition("/")[0]
        self.wait(future.done, lambda: f"service {name} does not answer", lambda: f"{node}: {self._said(node)}")
        return future.result()

    def require(self, name: str, /, **fields: Any) -> Any:
        """Call a service that must succeed."""
        response = self.call(name, **fields)
        if not response.success:
            raise ExperimentError(f"{name}: {response.message}")
        return response

    def run_trajectory(self) -> None:
        """Start the trajectory and wait until it has ended by itself."""
        self._states.clear()
        print(f"   {self.require('trajectory_publisher/start').message}")
        started = time.monotonic()

        def ended() -> bool:
            if TRIPPED in self._states:
                raise ExperimentError(f"The trajectory was stopped: {self._said('trajectory_publisher')}")
            was_active = any(state != IDLE for state in self._states) or time.monotonic() > started + 5.0
            return bool(was_active and self._states and self._states[-1] == IDLE)

        self.wait(ended, lambda: "the trajectory does not end", lambda: self._said("trajectory_publisher"))

    def abandon(self) -> None:
        """Leave a bench at rest whatever went wrong: zero current, and a recording that can be read."""
        if not self.started:
            return
        for name in ("trajectory_publisher/stop", "recorder/stop"):
            if self._service_clients[name].service_is_ready():
                self.timeout = min(self.timeout, 5.0)
                with contextlib.suppress(ExperimentError):
                    print(f"   {name}: {self.call(name).message}")

    def wait(
        self,
        condition: Callable[[], bool],
        complaint: Callable[[], str],
        doing: Callable[[], str],
        timeout: float | None = None,
    ) -> None:
        """Spin until the condition holds, and print now and then what is under way."""
        timeout = timeout or self.timeout
        begin = told = time.monotonic()
        while not condition():
            now = time.monotonic()
            if now > begin + timeout:
                raise ExperimentError(f"After {timeout:g} s, {complaint()}.")
            if now > told + _HEARTBEAT:
                told = now
                print(f"   {now - begin:3.0f} s  {doing()}")
            rclpy.spin_once(self, timeout_sec=0.05)

    def _said(self, node: str) -> str:
        return self._statuses[node].message if node in self._statuses else "nothing has been heard of it yet"

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node = self._names.get(status.name)
            if node is None:
                continue
            self._statuses[node] = status
            if node == "trajectory_publisher":
                self._states.append({entry.key: entry.value for entry in status.values}.get("state", ""))


def run_experiment(supervisor: Supervisor, recording: str) -> tuple[Any, dict[str, Any]]:
    """Record one trajectory and identify the drive from the recording and from the live samples.

    Returns
    -------
    stopped : StopRecording.Response
    results : dict of str to Identify.Response
        Title of the column to result.
    """
    print("2. All nodes are ready: the recording is started, then the trajectory.")
    supervisor.started = True
    started = supervisor.require("recorder/start", name=recording)
    supervisor.require("identification/reset")  # live samples from here on
    supervisor.run_trajectory()
    stopped = supervisor.require("recorder/stop")
    print(f"   {stopped.message}")
    print("3. The drive is identified from the live samples and from the recording.")
    results = {}
    for title, (recorded, method) in REQUESTS.items():
        begin = time.monotonic()
        bags = [started.uri] if recorded else []
        results[title] = supervisor.require("identification/identify", bags=bags, method=method)
        print(f"   {title}: {time.monotonic() - begin:.1f} s")
    return stopped, results


def comparison(results: dict[str, Any], truth: GroundTruth | None) -> Table:
    """Lay out all results side by side, with the truth where it is known."""
    table = Table(title="The drive, identified through the services", title_justify="left")
    table.add_column("Quantity", no_wrap=True)
    for title in [*results, *(["truth"] if truth else [])]:
        table.add_column(title, justify="right", no_wrap=True)
    maps, reports = [r.flux_map for r in results.values()], [r.report for r in results.values()]
    drop = "" if truth is None else f"{truth.inverter_voltage[-1]:.4g} V"
    rows = [
        ("R", [f"{1e3 * m.resistance:.4g} mohm" for m in maps], truth and f"{1e3 * truth.resistance:.4g} mohm"),
        ("u_e", [f"{m.voltage_error:.4g} V" if m.method != "psm" else "not modelled" for m in maps], drop),
        ("MAD of i_d / i_q", [f"{r.mad_d:.3g} / {r.mad_q:.3g} A" for r in reports], ""),
        ("Disc covered", [f"{100 * r.coverage:.1f} %" for r in reports], ""),
        ("Samples used", [f"{r.samples_used} of {r.samples_read}" for r in reports], ""),
    ]
    if truth is not None:
        errors = [flux_errors(m, truth) for m in maps]
        rows.insert(2, ("NRMSE of psi_d / psi_q", [f"{100 * d:.3f} / {100 * q:.3f} %" for d, q in errors], ""))
    for name, values, true in rows:
        table.add_row(name, *values, *([true or ""] if truth else []))
    return table


def flux_errors(flux_map: FluxMap, truth: GroundTruth) -> tuple[float, float]:
    """Return the NRMSE of psi_d and psi_q of a received map within the true disc."""
    shape = len(flux_map.i_d), len(flux_map.i_q)  # row-major
    i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
    psi = np.stack([np.reshape(flux_map.psi_d, shape), np.reshape(flux_map.psi_q, shape)], axis=-1)
    chosen = np.reshape(flux_map.inside, shape) & (np.hypot(i_d, i_q) <= truth.i_max)
    true_psi = true_flux(truth, np.stack([i_d, i_q], axis=-1)[chosen])
    known = np.isfinite(true_psi).all(axis=-1)
    return nrmse(psi[chosen][known], true_psi[known])


def plain_folder(output: Path, title: str) -> Path:
    """Return the folder, by a plain name, of the result with this title."""
    return output / title.replace(", ", "_")


def read_truth(path: Path) -> GroundTruth:
    """Read what bench_simulator wrote when it was started."""
    try:
        return decode_truth(path.read_bytes(), str(path))
    except OSError as error:
        reason = error.strerror or error
        raise ExperimentError(f"The truth in {path} cannot be read ({reason}): give another --truth.") from error


def prepare_output(output: Path) -> None:
    """Make the folder for the results, and refuse one that holds some, before anything is started."""
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or error
        raise ExperimentError(f"{output} cannot be made a folder ({reason}): give another --output.") from error
    for folder in (plain_folder(output, title) for title in REQUESTS):
        if folder.exists():
            raise ExperimentError(f"{folder} exists already: remove it, or give another --output.")


def keep(results: dict[str, Any], table: Table, output: Path) -> None:
    """Write the table, move the results to their plain names, and print what the fits state."""
    with (output / "table.txt").open("w", encoding="utf-8") as file:
        Console(file=file, width=_WIDTH).print(table)
    stated: dict[str, list[str]] = {}
    for title, result in results.items():
        folder = plain_folder(output, title)
        shutil.move(result.output, folder)
        document = json.loads((folder / "identification.json").read_text(encoding="utf-8"))
        for sentence in document["statements"]:
            stated.setdefault(sentence, []).append(title)
    print_sentences("What the fits state:", stated)
    print(f"Results: {', '.join(str(plain_folder(output, title)) for title in results)}")


def print_sentences(heading: str, titles: dict[str, list[str]]) -> None:
    """Print sentences, each with the titles of the results that it stands in."""
    if titles:
        print(heading)
    for sentence, where in titles.items():
        print(f"   {'; '.join(where)}: {sentence}")


def supervise(supervisor: Supervisor, options: argparse.Namespace) -> int:
    """Run the experiment, print and keep its results, and return the exit code."""
    if options.output:
        prepare_output(options.output)
    print("1. The nodes are started.")
    supervisor.wait_until_ready(options.start_up)
    truth = read_truth(options.truth) if options.truth else None
    stopped, results = run_experiment(supervisor, options.recording)
    table = comparison(results, truth)
    Console(width=_WIDTH).print(table)
    warned: dict[str, list[str]] = {}
    for title, result in results.items():
        for warning in result.report.warnings:
            warned.setdefault(warning, []).append(title)
    print_sentences("Warnings:", warned)
    if options.output:
        keep(results, table, options.output)
    if stopped.dropped:
        print(f"supervisor: {stopped.dropped} samples were lost: see the recorder's diagnostics.", file=sys.stderr)
    return 1 if stopped.dropped else 0


def main() -> int:
    """Run the experiment and print its table; the exit code is 0 only if everything succeeded."""
    parser = argparse.ArgumentParser(description="Record one trajectory, identify the drive, print the result.")
    parser.add_argument("--recording", default="", help="name of the recording; default: date and time")
    parser.add_argument("--truth", type=Path, help="file that bench_simulator wrote, to compare with")
    parser.add_argument("--output", type=Path, help="folder, made if missing, for the table and the results")
    parser.add_argument("--timeout", type=float, default=60.0, help="for each step, s; more than the trajectory takes")
    parser.add_argument("--start-up", type=float, default=300.0, help="time for all nodes to become ready, s")
    options = parser.parse_args(remove_ros_args(sys.argv)[1:])
    # Ctrl-C shall raise KeyboardInterrupt here, also in the background of a script, which would ignore it, and leave
    # the context alive to stop what was started.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    supervisor = Supervisor(options.timeout)
    try:
        return supervise(supervisor, options)
    except (ExperimentError, DriveIdError, OSError, KeyboardInterrupt) as error:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # one is enough, and the bench must come to rest
        print(f"supervisor: {str(error) or 'interrupted'}", file=sys.stderr)
        supervisor.abandon()
        return 1
    finally:
        supervisor.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
