#!/usr/bin/env python3
"""Run one experiment as supervisory software would: by the services of the nodes, and nothing else.

Needs the nodes ``trajectory_publisher``, ``recorder`` and ``identification``, and a drive (here ``bench_simulator``)
that publishes ``phase_currents``, ``phase_voltages`` and ``resolver`` and follows ``current_reference``::

    recorder/start  ->  trajectory_publisher/start  ->  wait until it has ended  ->  recorder/stop
    identification/identify with the recording, and without one (the live samples)

All names are relative: with ``--ros-args -r __ns:=/drive_1`` it supervises the nodes of that namespace. The truth,
which only a simulation can tell, stands beside the results when ``--truth`` names the file that
``bench_simulator`` wrote.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from drive_id_msgs.msg import FluxMap
from drive_id_msgs.srv import Identify, StartRecording, StopRecording
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from rich.console import Console
from rich.table import Table
from std_srvs.srv import Trigger

from drive_id.core.validation.metrics import nrmse, true_flux
from drive_id.files.machines.ground_truth import decode_truth
from drive_id.types import GroundTruth

IDLE, TRIPPED = "idle", "tripped"
_WIDTH = 110
_PATIENCE = 15.0  # s


class ExperimentError(Exception):
    """A service refused, or did not answer in time: a sentence says which, and why."""


class Supervisor(Node):
    """Calls services one after the other, each with a deadline."""

    def __init__(self, timeout: float) -> None:
        super().__init__("supervisor")
        self.timeout = timeout
        self._states: list[tuple[str, str]] = []
        self._publisher_name = self.resolve_service_name("trajectory_publisher")
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

    def wait_for_services(self) -> None:
        """Wait until all nodes are there."""
        for name, client in self._service_clients.items():
            self.wait(client.service_is_ready, f"service {name} is not there: start its node")

    def call(self, name: str, /, **fields: Any) -> Any:
        """Call a service and return its response, which tells of success itself."""
        future = self._service_clients[name].call_async(self._kinds[name].Request(**fields))
        self.wait(future.done, f"service {name} does not answer")
        return future.result()

    def require(self, name: str, /, **fields: Any) -> Any:
        """Call a service that must succeed."""
        response = self.call(name, **fields)
        if not response.success:
            raise ExperimentError(f"{name}: {response.message}")
        return response

    def run_trajectory(self) -> None:
        """Start the trajectory and wait until it has ended by itself."""
        started = time.monotonic()
        # A trajectory is published only while the drive is heard; just after its start, that may take a moment.
        while not (answer := self.call("trajectory_publisher/start")).success:
            if time.monotonic() > started + _PATIENCE:
                raise ExperimentError(f"trajectory_publisher/start: {answer.message}")
            self.pause(0.25)
        self._states.clear()

        def ended() -> bool:
            if any(state == TRIPPED for state, _ in self._states):
                raise ExperimentError(f"The trajectory was stopped: {self._states[-1][1]}")
            was_active = any(state != IDLE for state, _ in self._states) or time.monotonic() > started + 5.0
            return bool(was_active and self._states and self._states[-1][0] == IDLE)

        self.wait(ended, "the trajectory does not end")

    def abandon(self) -> None:
        """Leave a bench at rest whatever went wrong: zero current, and a recording that can be read."""
        for name in ("trajectory_publisher/stop", "recorder/stop"):
            if self._service_clients[name].service_is_ready():
                self.timeout = min(self.timeout, 5.0)
                with contextlib.suppress(ExperimentError):
                    print(f"   {name}: {self.call(name).message}")

    def wait(self, condition: Callable[[], bool], complaint: str) -> None:
        """Spin until the condition holds."""
        end = time.monotonic() + self.timeout
        while not condition():
            if time.monotonic() > end:
                raise ExperimentError(f"After {self.timeout:g} s, {complaint}.")
            rclpy.spin_once(self, timeout_sec=0.05)

    def pause(self, seconds: float) -> None:
        """Spin for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(self, timeout_sec=0.05)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._publisher_name:
                values = {entry.key: entry.value for entry in status.values}
                self._states.append((values.get("state", ""), status.message))


def run_experiment(supervisor: Supervisor, recording: str) -> tuple[Any, dict[str, Any]]:
    """Record one trajectory and identify the drive from the recording and from the live samples.

    Returns
    -------
    stopped : StopRecording.Response
    results : dict of str to Identify.Response
        Title of the column to result.
    """
    supervisor.wait_for_services()
    print("1. All nodes are there: the recording is started, then the trajectory.")
    started = supervisor.require("recorder/start", name=recording)
    supervisor.require("identification/reset")  # live samples from here on
    supervisor.run_trajectory()
    stopped = supervisor.require("recorder/stop")
    print(f"2. {stopped.message}")
    results = {}
    for title, bags, method in (
        ("live, joint", [], "joint"),  # at once, for the sums are there already
        ("live, full", [], "full"),
        ("recording, full", [started.uri], "full"),
        ("recording, psm", [started.uri], "psm"),
    ):
        begin = time.monotonic()
        results[title] = supervisor.require("identification/identify", bags=bags, method=method)
        print(f"3. {title}: {1e3 * (time.monotonic() - begin):.0f} ms.")
    return stopped, results


def comparison(results: dict[str, Any], truth: GroundTruth | None) -> Table:
    """Lay out all results side by side, with the truth where it is known."""
    table = Table(title="The drive, identified through the services", title_justify="left")
    table.add_column("Quantity")
    for title in [*results, *(["truth"] if truth else [])]:
        table.add_column(title, justify="right")
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


def main() -> int:
    """Run the experiment and print its table; the exit code is 0 only if everything succeeded."""
    parser = argparse.ArgumentParser(description="Record one trajectory, identify the drive, print the result.")
    parser.add_argument("--recording", default="", help="name of the recording; default: date and time")
    parser.add_argument("--truth", type=Path, help="file that bench_simulator wrote, to compare with")
    parser.add_argument("--output", type=Path, help="folder for the table, and for the results under plain names")
    parser.add_argument("--timeout", type=float, default=60.0, help="for each step, s; more than the trajectory takes")
    options = parser.parse_args(remove_ros_args(sys.argv)[1:])
    # Ctrl-C shall raise KeyboardInterrupt here, also in the background of a script, which would ignore it, and leave
    # the context alive to stop what was started.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    supervisor = Supervisor(options.timeout)
    try:
        stopped, results = run_experiment(supervisor, options.recording)
        truth = decode_truth(options.truth.read_bytes(), str(options.truth)) if options.truth else None
        table = comparison(results, truth)
        Console(width=_WIDTH).print(table)
        for title, result in results.items():
            for warning in result.report.warnings:
                print(f"   {title}: {warning}")
        if options.output:
            with (options.output / "table.txt").open("w", encoding="utf-8") as file:
                Console(file=file, width=_WIDTH).print(table)
            for title, result in results.items():
                folder = options.output / title.replace(", ", "_")
                Path(result.output).rename(folder)
                print(f"   Results in {folder}")
        if stopped.dropped:
            print(f"supervisor: {stopped.dropped} samples were lost: see the recorder's diagnostics.", file=sys.stderr)
            return 1
    except (ExperimentError, KeyboardInterrupt) as error:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # one is enough, and the bench must come to rest
        print(f"supervisor: {str(error) or 'interrupted'}", file=sys.stderr)
        supervisor.abandon()
        return 1
    finally:
        supervisor.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
