"""Print what the package costs as ratios against the plain dense script, in one run on this machine.

Usage: python benchmarks/run.py
"""

from __future__ import annotations

import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from drive_id.core import frames
from drive_id.core.bspline import Axis
from drive_id.core.flux_models import TensorSpline
from drive_id.core.inverter import TanhShape
from drive_id.core.regression import Information
from drive_id.core.solver import Solution, solve
from drive_id.sim.machines import machine_map
from drive_id.sim.settings import SimulationSettings
from drive_id.types import Samples
from drive_id.workflows import run_experiment

sys.path.insert(0, str(Path(__file__).parent))
from dense_script import fit as dense_fit

REPEATS = 5


def joint_fit(samples: Samples) -> Solution:
    """Accumulate and solve method ``joint`` in process, as ``drive-id fit`` does."""
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    low, high = i_dq.min(axis=0), i_dq.max(axis=0)
    model = TensorSpline(Axis(low[0], high[0], 8), Axis(low[1], high[1], 8))
    information = Information(model, TanhShape())
    information.add(samples)
    return solve(information.total, information.rows, with_inverter=True)


def best_time(action: Callable[[], Any], repeats: int) -> float:
    """Return the shortest of several runs, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def peak_memory(action: Callable[[], Any]) -> int:
    """Return the most memory that Python and numpy held at once beyond what was there before, bytes."""
    tracemalloc.start()
    action()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def main() -> None:
    """Compare, check that both find the same, and print the table."""
    settings = SimulationSettings(inverter="dead_time", current_noise=1e-3)
    samples = run_experiment(machine_map("ipm"), settings, seconds=10.0).samples

    def ours() -> Solution:
        return joint_fit(samples)

    def dense() -> tuple[float, float, Any]:
        return dense_fit(samples.stamp, samples.i_abc, samples.u_abc, samples.angle, samples.speed)

    solution, (resistance, voltage_error, gamma) = ours(), dense()
    agreement = np.abs(solution.gamma - gamma)[np.abs(gamma) < 1].max() / np.abs(gamma[np.abs(gamma) < 1]).max()
    time_ours, time_dense = best_time(ours, REPEATS), best_time(dense, 2)
    memory_ours, memory_dense = peak_memory(ours), peak_memory(dense)

    table = Table(title="Joint fit of 10 s at 10 kHz, in process", title_justify="left")
    for column in ("", "dense script (baseline)", "drive_id", "ratio"):
        table.add_column(column, justify="left" if not column else "right")
    table.add_row("Time", f"{time_dense:.2f} s", f"{time_ours:.3f} s", f"{time_dense / time_ours:.0f} x faster")
    table.add_row(
        "Peak extra memory",
        f"{memory_dense / 1e6:.0f} MB",
        f"{memory_ours / 1e6:.1f} MB",
        f"1/{memory_dense / memory_ours:.0f}",
    )
    console = Console()
    console.print(table)
    console.print(
        f"Both find R = {resistance * 1e3:.4f} / {solution.resistance * 1e3:.4f} mohm, u_e = {voltage_error:.4f} / "
        f"{solution.voltage_error:.4f} V; their flux parameters differ by {agreement:.1e} of the largest."
    )


if __name__ == "__main__":
    main()
