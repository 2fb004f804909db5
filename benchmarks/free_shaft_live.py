"""First start, free shaft, map and mechanics through the nodes, for machines and inertias, by one command each.

The drives are those of ``free_shaft.py``; their angles are 0.7 rad off. Where saliency is stronger than the magnets,
the first start refuses to find the angle; then it is given, and only the shaft is shaken.
"""

from __future__ import annotations

import argparse
import math
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from node_processes import NodeProcess
from reporting import write_between

from drive_id.bench.drive import build_machine
from drive_id.bench.effects import DEFAULT_ACCELERATION, largest_torque
from drive_id.bench.settings import SimulationSettings
from drive_id.core.validation.metrics import nrmse, true_flux
from drive_id.files.machines.ground_truth import decode_truth
from drive_id.fitting.result import load
from drive_id.fitting.simulated import load_machine
from drive_id.fitting.sources import read_bag

OFFSET = 0.7  # rad
SPEED_MAX, FLYWHEEL = 1500.0, 750.0  # rpm
SECONDS = {"ipm": 20.0, "spm": 40.0, "pmsyrm": 40.0}
"""Of a swing. In 20 s, 0.1 % of current noise leaves ψ_q of spm uncertain by 0.035 to 0.045 % (one standard error), and
ψ_d of pmsyrm, whose shaft reaches half of the speed, was wrong by 0.023 to 0.052 % in five records."""
SHARE = 0.9  # of the drive's current_limit for i_max, as docs/special_cases.md advises
_RPM = 2 * math.pi / 60
HEAD = "| live | error of ψ_d / ψ_q | R (z) | bands | J (z) | largest speed, current | warnings |"


def started(folder: Path, name: str, parameters: dict[str, Any]) -> NodeProcess:
    """Start a node."""
    command = [sys.executable, "-m", f"drive_id.nodes.{name}", "--ros-args"]
    for key, value in parameters.items():
        command += ["-p", f"{key}:={str(value).lower() if isinstance(value, bool) else value}"]
    return NodeProcess(command, folder / f"{name}.log")


def row(machine_name: str, heavier: float, folder: Path, time_scale: float) -> str:
    """Run one drive, and return a row of the table."""
    slow = {"use_sim_time": True} if time_scale != 1.0 else {}
    machine_map = load_machine(machine_name)
    machine = build_machine(machine_map, SimulationSettings(free_shaft=True))
    inertia, truth = heavier * largest_torque(machine) / DEFAULT_ACCELERATION, folder / "truth.npz"
    limit = SPEED_MAX * _RPM * machine.pole_pairs
    known, data = machine_name == "pmsyrm", {"data_directory": str(folder), **slow}
    i_max = SHARE * machine.i_max
    drive = {
        "machine": machine_name, "free_shaft": True, "inertia": inertia, "inverter": "tanh",
        "inverter_voltage": 0.02 * machine.u_dc, "current_noise": 1e-3, "current_bandwidth": 120.0,
        "controller_inductance": 0.7, "controller_flux": 0.9, "speed_observer": 100.0, "resolver_offset": OFFSET,
        "truth_file": str(truth), "time_scale": time_scale,
    }  # fmt: skip
    publisher = {
        "i_max": i_max, "shaft_speed_max": limit, "duration": SECONDS[machine_name], "lead_time": 1.0,
        "watch_timeout": 3.0, "mean_speed": FLYWHEEL * _RPM * machine.pole_pairs if heavier >= 10 else 0.0,
        "angle_offset": OFFSET if known else 0.0, **slow,
    }  # fmt: skip
    fit = data | {"output_directory": str(folder), "i_max": i_max, "pole_pairs": machine.pole_pairs}
    nodes = [
        started(folder, "bench_simulator", drive), started(folder, "recorder", data),
        started(folder, "identification", fit), started(folder, "trajectory_publisher", publisher),
    ]  # fmt: skip
    options = ["--first-start", "--free-shaft", "--drive", "bench_simulator", "--recording", "bag"]
    options += ["--timeout", str((40.0 + SECONDS[machine_name]) / min(time_scale, 1.0))]
    options += ["--angle-known"] if known else []
    command = [sys.executable, "-m", "drive_id.ros.characterize", *options, "--output", str(folder / "out")]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    finally:
        for node in nodes:
            node.end(signal.SIGINT)
    name = f"{machine_name}, {heavier:g} times the inertia"
    if done.returncode:
        return f"| {name} | refused: {done.stderr.strip().splitlines()[0]} | | | | | |"
    true, found = decode_truth(truth.read_bytes(), ""), load(folder / "out" / "recording")
    flux_map, mechanics = found.flux_map, found.mechanics
    grid = flux_map.grid()
    inside = flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= i_max)
    psi, sigma = (
        np.stack([getattr(flux_map, f"{kind}_{axis}")[inside] for axis in "dq"], axis=-1) for kind in ("psi", "sigma")
    )
    exact = true_flux(true, grid[inside])
    d, q = (100 * x for x in nrmse(psi, exact))
    band = 100 * np.mean(np.abs(psi - exact) < 1.96 * sigma)
    wrong = found.resistance - true.resistance
    shaft = "not told"
    if mechanics is not None:
        off = mechanics.inertia - inertia
        shaft = f"{100 * off / inertia:+.3f} % ({off / mechanics.sigma_inertia:+.1f})"
    bags = [read_bag(bag) for bag in (*folder.glob("bag_shake_*"), folder / "bag")]
    speed, current = (max(float(np.abs(getattr(bag, x)).max()) for bag in bags) for x in ("speed", "i_abc"))
    for sentence in found.warnings:
        print(f"    {sentence}", flush=True)
    resistance = f"{100 * wrong / true.resistance:+.2f} % ({wrong / found.sigma_resistance:+.1f})"
    reached = f"{speed / limit:.2f}, {current / i_max:.2f}"
    return (
        f"| {name} | {d:.3f} / {q:.3f} % | {resistance} | {band:.0f} % | {shaft} | {reached} | {len(found.warnings)} |"
    )


def main() -> None:
    """Run all, print the table, and write it into a page."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--machines", nargs="*", default=["ipm", "spm", "pmsyrm"])
    parser.add_argument("--inertias", nargs="*", type=float, default=[0.3, 1.0, 10.0])
    parser.add_argument("--time-scale", type=float, default=1.0, help="below 1 on a computer that is busy otherwise")
    parser.add_argument("--page", type=Path, help="page whose table to replace (Markdown)")
    options = parser.parse_args()
    lines = [HEAD, "|---|---|---|---|---|---|---|"]
    print(*lines, sep="\n", flush=True)
    for machine in options.machines:
        for heavier in options.inertias:
            with tempfile.TemporaryDirectory() as folder:
                lines.append(row(machine, heavier, Path(folder), options.time_scale))
                print(lines[-1], flush=True)
    if options.page:
        write_between(options.page, "benchmarks/free_shaft_live.py", "\n".join(lines))


if __name__ == "__main__":
    main()
