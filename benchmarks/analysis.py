"""Errors of analyses of fitted maps, and the share of their 95 % bands that hold the truth.

Usage: python benchmarks/analysis.py [--machines FOLDER] [--seeds N] [--only NAME,...] [--write]

Each drive is simulated for 10 s at 500 rpm with noise of 0.1 % of i_max, fitted and analysed with default settings.
FOLDER holds the machine files ``thor_fem_harmonic_map.npz`` and ``baldor_meas_map.npz``, which are not part of this
repository, and the loci of THOR that SyR-e computed, ``thor_MTPA_syre.npz`` and ``thor_MTPV_syre.npz``. ``--write`` puts
the table into docs/analysis.md. The figures do not depend on the computer.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from drive_id.analysis.machine import MachineModel
from drive_id.analysis.trajectories import Trajectory, mtpa
from drive_id.bench.machine import Machine
from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.fitting.fit import fit
from drive_id.fitting.simulated import load_machine, run_experiment
from drive_id.types import FloatArray

SECONDS, BAND, POINTS = 10.0, 1.96, 41
SETTINGS = SimulationSettings(current_noise=1e-3)
SHIPPED = ("ipm", "spm", "pmsyrm")
FILES = {
    "THOR": ("thor_fem_harmonic_map.npz", SETTINGS),
    "Baldor": ("baldor_meas_map.npz", SimulationSettings(current_noise=1e-3, sixth_harmonic=0.01)),
}
STEP = np.deg2rad(0.05)
_STEP = 1e-3


@dataclass(frozen=True)
class Figures:
    """Errors of one analysis; those of the torque relative to the largest torque.

    Parameters
    ----------
    torque, rms_torque : float
        Largest and rms error over the points with data within the disc.
    angle : float
        Largest error of the MTPA angle, degrees.
    torque_bands, inductance_bands, angle_bands : float
        Shares of the bands that hold the truth.
    """

    torque: float
    rms_torque: float
    angle: float
    torque_bands: float
    inductance_bands: float
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
    angle = np.arange(STEP, np.pi, STEP)
    torque = true_torque(machine, current[:, None] * np.cos(angle), current[:, None] * np.sin(angle))
    best = np.clip(torque.argmax(axis=1), 1, len(angle) - 2)
    left, middle, right = (torque[np.arange(len(current)), best + k] for k in (-1, 0, 1))
    return np.asarray(angle[best] + STEP * 0.5 * (left - right) / (left - 2 * middle + right))


def angles(trajectory: Trajectory) -> FloatArray:
    """Return the angles (N,), rad."""
    return np.asarray(np.arctan2(trajectory.i_q, trajectory.i_d))


def judge(model: MachineModel, machine: Machine) -> Figures:
    """Compare the model of a fitted drive with the machine that was simulated."""
    grid, inside, i_max = model.flux_map.grid(), model.flux_map.inside, machine.i_max
    i_d, i_q = grid[inside & (np.hypot(grid[..., 0], grid[..., 1]) <= i_max)].T
    torque = true_torque(machine, i_d, i_q)
    error = model.torque(i_d, i_q) - torque
    slopes = model.inductances(i_d, i_q) - true_inductances(machine, i_d, i_q)
    found = mtpa(model, i_max, POINTS)
    angle = (angles(found) - true_angles(machine, found.current))[1:]  # without zero current
    largest = np.abs(torque).max()
    return Figures(
        torque=float(np.abs(error).max() / largest),
        rms_torque=float(np.sqrt(np.mean(error**2)) / largest),
        angle=float(np.rad2deg(np.abs(angle).max())),
        torque_bands=held(error, model.sigma_torque(i_d, i_q)),
        inductance_bands=held(slopes, model.sigma_inductances(i_d, i_q)),
        angle_bands=held(angle, found.sigma_angle[1:]),
    )


def held(error: FloatArray, sigma: FloatArray) -> float:
    """Return the share of the bands that hold the truth, among those that are known."""
    known = np.isfinite(sigma)
    return float(np.mean(np.abs(error[known]) <= BAND * sigma[known]))
