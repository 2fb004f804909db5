"""Errors of analyses of fitted maps, and the coverage of their 95 % bands.

Usage: python benchmarks/analysis.py [--machines FOLDER] [--seeds N] [--only NAME,...] [--write]

Each drive is simulated for 10 s at 500 rpm with noise of 0.1 % of i_max, and fitted with default settings. FOLDER holds
machine files that are not part of this repository, ``thor_fem_harmonic_map.npz`` and ``baldor_meas_map.npz``.
``--write`` puts the figures into docs/engineering/control_measured.md. They do not depend on the computer.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from reporting import printed, write_between

from drive_id.analysis.machine import MachineModel
from drive_id.analysis.trajectories import CurrentLocus, mtpa
from drive_id.bench.machine import Machine
from drive_id.bench.settings import SimulationSettings
from drive_id.fitting.fit import fit
from drive_id.fitting.simulated import load_machine, run_experiment
from drive_id.types import FloatArray

SECONDS, BAND, POINTS, SEEDS = 10.0, 1.96, 41, 3
SETTINGS = SimulationSettings(current_noise=1e-3)
SHIPPED = {name: (name, SETTINGS) for name in ("ipm", "spm", "pmsyrm")}
FILES = {
    "Baldor": ("baldor_meas_map.npz", replace(SETTINGS, sixth_harmonic=0.01)),
    "THOR": ("thor_fem_harmonic_map.npz", SETTINGS),
}
COLUMNS = (
    "Machine", "Largest torque error", "Rms torque error", "Largest MTPA angle error", "Torque coverage",
    "L_dd coverage", "L_qq coverage", "L_dq coverage", "MTPA angle coverage",
)  # fmt: skip
PAGE = Path(__file__).parent.parent / "docs" / "engineering" / "control_measured.md"
_STEP = 1e-3
_SCAN = np.deg2rad(0.05)


@dataclass(frozen=True)
class Figures:
    """Errors of one analysis; those of the torque relative to the largest torque."""

    torque: float  # largest error over the points with data within the disc
    rms_torque: float  # the rms of it
    angle: float  # largest error of the MTPA angle, degrees
    torque_bands: float  # share of the bands that contain the truth
    L_dd_bands: float
    L_qq_bands: float
    L_dq_bands: float
    angle_bands: float


def true_inductances(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Return the incremental inductances (N, 2, 2), H, by differences of the true mean flux."""
    step = _STEP * machine.i_max
    by_d = (machine.mean_flux(i_d + step, i_q) - machine.mean_flux(i_d - step, i_q)) / (2 * step)
    by_q = (machine.mean_flux(i_d, i_q + step) - machine.mean_flux(i_d, i_q - step)) / (2 * step)
    return np.stack([by_d, by_q], axis=-1)


def true_torque(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Return the torque (...), Nm."""
    psi = machine.mean_flux(i_d, i_q)
    return np.asarray(1.5 * machine.pole_pairs * (psi[..., 0] * i_q - psi[..., 1] * i_d))


def true_angles(machine: Machine, current: FloatArray) -> FloatArray:
    """Return the MTPA angles (N,), rad: the best of a dense scan, moved to the vertex of the parabola around it."""
    angle = np.arange(_SCAN, np.pi, _SCAN)
    torque = true_torque(machine, current[:, None] * np.cos(angle), current[:, None] * np.sin(angle))
    best = np.clip(torque.argmax(axis=1), 1, len(angle) - 2)
    left, middle, right = (torque[np.arange(len(current)), best + k] for k in (-1, 0, 1))
    return np.asarray(angle[best] + _SCAN * 0.5 * (left - right) / (left - 2 * middle + right))


def angles(trajectory: CurrentLocus) -> FloatArray:
    """Return the angles (N,), rad."""
    return np.asarray(np.arctan2(trajectory.i_q, trajectory.i_d))


def judge(model: MachineModel, machine: Machine) -> Figures:
    """Compare the model of a fitted drive with the machine that was simulated."""
    grid, inside, i_max = model.flux_map.grid(), model.flux_map.inside, machine.i_max
    i_d, i_q = grid[inside & (np.hypot(grid[..., 0], grid[..., 1]) <= i_max)].T
    torque = true_torque(machine, i_d, i_q)
    error = model.torque(i_d, i_q) - torque
    slopes = model.inductances(i_d, i_q) - true_inductances(machine, i_d, i_q)
    sigmas, found = model.sigma_inductances(i_d, i_q), mtpa(model, i_max, POINTS)
    angle = (angles(found) - true_angles(machine, found.current))[1:]  # without zero current
    largest = np.abs(torque).max()
    return Figures(
        torque=float(np.abs(error).max() / largest),
        rms_torque=float(np.sqrt(np.mean(error**2)) / largest),
        angle=float(np.rad2deg(np.abs(angle).max())),
        torque_bands=held(error, model.sigma_torque(i_d, i_q)),
        L_dd_bands=held(slopes[..., 0, 0], sigmas[..., 0, 0]),
        L_qq_bands=held(slopes[..., 1, 1], sigmas[..., 1, 1]),
        L_dq_bands=held(slopes[..., 0, 1], sigmas[..., 0, 1]),
        angle_bands=held(angle, found.sigma_angle[1:]),
    )


def held(error: FloatArray, sigma: FloatArray) -> float:
    """Return the share of the known bands that contain the truth."""
    known = np.isfinite(sigma)
    return float(np.mean(np.abs(error[known]) <= BAND * sigma[known]))


def judged(name: str, settings: SimulationSettings, seed: int) -> Figures:
    """Simulate and fit a drive, and evaluate the errors."""
    machine_map = load_machine(name)
    fitted = fit(run_experiment(machine_map, replace(settings, seed=seed), seconds=SECONDS).samples)
    machine = Machine.from_map(machine_map, harmonics=settings.harmonics, sixth_harmonic=settings.sixth_harmonic)
    return judge(MachineModel.of(fitted, pole_pairs=machine.pole_pairs), machine)


def row(name: str, found: Sequence[Figures]) -> str:
    """Return a row of the table: the worst errors and the mean coverage."""
    errors = (
        f"{100 * max(each.torque for each in found):.2f} %",
        f"{100 * max(each.rms_torque for each in found):.3f} %",
    )
    angle = f"{max(each.angle for each in found):.2f}°"
    bands = (
        f"{100 * np.mean([getattr(each, part) for each in found]):.0f} %"
        for part in ("torque_bands", "L_dd_bands", "L_qq_bands", "L_dq_bands", "angle_bands")
    )
    return f"| {' | '.join((name, *errors, angle, *bands))} |"


def lines(options: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of the output."""
    folder = options.machines
    drives = SHIPPED | ({name: (str(folder / file), own) for name, (file, own) in FILES.items()} if folder else {})
    yield from (f"| {' | '.join(COLUMNS)} |", "|---|" + "---:|" * (len(COLUMNS) - 1))
    for name in options.only.split(",") if options.only else drives:
        yield row(
            f"`{name}`" if name in SHIPPED else name, [judged(*drives[name], seed) for seed in range(options.seeds)]
        )


def main() -> None:
    """Measure, print and, with ``--write``, update the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=Path, help="folder with the machine files")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="repetitions with different noise")
    parser.add_argument("--only", default="", help="names of drives, separated by commas")
    parser.add_argument("--write", action="store_true", help="write docs/engineering/control_measured.md")
    options = parser.parse_args()
    table = printed(lines(options))
    if options.write:
        write_between(PAGE, "benchmarks/analysis.py", table)


if __name__ == "__main__":
    main()
